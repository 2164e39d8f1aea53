"""What a task is: an environment, how its observations are read, how its episodes are judged.

A `Task` is what a user says of an environment; a `TaskSpec` is what follows from it for buffers and networks,
read off the environment's spaces and one observation. Everything that trains, evaluates or shows goes through
these two and knows no environment by name. numpy alone at import: gymnasium comes with the first space.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from enum import IntEnum
from importlib import import_module
from inspect import Parameter, signature
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from numpy.typing import DTypeLike

from vhs._core import ArgumentError, Field
from vhs.actions import action_sizes, doer
from vhs.asking import asking
from vhs.readers import GoalDict, GoalReader, Instruction, Seen, entries_of, reader_of

if TYPE_CHECKING:
    import gymnasium
    from gymnasium import spaces

__all__ = [
    "GoalDict",
    "GoalReader",
    "Instruction",
    "Judge",
    "Motion",
    "Move",
    "Outcome",
    "OutcomeReward",
    "Seen",
    "Task",
    "TaskSpec",
    "Turn",
    "default_outcome",
    "last_actions",
    "read_spec",
    "reader_of",
]


class Outcome(IntEnum):
    """How an episode ended, in the numbers of the Rust core."""

    SUCCESS = 0
    """The instructed goal was reached, by the instructed interaction where there is one."""
    FAILURE = 1
    """Another goal or another interaction ended the episode."""
    TIMEOUT = 2
    """The time ran out."""

    @classmethod
    def from_name(cls, name: str) -> Self:
        """The outcome called "success", "failure" or "timeout".

        Raises:
            ArgumentError: For any other name.
        """
        for outcome in cls:
            if outcome.name.lower() == name:
                return outcome
        names = ", ".join(f'"{outcome.name.lower()}"' for outcome in cls)
        raise ArgumentError(f"`name`: expected one of {names}, got {name!r}")


Judge = Callable[[float, bool, bool, dict[str, Any]], Outcome]
"""(reward, terminated, truncated, info) of the last step -> outcome."""


@dataclass(frozen=True, slots=True)
class OutcomeReward:
    """Rewards by how an episode ends, in place of the environment's."""

    success: float = 10.0
    failure: float = -1.0
    timeout: float = -0.1
    step: float = -0.01
    """Of every step, the last one included."""

    def of(self, outcome: Outcome | None) -> float:
        """The reward of a step: of the one that ended its episode so, or of another where it is None."""
        return self.step + (0.0 if outcome is None else getattr(self, outcome.name.lower()))


@dataclass(frozen=True, slots=True, kw_only=True)
class Move:
    """What an action does to the pose where nothing is in the way: a move in the agent's own frame."""

    forward_m: float = 0.0
    """Along the heading, in metres or whatever unit all moves of a task share."""
    left_m: float = 0.0
    """Across it, in the same unit."""

    @property
    def pose_change(self) -> tuple[float, float, float]:
        """Metres forward, metres to the left, radians to the left."""
        return self.forward_m, self.left_m, 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Turn:
    """What an action does to the pose: a turn on the spot."""

    deg: float
    """Degrees, positive to the left."""

    @property
    def pose_change(self) -> tuple[float, float, float]:
        """Metres forward, metres to the left, radians to the left."""
        return 0.0, 0.0, math.radians(self.deg)


Motion = Move | Turn
"""What one action does to the pose."""


def default_outcome(reward: float, terminated: bool, truncated: bool, info: dict[str, Any]) -> Outcome:
    """What the environment says, in the first of these ways that it has.

    `info["outcome"]`, a name; `info["is_success"]` or `info["success"]`, where not true a terminated episode
    is a failure and another a timeout; terminated with a positive reward is a success, with another a
    failure; the rest is a timeout.
    """
    if "outcome" in info:
        return Outcome.from_name(info["outcome"])
    for word in ("is_success", "success"):
        if word in info:
            return Outcome.SUCCESS if info[word] else Outcome.FAILURE if terminated else Outcome.TIMEOUT
    if terminated:
        return Outcome.SUCCESS if reward > 0 else Outcome.FAILURE
    return Outcome.TIMEOUT


