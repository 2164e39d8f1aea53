"""The configuration of a training run: schema, defaults and units.

Every number of a run is a field here, once; a file or ``--set`` only overrides (`vhs.config.load`). The
resolved configuration is frozen and is saved with the run. "Paper" in a comment means the hyperparameter
table of Kim et al., "Visual Hindsight Self-Imitation Learning for Interactive Navigation"; what departs from
it says why.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from vhs.config.task import TaskKey, task_name
from vhs.learning.methods import METHODS, Embedding, Method, check_method, settle

Probability = Annotated[float, Field(ge=0.0, le=1.0)]
PositiveInt = Annotated[int, Field(ge=1)]
NonNegativeInt = Annotated[int, Field(ge=0)]
NonNegativeFloat = Annotated[float, Field(ge=0.0)]
PositiveFloat = Annotated[float, Field(gt=0.0)]
Degrees = Annotated[float, Field(ge=0.0, le=180.0)]
OutcomeName = Literal["success", "failure", "timeout"]
LoggerName = Literal["tensorboard", "trackio", "wandb", "mlflow"]


@dataclass(frozen=True, slots=True)
class Of:
    """Marks a key that only some parts of a method read; a method without them refuses it."""

    parts: tuple[str, ...]
    """Terms, or what names goals: `Method.parts`."""

    def is_read(self, parts: frozenset[str]) -> bool:
        """Whether a method of these parts reads the key."""
        return not parts.isdisjoint(self.parts)


_RL = Of(("policy", "value"))
_RETURNS = Of(("policy", "value", "imitation_value"))
_VALUE = Of(("value",))
_ENTROPY = Of(("entropy",))
_SUPCON = Of(("supcon",))
_GOAL_IMAGES = Of(("supcon", "discriminator"))
_PROTOTYPE = Of(("prototype",))
_IMITATION = Of(("imitation_policy", "imitation_value", "replay"))
_IMITATION_VALUE = Of(("imitation_value",))
_REPLAY = Of(("replay",))
_DISCRIMINATOR = Of(("discriminator",))
_LOCALISE = Of(("localise",))
_REMEMBER = Of(("remember",))
_RECKONING = Of(("localise", "remember"))


def _known_method(name: str) -> str:
    if name not in METHODS:
        *others, last = (f"'{known}'" for known in METHODS)
        raise PydanticCustomError("literal_error", f"Input should be {', '.join(others)} or {last}")
    return name


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class EnvSection(_Section):
    """The environments that the run collects from."""

    num_envs: PositiveInt = 16
    """Environments stepped side by side (paper: 5 processes of one room)."""
    num_workers: Annotated[int, Field(ge=0)] | None = None
    """Processes that step the environments while this one learns; 0 steps them in this process; null is 1 on
    Linux, which alone has such workers, and 0 elsewhere."""
    min_ready: PositiveInt | None = None
    """Environments that must have answered before the next inference; null waits for all (lock-step), and
    then the result does not depend on the number of workers. Without workers all have always answered."""
    deadline_s: PositiveFloat = 60.0
    """Seconds that an environment may take for a step or a reset; after them its worker is replaced, and its
    episodes are played again from their seeds and actions."""
    renderer: str = "raster"
    """What draws the camera image of a room, as `vhs.envs` names it."""
    horizon_factor: Annotated[float, Field(ge=1.0, le=100.0)] | None = None
    """How many times the steps of the task an episode of training may last (paper: 1): what is reached late
    teaches too. Rates count what succeeds within the task's own steps, and evaluation gives no more; an
    environment that ends by itself still does. null is 2 where hindsight imitates and the environment can be
    asked for longer episodes (`Task.max_steps_keyword`), and 1 elsewhere."""
    retry_share: Annotated[float, Field(ge=0.0, lt=1.0)] | None = None
    """Share of episodes that begin from a seed that was missed, as its episode did not succeed within the
    task's steps, so that what is rare and hard is met more often (paper: 0); rates are of the others. null is
    0.25 where hindsight imitates and a seed repeats an episode (`Task.replayable`), and 0 elsewhere."""
    room: dict[str, Any] = Field(default_factory=dict)
    """Overrides of `vhs.envs.RoomConfig`, for example ``{stride_m: 0.3}``; for the rooms alone."""
    kwargs: dict[str, Any] = Field(default_factory=dict)
    """What an environment is made with, for example ``{size: 8}``; over the task's own."""