@dataclass(frozen=True, slots=True)
class TaskSpec:
    """Sizes and types of a task: all that a buffer, a network or a learner needs to know of it."""

    frame_shape: tuple[int, ...]
    num_actions: int
    """Numbered actions, from 0; 1, which nobody takes, where actions are continuous."""
    max_episode_steps: int
    frame_dtype: DTypeLike = np.uint8
    action_dim: int = 0
    """Numbers in a continuous action, each in -1..1, its bounds; 0 where actions are numbered."""
    action_parts: tuple[int, ...] = ()
    """Options of each of several choices that one number stands for (`vhs.actions`); else empty."""
    goals: Literal["labels", "observations", "vectors"] = "labels"
    """What a goal is: a class, an observation or a vector."""
    num_goals: int = 1
    """Goal classes."""
    goal_shape: tuple[int, ...] = ()
    """Of a goal that is a vector."""
    goal_dtype: DTypeLike = np.float32
    fields: Mapping[str, Field] = field(default_factory=dict)
    """Further arrays of an observation, beside the frame."""
    interactions: Mapping[int, int] = field(default_factory=dict)
    """Action -> the interaction that it does; the other actions are moves."""
    num_interactions: int = 0
    """Interactions that can be instructed; 0 where an instruction names none."""
    success_reward: float | None = None
    """What the environment pays for the last step of a success; None where nobody said."""
    moves: Mapping[int, tuple[float, float, float]] | None = None
    """Action -> what it does to the pose: metres forward, metres to the left, radians to the left; the other
    actions leave it as it is. None where nobody said."""
    is_touched_told: bool = False
    """Whether the task says at which steps something was reached."""
    can_last: bool = False
    """Whether the environment is told how many steps an episode may last."""
    is_replayable: bool = True
    """Whether a seed and actions repeat an episode."""

    @property
    def can_localise(self) -> bool:
        """Whether hindsight can say where what was reached had been.

        The moves are known then, goals are classes and frames are pictures.
        """
        is_picture = np.dtype(self.frame_dtype) == np.uint8 and len(self.frame_shape) == 3
        return bool(self.moves) and self.goals == "labels" and is_picture

    @property
    def has_classes(self) -> bool:
        """Whether goals are of classes: alone, or named beside the pictures or vectors that are told."""
        return self.goals == "labels" or self.num_goals > 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """What a user says of an environment; everything but `make` may be left out."""

    make: str | Callable[..., gymnasium.Env[Any, Any]]
    """Makes one environment: a function, or an id of gymnasium's, ``EnvId`` or ``module:EnvId``.

    For pictures it gets ``render_mode="rgb_array"`` where it takes that.
    """
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    """What it is called with; the `env.kwargs` of a configuration go over them."""
    name: str = ""
    """In file names and tables; a task that is found by its file or its module has that name otherwise."""
    title: str = ""
    """For people; the name where it is empty."""
    read: GoalReader | None = None
    """Observation -> `Seen`; None: by the observation space, `GoalDict` or `Instruction`."""
    judge: Judge = default_outcome
    """Says how an episode ended."""
    reward: OutcomeReward | None = None
    """None: what the environment pays."""
    max_steps: int | None = None
    """Of the longest episode; None: that of the environment's registration."""
    max_steps_keyword: str | None = None
    """What `make` calls `max_steps`, which it is given then: an environment that counts its steps can be
    asked for longer episodes, as training does (`env.horizon_factor`)."""
    interactions: Mapping[int, int] = field(default_factory=dict)
    """Action -> the interaction that it does; actions count from 0, whatever their space begins with."""
    success_reward: float | None = None
    """What the environment pays for the last step of a success, where the method asks for it."""
    goals: tuple[str, ...] | None = None
    """Names of the goal classes; None: numbers."""
    limit_ends: bool = False
    """Whether the limit of steps is a part of the task, whose last step is worth what it pays; False: it cuts
    off what would have gone on, and the critic says what would have come (`truncated` of gymnasium)."""
    moves: Mapping[int, Motion] | None = None
    """What each action does to the pose, where known: hindsight localisation needs it, nothing else does."""
    touched: Callable[[Mapping[str, Any]], bool] | None = None
    """`info` of any step -> whether it reached something that could have been the goal, right or wrong, and
    may go on; what did not succeed is relabelled as if it had ended at the last such step. None:
    only an end reaches anything."""
    replayable: bool = True
    """Whether a seed and actions repeat an episode bit for bit; a resumed run drops what it cannot repeat."""

    # For people and evaluation alone; what is missing is left out of tables, charts and pictures.
    actions: tuple[str, ...] = ()
    """Names of the actions."""
    keys: Mapping[str, int] = field(default_factory=dict)
    """Key, as Tk calls it -> action, for a person who plays."""
    reached: Callable[[Mapping[str, Any]], int] | None = None
    """`info` of the last step -> the goal class that was reached, -1 for none."""
    shortest: Callable[[gymnasium.Env[Any, Any]], int | None] | None = None
    """Fewest steps to success from the start of an episode, of the environment without its wrappers; None
    where there is no way."""
    metrics: tuple[str, ...] = ()
    """Numbers in `info` of the last step whose means an evaluation shows."""

    def __post_init__(self) -> None:
        """Check what follows from no environment.

        Raises:
            ArgumentError: For a keyword that nothing is to be given, or that is given twice.
        """
        keyword = self.max_steps_keyword
        if keyword is not None and self.max_steps is None:
            raise ArgumentError(f"`max_steps`: expected a number to call `make` with as {keyword}, got None")
        if keyword is not None and keyword in self.kwargs:
            raise ArgumentError(
                f"`kwargs`: expected no {keyword}, as `max_steps` says {self.max_steps}, "
                f"got {self.kwargs[keyword]!r}"
            )

    def new_env(self, *, rendering: bool = False) -> gymnasium.Env[Any, Any]:
        """One environment; `rendering` asks for one that `render` draws, where there is such a one."""
        kwargs = dict(self.kwargs)
        if self.max_steps_keyword is not None:
            kwargs[self.max_steps_keyword] = self.max_steps
        if rendering and _can_render(self.make):
            kwargs.setdefault("render_mode", "rgb_array")
        if isinstance(self.make, str):
            import gymnasium

            return gymnasium.make(self.make, **kwargs)
        return self.make(**kwargs)

    def reader(self, env: gymnasium.Env[Any, Any]) -> GoalReader:
        """`read`, or what fits the observation space.

        Raises:
            ArgumentError: For a space that says nothing of goals where `read` is None.
        """
        return self.read or reader_of(env.observation_space, "read")

    def spec(self) -> TaskSpec:
        """Sizes and types of this task, read off an environment that is closed again.

        Raises:
            ArgumentError: As for `read_spec`; for names or interactions that do not fit the environment.
        """
        with asking(self.name, "make"):
            env = self.new_env()
        with closing(env):
            return self._spec_of(env)

    def _spec_of(self, env: gymnasium.Env[Any, Any]) -> TaskSpec:
        # A reset may draw, and an OpenGL context opened before workers are forked is of no use to them: where
        # the space alone says how to read an observation, a sample of it will do.
        observation = env.observation_space.sample() if self.read is None else env.reset()[0]
        reader = self.reader(env)
        with asking(self.name, "read"):
            seen = reader(observation)
        if self.max_steps is None and not (env.spec and env.spec.max_episode_steps):
            raise ArgumentError(f"`max_steps`: expected a number, as {self.name} registers none, got None")
        spec = read_spec(
            env,
            observation,
            reader=lambda _: seen,
            max_episode_steps=self.max_steps,
            num_goals=None if self.goals is None else len(self.goals),
            interactions=self.interactions,
            success_reward=self.reward.of(Outcome.SUCCESS) if self.reward else self.success_reward,
        )
        self._check_names(env, spec)
        doer(env.action_space)  # refuses what no policy can express
        self._check_moves(spec)
        if self.moves is not None:
            spec = replace(spec, moves={action: motion.pose_change for action, motion in self.moves.items()})
        spec = replace(
            spec,
            is_touched_told=self.touched is not None,
            can_last=self.max_steps_keyword is not None,
            is_replayable=self.replayable,
        )
        if len(spec.frame_shape) == 2:
            # What embeds frames wants channels: a grey picture has one.
            return replace(spec, frame_shape=(*spec.frame_shape, 1))
        return spec

    def _check_names(self, env: gymnasium.Env[Any, Any], spec: TaskSpec) -> None:
        named = {"interactions": self.interactions, "keys": self.keys.values()}
        for name, actions in named.items():
            beyond = max(actions, default=0)
            if beyond >= spec.num_actions:
                raise ArgumentError(f"`{name}`: expected actions below {spec.num_actions}, got {beyond}")
        told = _classes(env.observation_space, "interaction")
        if told is not None and told > max(1, spec.num_interactions):
            raise ArgumentError(
                f"`interactions`: expected which action does which of the {told} interactions that "
                f"{self.name} instructs, got {dict(self.interactions)}"
            )
        if self.actions and len(self.actions) != spec.num_actions:
            raise ArgumentError(
                f"`actions`: expected {spec.num_actions} names, one an action of {self.name}, "
                f"got {len(self.actions)}"
            )
        told = _classes(env.observation_space, "goal")
        if self.goals is not None and told is not None and len(self.goals) != told:
            raise ArgumentError(
                f"`goals`: expected {told} names, one a goal class of {self.name}, got {len(self.goals)}"
            )

    def _check_moves(self, spec: TaskSpec) -> None:
        for action, move in (self.moves or {}).items():
            if spec.action_dim or not 0 <= action < spec.num_actions:
                numbers = 0 if spec.action_dim else spec.num_actions
                raise ArgumentError(f"`moves`: expected one of {numbers} numbered actions, got {action}")
            if not isinstance(move, Move | Turn) or not np.isfinite(move.pose_change).all():
                raise ArgumentError(
                    f"`moves`: expected a Move or a Turn by a finite number for action {action}, got {move}"
                )

    def goal_name(self, label: int) -> str:
        """A goal class for people."""
        return f"goal {label}" if self.goals is None else self.goals[label].replace("_", " ")

    def action_name(self, action: int | list[float]) -> str:
        """An action for people."""
        if isinstance(action, list):
            return ", ".join(f"{number:.2f}" for number in action)
        return self.actions[action] if self.actions else f"action {action}"


def lengthened(task: Task, spec: TaskSpec, factor: float) -> tuple[Task, TaskSpec]:
    """A task, and what follows from it, whose episodes may last so many times as long."""
    longest = max(round(spec.max_episode_steps * factor), spec.max_episode_steps)
    if longest == spec.max_episode_steps:
        return task, spec
    return replace(task, max_steps=longest), replace(spec, max_episode_steps=longest)


def last_actions(num_actions: int, num_interactions: int) -> dict[int, int]:
    """The `interactions` of a task whose last actions interact, in their order."""
    first = num_actions - num_interactions
    return {first + interaction: interaction for interaction in range(num_interactions)}


def read_spec(
    env: gymnasium.Env[Any, Any],
    observation: Any,
    *,
    reader: GoalReader | None = None,
    max_episode_steps: int | None = None,
    num_goals: int | None = None,
    interactions: Mapping[int, int] | None = None,
    num_interactions: int = 0,
    success_reward: float | None = None,
) -> TaskSpec:
    """Sizes and types, read off an environment's spaces and one observation.

    Args:
        env: Any environment that says what it wants.
        observation: One of its observations.
        reader: Turns an observation into a `Seen`; None: by the observation space.
        max_episode_steps: Of the longest episode; None: that of the environment's registration.
        num_goals: Goal classes, where an instruction names one; None: those of the space's "goal", else 1.
        interactions: Action, counted from 0, -> the interaction that it does.
        num_interactions: That can be instructed, where `interactions` names fewer.
        success_reward: For the spec.

    Raises:
        ArgumentError: For an environment without a limit of steps where none is given, or with actions of a
            kind that `vhs.actions` does not know; for an observation that says nothing of goals.
    """
    seen = (reader or reader_of(env.observation_space))(observation)
    limit = max_episode_steps or (env.spec.max_episode_steps if env.spec else None)
    if limit is None:
        raise ArgumentError("`max_episode_steps`: expected a number, got None from the environment")
    frame = np.atleast_1d(seen.frame)
    actions = action_sizes(env.action_space)
    interactions = dict(interactions or {})
    if num_goals is None:
        num_goals = _classes(env.observation_space, "goal") or 1
    goals: dict[str, Any] = {}
    if seen.achieved_goal is not None:
        goal = np.atleast_1d(seen.achieved_goal)
        goals = {"goals": "vectors", "goal_shape": goal.shape, "goal_dtype": _stored(goal.dtype)}
    elif seen.desired_goal is not None:
        goals = {"goals": "observations"}
    return TaskSpec(
        frame_shape=frame.shape,
        max_episode_steps=limit,
        frame_dtype=_stored(frame.dtype),
        num_goals=num_goals,
        interactions=interactions,
        num_interactions=max([num_interactions, *(done + 1 for done in interactions.values())]),
        success_reward=success_reward,
        fields={name: _field(part) for name, part in seen.fields.items()},
        **actions._asdict(),
        **goals,
    )