class ModelSection(_Section):
    """The network (paper, appendix "Implementation Details")."""

    channels: Annotated[tuple[PositiveInt, ...], Field(min_length=1)] = (16, 32, 32, 64)
    """Output channels of each convolution, which halves the picture; the paper-size network is
    (32, 64, 128, 256)."""
    extractor: str | None = None
    """A feature extractor of one's own, ``module:factory`` (`vhs.models.ExtractorFactory`), in place of those
    convolutions; null takes them, or a perceptron where frames are vectors."""
    feature_dim: PositiveInt = 256
    """Length of f(o) and of a prototype (paper: 256)."""
    hidden_dim: PositiveInt = 256
    """LSTM state (paper: 256)."""
    head_dim: PositiveInt = 128
    """Hidden layer of the policy and of the value head (the paper gives no number)."""
    interaction_dim: PositiveInt = 16
    """Length of the interaction embedding (the paper gives no number)."""
    frame_stack: PositiveInt = 2
    """Frames in an observation (paper: 2)."""


class MethodSection(_Section):
    """The method, and what makes VHS out of an actor-critic: goals, prototypes, relabelling."""

    name: Annotated[str, AfterValidator(_known_method)] = "vhs"
    """A row of `vhs.learning.methods`; a key of a part that the method lacks is refused."""
    embedding: Embedding = "prototype"
    """What names a goal to the policy: `prototype` (paper: PG), or `word`, a learned vector a goal class; the
    method's own unless given."""
    supcon_weight: Annotated[NonNegativeFloat, _SUPCON] = 0.5
    """Weight of the SupCon loss (paper: 0.5)."""
    supcon_batch: Annotated[Annotated[int, Field(ge=2)] | None, _GOAL_IMAGES] = None
    """Goal images in a SupCon batch of a process; null is 16, or two a goal class where that is more (paper:
    64; a quarter of it serves as well)."""
    supcon_temperature: Annotated[PositiveFloat, _SUPCON] = 0.07
    """Temperature tau_s (paper: 0.07)."""
    warmup: Annotated[PositiveInt, _GOAL_IMAGES] = 100
    """Goal images in the store before the loss on them starts (paper: 150), and with it running prototypes:
    until then no goal can be told from another. An exact one starts with the first image of its class."""
    goal_capacity: PositiveInt = 500
    """Goal images kept a class, the oldest leave first (the paper gives no bound)."""
    prototype: Annotated[Literal["running", "exact"], _PROTOTYPE] = "running"
    """`running` reuses the features of the SupCon batch; `exact` embeds `prototype_samples` images a class
    (paper)."""
    prototype_momentum: Annotated[Annotated[float, Field(ge=0.0, lt=1.0)], _PROTOTYPE] = 0.9
    """Share of the old prototype that a running update keeps."""
    prototype_samples: Annotated[PositiveInt, _PROTOTYPE] = 64
    """Images a class behind an exact prototype (paper: 64)."""
    relabel_probability: Annotated[Probability, _IMITATION] = 0.8
    """Chance that an episode of `relabel_on` is relabelled (paper: eta = 0.8)."""
    relabel_on: Annotated[tuple[OutcomeName, ...] | None, _IMITATION] = None
    """Outcomes that are relabelled; null is failure, and timeout as well where goals are pictures or vectors,
    as every end is then a goal, and where the task says that things are reached on the way (`touched`).
    (Paper: failure; its ablation adds timeout; Ghosh et al. take all.)"""
    hindsight_discount: Annotated[Probability, _IMITATION] = 0.7
    """Weight of an imitated action for each step between it and the end of its episode (paper: 1); below 1
    the approach to the goal counts more than the wandering before it."""
    imitate_still: Annotated[bool | None, _IMITATION] = None
    """Whether steps that changed nothing in what the agent sees are imitated too, such as a stride against a
    wall (paper: true); null is false where hindsight can localise (`moves`), and true elsewhere."""
    vhs_weight: Annotated[NonNegativeFloat, _IMITATION] = 1.0
    """Weight of the self-imitation loss, of kept episodes too (paper: beta, no number given)."""
    replay_ratio: Annotated[NonNegativeInt, _REPLAY] = 2
    """Kept episodes that are imitated again for each that an update learns from (the paper has none); 0
    unless given where words name goals."""
    replay_capacity: Annotated[PositiveInt, _REPLAY] = 5_000
    """Steps kept, by all processes together, of episodes that reached something, and in each of one episode
    at least; the oldest leave first."""
    hindsight_goal: Annotated[Literal["feature", "prototype"], _IMITATION] = "prototype"
    """Goal of a relabelled episode: `feature` is f(o_T) (paper); `prototype` the class prototype nearest to
    f(o_T) in angle, which is what the policy is asked for when acting."""
    value_target: Annotated[Literal["behaviour", "hindsight_return"], _IMITATION_VALUE] = "behaviour"
    """Target of the hindsight value: the critic's value when acting (paper), or the return as if it had
    succeeded."""
    discriminator_weight: Annotated[NonNegativeFloat, _DISCRIMINATOR] = 0.5
    """Weight of GDAN's goal-discriminator loss (Kim et al. 2021, their code: 0.5)."""
    localisation_weight: Annotated[NonNegativeFloat | None, _LOCALISE] = None
    """Weight of hindsight localisation: whether what an episode reached was in view at each of its steps, by
    dead reckoning from its end (the paper has none); null is 1 where the task says what actions do to the
    pose (`moves`), and 0 elsewhere."""
    localisation_ahead_m: Annotated[NonNegativeFloat, _RECKONING] = 0.5
    """Metres in front of an episode's last pose at which what it reached is taken to lie."""
    localisation_in_view_deg: Annotated[Degrees, _LOCALISE] = 28.0
    """What lies less far to either side is in view; half the camera's angle of view, and less by what dead
    reckoning is off."""
    localisation_out_of_view_deg: Annotated[Degrees, _LOCALISE] = 48.0
    """What lies further to either side is not in view; what lies between the two says nothing."""
    memory_weight: Annotated[NonNegativeFloat | None, _REMEMBER] = None
    """Weight of what the memory is asked: in which of eight directions lies what an episode reached, seen or
    not, by the same dead reckoning (the paper has none); null is 0.5 where the task says `moves`, and 0
    elsewhere."""

    @property
    def row(self) -> Method:
        """What the method is made of."""
        return METHODS[self.name]

    @property
    def imitates(self) -> bool:
        """Whether hindsight imitates: terms of the method do, and have a weight."""
        return self.row.has_imitation and self.vhs_weight > 0

    @property
    def parts(self) -> frozenset[str]:
        """What reads its keys."""
        return self.row.parts(self.embedding)

    @model_validator(mode="before")
    @classmethod
    def _settle(cls, given: Any) -> Any:
        return settle(given) if isinstance(given, dict) else given

    @model_validator(mode="after")
    def _parts_fit_together(self) -> MethodSection:
        check_method(self.name, dict(self))
        return self


class TrainSection(_Section):
    """The optimisation and the bookkeeping of a run."""

    episodes: PositiveInt = 30_000
    """Episodes until the run is finished; a longer run gains most with `schedule_episodes` as long."""
    start_from: str | None = None
    """A run, or an exported agent, whose weights, prototypes and goal images this run begins with; optimiser,
    schedules and counters begin anew, and goal classes that the task has more come behind those there were.
    null begins with fresh weights."""
    episodes_per_update: PositiveInt = 4
    """Episodes behind an optimiser step, an equal share of them from each process (paper: 1; a trial with 16
    needed 2.7 times the episodes of 4)."""
    learning_rate: PositiveFloat = 5e-4
    """Adam with AMSGrad, at the start (paper: 1e-4 for one episode an update; at 1e-3 trained policies
    collapse); the method's own unless given."""
    learning_rate_end: PositiveFloat | None = 1.5e-4
    """Learning rate from `schedule_episodes` on, reached linearly; null keeps `learning_rate` (paper). Unless
    given, it is at most `learning_rate`. What a lower one would do for the trained agent, an average of the
    weights does (`ema_decay`), while training learns on."""
    schedule_episodes: PositiveInt = 30_000
    """Episodes over which learning rate and entropy weight move to their ends."""
    gamma: Annotated[Probability | None, _RETURNS] = None
    """Discount (paper: 0.99; then a goal in view is worth little more than one that is not). null is
    1 - 2 / T where an episode of the task takes up to T steps, and at least 0.9."""
    return_lambda: Annotated[Probability, _RL] = 0.75
    """Lambda of the returns: 1 is Monte-Carlo (paper); less trusts the critic's next values in part, and what
    is left of timeouts goes twice as fast."""
    reward_scale: Annotated[PositiveFloat, _RETURNS] = 0.1
    """Factor on the environment's reward; at 1 the policy's entropy collapses."""
    value_weight: Annotated[NonNegativeFloat, _VALUE] = 5.0
    """Weight of the critic's loss (paper: 0.5). The critic teaches the extractor to see a goal that is small
    and far: the value jumps there, while the policy alone loses little by turning past it."""
    entropy_weight: Annotated[NonNegativeFloat, _ENTROPY] = 0.03
    """Entropy coefficient at the start (paper: 0.01; then one of the two turns dies out early)."""
    entropy_weight_end: Annotated[NonNegativeFloat | None, _ENTROPY] = 0.001
    """Entropy coefficient from `schedule_episodes` on, reached linearly; null keeps `entropy_weight` (paper).
    Unless given, it is at most `entropy_weight`."""
    ema_decay: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.999
    """Share of the old average that an update keeps of the weights which a trained agent is evaluated, shown
    and exported with; of n updates at most (1 + n) / (10 + n), so that it is of the last tenth of a short
    run. Training acts with the newest weights and does not read it. 0 keeps no average (paper)."""
    max_grad_norm: PositiveFloat = 10.0
    """Gradient clip (paper: 10)."""
    precision: Literal["auto", "float32", "bfloat16"] = "auto"
    """Type of the convolutions; `auto` takes bfloat16 where the CPU multiplies it in hardware."""
    device: str = "auto"
    """Where torch computes, as torch names it (``cpu``, ``cuda:1``); ``auto`` is CUDA where there is one."""
    threads: PositiveInt = 1
    """Threads of torch: two spinning threads collapse as soon as another process is busy."""
    log_every: PositiveInt = 500
    """Episodes between two rows of the log; rates are over that window."""
    checkpoint_every_s: PositiveFloat = 300.0
    """Seconds between two checkpoints."""
    loggers: tuple[LoggerName, ...] = ("tensorboard",)
    """Where rows, films and pictures go besides `log.jsonl` and `media/`: any of `tensorboard`, `trackio`,
    `wandb` and `mlflow`, of which each but the first is an extra."""
    media_every: PositiveInt | None = None
    """Episodes between two films of an episode and pictures of stored goals, for `media/` and the loggers;
    null makes none."""
    keep_checkpoints: PositiveInt = 2
    """Newest checkpoints that are kept, each a few MB beside the goal store and the episodes that are
    imitated again; these two are 100 MB each in a room."""
    peer_timeout_s: PositiveFloat = 300.0
    """Seconds that a process waits for the others of its training before it takes them for gone; more than an
    environment may take (`env.deadline_s`). One that died is noticed at once."""

    @model_validator(mode="before")
    @classmethod
    def _no_rise_unasked(cls, given: Any) -> Any:
        """Who starts below the end that is the default, as with no entropy bonus at all, stays there."""
        if isinstance(given, dict):
            for name in ("learning_rate", "entropy_weight"):
                end = f"{name}_end"
                if end not in given and _is_below(given.get(name), cls.model_fields[end].default):
                    given = given | {end: given[name]}
        return given