def _classes(space: spaces.Space[Any], entry: str) -> int | None:
    """How many numbers, from 0, an entry of an observation can name; None where it names none."""
    from gymnasium import spaces

    found = entries_of(space).get(entry)
    return int(found.start + found.n) if isinstance(found, spaces.Discrete) else None


def _field(part: Any) -> Field:
    """What a further array of an observation is; numbers of Python's are float32."""
    dtype = part.dtype if isinstance(part, np.ndarray | np.generic) else np.dtype(np.float32)
    return Field(np.shape(part), dtype)


def _stored(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """The type in which a buffer keeps numbers of this one."""
    return np.dtype(np.uint8) if dtype == np.bool_ else dtype


def _can_render(make: str | Callable[..., Any]) -> bool:
    """Whether what makes an environment takes ``render_mode="rgb_array"``."""
    if isinstance(make, str):
        import gymnasium
        from gymnasium.envs.registration import load_env_creator

        module, _, name = make.rpartition(":")
        if module:
            import_module(module)
        entry = gymnasium.spec(name).entry_point
        creator = load_env_creator(entry) if isinstance(entry, str) else entry
        return "rgb_array" in getattr(creator, "metadata", {}).get("render_modes", ())
    found = signature(make).parameters
    return "render_mode" in found or any(one.kind is Parameter.VAR_KEYWORD for one in found.values())