class Config(_Section):
    """Everything that defines a run; frozen once resolved."""

    task: TaskKey = "task2"
    """One of the rooms, task1 to task3, or a task of one's own: `vhs.config.task`."""
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    """What every generator of the run follows from: the same seed, the same run."""
    env: EnvSection = Field(default_factory=EnvSection)
    model: ModelSection = Field(default_factory=ModelSection)
    method: MethodSection = Field(default_factory=MethodSection)
    train: TrainSection = Field(default_factory=TrainSection)

    @property
    def task_name(self) -> str:
        """What the task is called in file names and tables."""
        return task_name(self.task)

    @model_validator(mode="before")
    @classmethod
    def _own_learning_rate(cls, given: Any) -> Any:
        match given:
            case {"method": {"name": str(name)}} if name in METHODS and METHODS[name].learning_rate:
                train = given.get("train", {})
                if isinstance(train, dict):
                    return given | {"train": {"learning_rate": METHODS[name].learning_rate} | train}
        return given

    @model_validator(mode="after")
    def _every_key_is_read(self) -> Config:
        wrong = []
        for key, of in unread_keys(self.method.parts):
            section, _, leaf = key.partition(".")
            values = getattr(self, section)
            if leaf in values.model_fields_set:
                wrong.append(
                    f"{key}: expected none for method.name = {self.method.name}, which has no "
                    f"{' and no '.join(of.parts)}, found {getattr(values, leaf)}"
                )
        if wrong:
            raise ValueError("\n".join(wrong))
        return self

    @model_validator(mode="after")
    def _workers_share_rooms(self) -> Config:
        env = self.env
        if env.num_workers and env.num_envs % env.num_workers:
            raise ValueError(
                f"env.num_envs: expected a multiple of env.num_workers = {env.num_workers}, "
                f"found {env.num_envs}"
            )
        if env.min_ready is not None and env.min_ready > env.num_envs:
            raise ValueError(
                f"env.min_ready: expected at most env.num_envs = {env.num_envs}, found {env.min_ready}"
            )
        return self

    @model_validator(mode="after")
    def _warmup_fits_store(self) -> Config:
        if _GOAL_IMAGES.is_read(self.method.parts) and self.method.warmup > self.method.goal_capacity:
            raise ValueError(
                f"method.warmup: expected at most method.goal_capacity = {self.method.goal_capacity}, "
                f"found {self.method.warmup}; with one class alone the store would never hold that many"
            )
        return self


DECIDED_BY_TASK = (
    "env.horizon_factor",
    "env.retry_share",
    "method.supcon_batch",
    "method.relabel_on",
    "method.localisation_weight",
    "method.memory_weight",
    "method.imitate_still",
    "train.gamma",
)
"""Keys that are null until the task is known (`vhs.acting.setup.settled`)."""


def unread_keys(parts: frozenset[str]) -> Iterator[tuple[str, Of]]:
    """Dotted keys that a method of some parts does not read, each with what would read it."""
    for section, kind in (("method", MethodSection), ("train", TrainSection)):
        for leaf, field in kind.model_fields.items():
            for of in field.metadata:
                if isinstance(of, Of) and not of.is_read(parts):
                    yield f"{section}.{leaf}", of


GONE = frozenset({"train.learners"})
"""Keys that a whole configuration of an earlier version may still have, and that nothing reads any more."""

BEFORE: dict[str, Any] = {
    "env.horizon_factor": 1.0,
    "env.retry_share": 0.0,
    "method.localisation_weight": 0.0,
    "method.memory_weight": 0.0,
    "method.replay_ratio": 0,
    "method.imitate_still": True,
    "train.ema_decay": 0.0,
}
"""What a key had been before it existed: a whole configuration that lacks it was saved then."""


def idle_keys(tree: Mapping[str, Any]) -> set[str]:
    """Dotted keys that an unchecked configuration has no say in: those its method does not read, or fixes."""
    section = tree.get("method")
    section = settle(section if isinstance(section, Mapping) else {})
    method = METHODS.get(str(section.get("name", "vhs")))
    if method is None:
        return set()
    unread = {key for key, _ in unread_keys(method.parts(str(section["embedding"])))}
    return unread | {f"method.{key}" for key in method.fixed}


def _is_below(value: Any, limit: float) -> bool:
    """Whether a value that is not checked yet is a number below the limit."""
    try:
        return float(value) < limit
    except (TypeError, ValueError):
        return False
