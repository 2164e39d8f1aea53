"""The compiled half of `vhs`: storage of goals and episodes, relabelling, returns.

Conventions of every function here:

* Images and goal vectors have exactly the dtype that the structure was built with: uint8 unless said. Integer
  arguments may be any numpy integer array or a sequence of integers, real ones any float or integer array or
  sequence; what is not int64 or float32 already is converted. Arrays with gaps are copied first.
* Results are writable numpy arrays; `torch.from_numpy` shares their memory. Large ones lie in memory that vhs
  uses again once the last array that shows it is gone: fresh memory is many times slower to fill. Where a
  function takes `out`, it writes into that array (of exactly the documented dtype and shape, C-contiguous,
  writable) and returns it.
* A call that raises has changed nothing. Every message names what was expected and what was found. All
  exceptions derive from `VhsError`, except those of the operating system (`OSError`) and what Python itself
  says of an argument of a kind that the signature rules out, such as a word for a number (`TypeError`).
* A forked child may use what its parent made, also where threads of the parent used it at that moment. It
  draws of its own: from its first call on, the generator of its copy goes on from another state, which
  follows from the parent's and from how many children the parent had before. Workers of a data loader so
  draw different batches, in every epoch, and the same ones when the program runs again. A buffer on disk
  belongs to the process that made it: a forked copy is refused (`ArgumentError`).
* Calls that take long (`save`, `load`, `verify`, batches of more than 128 MB) hear Ctrl-C: they are given up,
  and nothing has changed.
* The interpreter is released while bytes are copied, and every object may be used from several threads.
* Randomness comes from seeded generators that belong to the objects or are passed in, never from a global:
  the same seed and the same calls in the same order give the same results, whatever the number of threads
  elsewhere.
"""

from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from typing import Any, Literal, TypedDict, final

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

__all__ = [
    "ArgumentError",
    "DamagedFileError",
    "DtypeError",
    "EmptyError",
    "EpisodeBatch",
    "EpisodeBuffer",
    "EpisodeError",
    "Field",
    "GoalStore",
    "Hindsight",
    "LabelError",
    "LayoutError",
    "NonFiniteError",
    "OutOfMemoryError",
    "ProtocolError",
    "Prototypes",
    "RasterCanvas",
    "RasterScene",
    "RasterSource",
    "Rng",
    "RolloutLearner",
    "RolloutWorker",
    "ShapeError",
    "SparseReward",
    "TransitionBatch",
    "UnsupportedError",
    "VhsError",
    "WindowBatch",
    "discounted_returns",
    "egomotion",
    "relabel",
]

__version__: str

_Strategy = Literal["final", "future", "episode", "random"]
# (achieved_goals, goals), or with ids and steps -> rewards, or (rewards, terminated)
_RewardFunction = Callable[..., Any]

class _PrototypesState(TypedDict):
    table: NDArray[np.float32]
    seen: NDArray[np.bool_]
    rng: NDArray[np.uint64]

@final
class GoalStore:
    """Images of achieved goals, by goal class (the paper's `D_g`, section 3.2).

    Each class is a ring: once it holds `capacity_per_class` images, the oldest makes room for the next. An
    image enters under the class the agent was *told* to reach; the class of a wrongly reached object is not
    known to it. Memory is taken as the rings fill.
    """

    def __new__(
        cls, num_classes: int, observation_shape: Sequence[int], capacity_per_class: int, seed: int = 0
    ) -> GoalStore:
        """An empty store.

        Args:
            num_classes: Goal classes, at least 1.
            observation_shape: Shape of one image, each size at least 1.
            capacity_per_class: Images kept of each class, at least 1.
            seed: Of the store's own generator, in 0..2**64.

        Raises:
            ArgumentError: For a size out of range, or sizes whose product no memory can hold.
        """

    def push(self, observation: ArrayLike, label: int) -> None:
        """Store a copy of an image.

        Args:
            observation: uint8, shape `observation_shape`.
            label: Goal class, in 0..num_classes.

        Raises:
            ShapeError, DtypeError, LabelError: For an argument that does not fit.
            OutOfMemoryError: When the store cannot grow.
        """

    def collect(self, buffer: EpisodeBuffer, ids: ArrayLike) -> int:
        """Store the final observation of each successful episode under its instructed goal class.

        Episodes with another outcome are skipped: what they reached is not known to the agent.

        Args:
            buffer: Holds the episodes; its `observation_shape` must be that of the store, its `dtype` uint8.
                A buffer that stacks frames as "channels" fills a store of pictures.
            ids: int64 [B], of finished episodes; one that comes twice is stored twice.

        Returns:
            How many images were stored.

        Raises:
            ShapeError: When the buffer's observations are of another shape.
            ArgumentError: When they are not unsigned bytes.
            LabelError: When a goal of the buffer is not a class of the store.
            EpisodeError: When an id was evicted or never existed.
        """

    def sample(
        self, n: int, *, balanced: bool = True, out: NDArray[np.uint8] | None = None
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """Draw images with replacement.

        Args:
            n: Images to draw, at least 1.
            balanced: True: the non-empty classes get as equal a share of `n` as can be, what is left over
                falls to random ones, and the order is random. False: all stored images are equally likely.
            out: uint8 [n, *observation_shape], written and returned.

        Returns:
            Images uint8 [n, *observation_shape] and their classes int64 [n].

        Raises:
            EmptyError: When nothing is stored.
            ArgumentError: For `n` below 1.
            ShapeError, DtypeError, LayoutError: For an `out` that does not fit.
        """

    def sample_class(self, label: int, n: int, *, out: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
        """Draw images of one class, uniformly and with replacement.

        Args:
            label: Goal class, in 0..num_classes.
            n: Images to draw, at least 1.
            out: uint8 [n, *observation_shape], written and returned.

        Returns:
            Images uint8 [n, *observation_shape].

        Raises:
            EmptyError: When the class holds no image.
            LabelError, ArgumentError: For a label or an `n` out of range.
            ShapeError, DtypeError, LayoutError: For an `out` that does not fit.
        """

    def save(self, path: str | PathLike[str]) -> None:
        """Write the store to a file, generator included.

        A temporary file beside it is written, synced and renamed over `path`: whoever reads sees the old file
        or the new one. A symbolic link stays, and the file that it leads to is replaced; a file keeps its
        mode. Images are written from where they lie, as they are when the call begins: other threads go on
        meanwhile, and an image that they overwrite is kept until the call ends.

        Raises:
            OSError: The fitting subclass, such as PermissionError, and for a path that is no file (a device,
                a pipe, a directory); the file is then as it was, or new and whole where only its directory
                could not be synced.
        """

    @staticmethod
    def load(
        path: str | PathLike[str], *, mmap: bool = False, stacking: Literal["frames", "channels"] = "frames"
    ) -> GoalStore:
        """Read a store that `save` wrote; it goes on with the same batches and overwrites in the same order.

        Args:
            path: Of the file.
            mmap: True: at once; an image is read from the file when it is first drawn. Images are then not
                checked (`verify` does that) and the file must not be edited in place or cut short meanwhile;
                `save` never does. Images pushed later go to memory, never to the file.
            stacking: "channels": images saved as stacks of frames, [S, H, W, C], become pictures,
                [H, W, S * C], for a buffer that stacks so; others stay as they are.

        Raises:
            OSError: The fitting subclass, such as FileNotFoundError.
            DamagedFileError: For a file of another kind or version, cut short or altered.
            ArgumentError: For an unknown stacking.
        """

    @staticmethod
    def verify(path: str | PathLike[str]) -> None:
        """Compare every checksum of a saved store, without keeping anything in memory.

        Raises:
            OSError, DamagedFileError: As for `load`.
        """

    @property
    def counts(self) -> NDArray[np.int64]:
        """Images stored of each class, int64 [num_classes]."""

    @property
    def rng_state(self) -> NDArray[np.uint64]:
        """State of the generator behind the draws, uint64 [4]; it can be set.

        Setting it raises ShapeError, DtypeError or ArgumentError for what is no state.
        """

    @rng_state.setter
    def rng_state(self, state: ArrayLike) -> None: ...
    @property
    def num_classes(self) -> int:
        """Goal classes."""

    @property
    def observation_shape(self) -> tuple[int, ...]:
        """Shape of one image."""

    @property
    def capacity_per_class(self) -> int:
        """Images that a class holds at most."""

    @property
    def nbytes(self) -> int:
        """Bytes set aside for images so far."""

    def __len__(self) -> int:
        """Images stored in all."""

@final
class Prototypes:
    """One mean feature vector a goal class (the paper's `p^x`, section 4.1, equation 4).

    A running mean with momentum: `p = momentum * p + (1 - momentum) * mean(batch)` for each class of a batch;
    the first batch sets it. `momentum=0` is the paper's exact mean of the batch.
    """

    def __new__(cls, num_classes: int, dim: int, momentum: float = 0.9, seed: int = 0) -> Prototypes:
        """A table in which no class has been seen.

        Args:
            num_classes: Goal classes, at least 1.
            dim: Numbers in one feature, at least 1.
            momentum: Weight of the past, in 0..=1.
            seed: Of the vectors that stand in for unseen classes, in 0..2**64.

        Raises:
            ArgumentError: For a number out of range.
        """

    def update(self, features: ArrayLike, labels: ArrayLike) -> None:
        """Move the prototypes of the classes in this batch towards the means of their features.

        Args:
            features: float32 [n, dim].
            labels: int64 [n], in 0..num_classes.

        Raises:
            ShapeError, DtypeError, LabelError: For an argument that does not fit.
            NonFiniteError: For NaN or infinity among the features.
        """

    def embed(self, labels: ArrayLike, *, out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """The prototype of each label; for a class never seen, a fresh N(0, 1) vector, redrawn on each call.

        Args:
            labels: int64 [n], in 0..num_classes.
            out: float32 [n, dim], written and returned.

        Returns:
            float32 [n, dim].

        Raises:
            LabelError, DtypeError: For labels that do not fit.
            ShapeError, DtypeError, LayoutError: For an `out` that does not fit.
        """

    def state_dict(self) -> _PrototypesState:
        """Copies of all that changes.

        Returns:
            "table" float32 [num_classes, dim], "seen" bool [num_classes], "rng" uint64 [4].
        """

    def load_state_dict(self, state: _PrototypesState | dict[str, Any]) -> None:
        """Go on from a state that `state_dict` of a table of the same size gave.

        Raises:
            KeyError: When an entry is missing.
            ShapeError, DtypeError, NonFiniteError, ArgumentError: For an entry that does not fit.
        """

    @property
    def table(self) -> NDArray[np.float32]:
        """A copy of the prototypes, float32 [num_classes, dim]; zeros where a class was never seen."""

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Whether each class has a prototype, bool [num_classes]."""

    @property
    def num_classes(self) -> int:
        """Goal classes."""

    @property
    def dim(self) -> int:
        """Numbers in one feature."""

    @property
    def momentum(self) -> float:
        """Weight of the past."""

@final
class Field:
    """What a further array of an `EpisodeBuffer` is, such as a compass beside an image.

    ```
    buffer = vhs.EpisodeBuffer((84, 84, 3), ..., fields={
        "compass": vhs.Field((2,)),
        "log_prob": vhs.Field(per="step"),
    })
    buffer.begin(0, frame, fields={"compass": compass})
    buffer.append(0, action, reward, value, frame, fields={"compass": compass, "log_prob": -0.7})
    ```
    """

    def __new__(
        cls,
        shape: Sequence[int] = (),
        dtype: DTypeLike = "float32",
        per: Literal["observation", "step"] = "observation",
        stacked: bool = False,
    ) -> Field:
        """A field.

        Args:
            shape: Of its array, each size at least 1; empty: one number.
            dtype: One of those of frames.
            per: "observation": it comes with every frame, T + 1 an episode. "step": with every action, T.
            stacked: Whether an observation has it of each of its stacked frames, in the way of the buffer's
                `stacking`, or of the newest alone; for fields of observations.

        Raises:
            DtypeError, ArgumentError: For a type or a word that is not one of those above.
        """

    @property
    def shape(self) -> tuple[int, ...]:
        """Of its array."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of its array."""

    @property
    def per(self) -> Literal["observation", "step"]:
        """What it comes with."""

    @property
    def stacked(self) -> bool:
        """Whether an observation has it of each of its stacked frames."""

    def __eq__(self, other: object, /) -> bool: ...
    def __hash__(self) -> int: ...
    def __getnewargs__(self) -> tuple[list[int], str, str, bool]: ...

@final
class EpisodeBuffer:
    """Whole episodes of many environments, each frame stored once although observations stack several.

    An environment is a *stream*. `begin` opens its episode, each `append` adds a step, `finish` closes it
    under a new id. An episode of T steps has frames 0..=T; observation t stacks the frames t - frame_stack +
    1 ..= t, oldest first, and repeats frame 0 where that reaches before the episode. Nothing ever crosses an
    episode border.

    Finished episodes stay until room is needed and then leave oldest first; open ones are never evicted.
    Frames take `frame_bytes * (steps + episodes)` bytes, taken as the buffer fills.

    Goals come in three kinds. "labels": an episode is told a class number, and reaches what it sees.
    "observations": it is told an observation. "vectors": it is told a vector, and one that says what was
    reached comes beside each frame, as in goal-conditioned environments.

    Several threads may read at once while one writes; no reader sees half an episode. Each sampling call
    takes one number from the buffer's generator: the same calls in the same order give the same batches.
    """

    def __new__(
        cls,
        frame_shape: Sequence[int],
        *,
        num_streams: int,
        max_episode_steps: int,
        capacity_steps: int,
        frame_stack: int = 2,
        stacking: Literal["frames", "channels"] = "frames",
        num_goals: int = 1,
        num_actions: int | None = None,
        first_action: int = 0,
        interactions: Mapping[int, int] | None = None,
        num_interactions: int | None = None,
        dtype: DTypeLike = "uint8",
        goals: Literal["labels", "observations", "vectors"] = "labels",
        goal_shape: Sequence[int] | None = None,
        goal_dtype: DTypeLike | None = None,
        fields: Mapping[str, Field] | None = None,
        action_dim: int = 0,
        priority_exponent: float | None = None,
        backing: str | PathLike[str] = "memory",
        persistent: bool = False,
        seed: int = 0,
    ) -> EpisodeBuffer:
        """An empty buffer.

        Args:
            frame_shape: Shape of one frame, each size at least 1.
            num_streams: Environments that feed the buffer, at least 1.
            max_episode_steps: Steps of the longest episode, at least 1.
            capacity_steps: Steps kept over all episodes, at least `num_streams * max_episode_steps`.
            frame_stack: Frames in one observation, at least 1.
            stacking: How they lie in it. "frames": [frame_stack, *frame_shape], oldest first. "channels":
                frames [H, W, C] make one picture [H, W, frame_stack * C], of each pixel the oldest frame's
                channels first, as networks for pictures with the channels last want it.
            num_goals: Goal classes, at least 1.
            num_actions: Actions in all; None: any number from `first_action` on is one.
            first_action: The smallest number of an action, as the environment counts them: numbers are stored
                and given back as they are.
            interactions: The interaction that each action does, such as {3: 0, 4: 1}; the others are moves.
                What a relabelled episode did follows from it: needed where there are several interactions.
            num_interactions: Interactions; None: as many as `interactions` names. With 0 or 1, every episode
                has interaction 0, whatever its actions.
            dtype: Of frames: bool, uint8 to uint64, int8 to int64, or float16 to float64.
            goals: What a goal is; see above.
            goal_shape: Of a goal, where goals are vectors.
            goal_dtype: Of a goal, where goals are vectors; None: float32.
            fields: Further arrays of observations or steps by name, such as {"compass": Field((2,))}; stored
                once, and in the `fields` of every batch.
            action_dim: Numbers in a continuous action; 0: actions are numbered.
            priority_exponent: Of prioritised draws, in 0..=1: a step's odds are its priority to this power
                (alpha). None: steps have no priorities.
            backing: "memory"; "lz4", memory where each frame is compressed without loss; or the path of a
                scratch file that does not exist yet and may grow larger than memory. The file vanishes with
                the buffer, however the process ends; `save` is what keeps episodes. Any other bare word is
                refused: "./scratch" is a file.
            persistent: True: `backing` is a folder, made or empty, that stays: `reopen` goes on with it, also
                after a kill. As long as the buffer lives, nobody else may change its files.
            seed: Of the generator behind sampling, in 0..2**64.

        Raises:
            ArgumentError: For a number out of range, sizes whose product no memory can hold, or several
                interactions and no word of which action does which.
            DtypeError: For a type that is not one of those above.
            OSError: When the scratch file or the folder cannot be made.
        """

    def begin(
        self,
        stream: int,
        frame: ArrayLike,
        goal: int = 0,
        interaction: int = 0,
        *,
        desired_goal: ArrayLike | None = None,
        achieved_goal: ArrayLike | None = None,
        fields: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        """Open an episode.

        Args:
            stream: In 0..num_streams.
            frame: The first frame, shape `frame_shape`.
            goal: Instructed goal class, in 0..num_goals.
            interaction: Instructed interaction, in 0..num_interactions.
            desired_goal: The goal told, shape `goal_shape`; where goals are observations or vectors.
            achieved_goal: The goal reached at the first frame, shape `goal_shape`; where goals are vectors.
            fields: The first of each field of observations, of its shape and dtype; none of steps.

        Raises:
            ProtocolError: When the stream has an open episode already.
            ShapeError, DtypeError, LabelError: For an argument that does not fit or is missing.
            ArgumentError: For a field that is missing, or that the buffer does not have.
        """

    def append(
        self,
        stream: int,
        action: int | ArrayLike,
        reward: float,
        value: float | None,
        frame: ArrayLike,
        *,
        achieved_goal: ArrayLike | None = None,
        fields: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        """Add one step to the open episode of a stream.

        Args:
            stream: In 0..num_streams.
            action: Taken at the newest frame: a number, or float32 [action_dim].
            reward: Of the action.
            value: The critic's value when acting; None, for learners without one: 0.
            frame: The next frame, shape `frame_shape`.
            achieved_goal: The goal reached at that frame, shape `goal_shape`; where goals are vectors.
            fields: Of each field its array at that frame, or of the step, of its shape and dtype. Python's
                own numbers are taken where the dtype holds them.

        Raises:
            ProtocolError: When no episode is open, or it has `max_episode_steps` steps already.
            NonFiniteError: For a reward, value or action that is NaN or infinite.
            ShapeError, DtypeError, LabelError: For an argument that does not fit.
            ArgumentError: For a field that is missing, or that the buffer does not have.
        """

    def append_batch(
        self,
        streams: ArrayLike,
        actions: ArrayLike,
        rewards: ArrayLike,
        values: ArrayLike | None,
        frames: ArrayLike,
        *,
        achieved_goals: ArrayLike | None = None,
        fields: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        """Add one step to each of several open episodes; where one is refused, none is added.

        Args:
            streams: int64 [n], each at most once.
            actions: int64 [n], or float32 [n, action_dim].
            rewards: float32 [n].
            values: float32 [n], or None: zeros.
            frames: The next frames, [n, *frame_shape].
            achieved_goals: The goals reached at those frames, [n, *goal_shape]; where goals are vectors.
            fields: Of each field [n, *its shape], as for `append`.

        Raises:
            ArgumentError: When a stream comes twice; for a field, as for `append`.
            ProtocolError, NonFiniteError, ShapeError, DtypeError, LabelError: As for `append`.
        """

    def finish(self, stream: int, outcome: int | str, terminated: bool | None = None) -> int:
        """Close the open episode of a stream; its newest frame becomes the final observation.

        Args:
            stream: In 0..num_streams.
            outcome: A `vhs.Outcome`, or its name: "success", "failure" or "timeout".
            terminated: Whether the last step ended the task (True) or a limit cut it off (False). None: a
                timeout is cut off, anything else ended.

        Returns:
            The episode's id; ids count up from 0 in the order of `finish`.

        Raises:
            ProtocolError: When no episode is open, or it has no step yet.
            ArgumentError, LabelError: For an unknown outcome or stream.
        """

    def abort(self, stream: int) -> None:
        """Drop the open episode of a stream, as after a crash of its environment.

        Raises:
            ProtocolError: When no episode is open.
            LabelError: For an unknown stream.
        """

    def collect(
        self,
        buffer: EpisodeBuffer,
        ids: ArrayLike,
        *,
        steps: ArrayLike | None = None,
        stream: int = 0,
    ) -> NDArray[np.int64]:
        """Copy finished episodes of another buffer: to keep what is worth it out of what streams by.

        The oldest episodes here leave where room is needed. An episode that is cut keeps its outcome and
        counts as cut off.

        Args:
            buffer: Another one, of the same kind of frames, goals, fields and actions.
            ids: int64 [B], of its finished episodes; one that comes twice is copied twice.
            steps: int64 [B], how many of each episode's first steps to copy, at least 1; None: all.
            stream: Through which they are written; it must be between episodes.

        Returns:
            Their ids here, int64 [B], in the same order.

        Raises:
            ArgumentError: For a buffer of another kind, this buffer itself, or steps that an episode lacks;
                nothing is copied.
            EpisodeError: When an id was evicted or never existed; nothing is copied.
            ProtocolError: When the stream has an open episode, or an episode is longer than one here may be;
                nothing is copied.
            OutOfMemoryError, OSError: When this buffer cannot grow; the episodes before are there.
        """

    def observe(self, streams: ArrayLike | None = None, *, out: NDArray[Any] | None = None) -> NDArray[Any]:
        """The newest stacked observation of each stream, for acting.

        Args:
            streams: int64 [n]; None: all.
            out: [n, *observation_shape], of the buffer's dtype, written and returned.

        Returns:
            [n, *observation_shape], of the buffer's dtype.

        Raises:
            ProtocolError: When a stream has no open episode.
            LabelError, DtypeError: For streams that do not fit.
            ShapeError, DtypeError, LayoutError: For an `out` that does not fit.
        """

    def observe_fields(self, streams: ArrayLike | None = None) -> dict[str, NDArray[Any]]:
        """The fields of the newest observation of each stream, for acting: `observe` gives its frames.

        Args:
            streams: int64 [n]; None: all.

        Returns:
            Each field of observations by its name, [n, *shape], or [n, *stacked shape]; none of steps.

        Raises:
            ProtocolError: When a stream has no open episode.
            LabelError, DtypeError: For streams that do not fit.
        """

    def gather(
        self,
        ids: ArrayLike,
        *,
        also: tuple[EpisodeBuffer, ArrayLike] | None = None,
        padded: bool = False,
        out: NDArray[Any] | None = None,
    ) -> EpisodeBatch:
        """Copy finished episodes into a batch.

        Args:
            ids: int64 [B], at least one; an id may come more than once.
            also: Another buffer of the same kind and ids of its episodes, which follow in the batch: what was
                kept behind what has just ended.
            padded: True: observations are [B, T + 1, ...], zeros after an episode's end, instead of packed.
            out: [at least N, *observation_shape]; the batch's observations become a view of its
                first N rows (N is B * (T + 1) where padded).

        Raises:
            EpisodeError: When an id was evicted or never existed.
            ArgumentError: For no id, and for a buffer of another kind or this one as `also`.
            ShapeError, DtypeError, LayoutError: For an `out` that does not fit.
        """

    def sample_ids(self, n: int) -> NDArray[np.int64]:
        """Draw ids of finished episodes, uniformly and with replacement; `gather` has what lies under them.

        Args:
            n: Ids to draw, at least 1.

        Returns:
            int64 [n].

        Raises:
            EmptyError: When no finished episode is stored.
            ArgumentError: For n = 0.
        """

    def sample_episodes(
        self,
        n: int,
        relabel: Literal["final"] | None = None,
        probability: float = 1.0,
        on: Sequence[int | str] | None = None,
        *,
        padded: bool = False,
        out: NDArray[Any] | None = None,
    ) -> EpisodeBatch:
        """Draw finished episodes, uniformly and with replacement.

        Args:
            n: Episodes to draw, at least 1.
            relabel: None, or the strategy of `vhs.relabel`; the batch then has a `hindsight`.
                `probability` and `on` need one.
            probability: Of relabelling an eligible episode.
            on: Outcomes whose episodes are eligible; None: ("failure",).
            padded: As for `gather`.
            out: As for `gather`.

        Raises:
            EmptyError: When no finished episode is stored.
            ArgumentError: For a number or a word that is not known.
            ShapeError, DtypeError, LayoutError: For an `out` that does not fit.
        """

    def sample_transitions(
        self,
        n: int,
        relabel: _Strategy | None = None,
        *,
        probability: float | None = None,
        ratio: int | None = None,
        on: Sequence[int | str] | None = None,
        reward: SparseReward | _RewardFunction | None = None,
        out: dict[str, NDArray[Any]] | None = None,
        n_step: int = 1,
        gamma: float | None = None,
        beta: float | None = None,
    ) -> TransitionBatch:
        """Draw steps of finished episodes, with replacement, and give them goals (Andrychowicz et al. 2017).

        A relabelled step gets as its goal what its own episode reached at its end ("final"), after the step
        ("future"), or at any time ("episode"), or what any stored episode reached ("random"): always what an
        observation after a step reached, all of them equally likely.

        Args:
            n: Steps to draw, at least 1.
            relabel: The strategy, or None. `probability`, `ratio`, `on` and `reward` need one.
            probability: Of relabelling an eligible step, in 0..=1; 0.8 where no ratio is given either.
            ratio: Instead of a probability: of every ratio + 1 rows, all but the first are relabelled.
            on: Outcomes whose episodes are eligible; None: all.
            reward: How relabelled steps are rewarded. None: `SparseReward()`. A function is called once, with
                what all n steps reached and all n goals, [n, *goal] each, and returns rewards [n], or rewards
                and terminated (bool [n]); what it says of steps that are not relabelled is not used. Where it
                returns rewards alone, terminated stays as recorded. One with a true attribute `by_step` is
                called with two more arrays: id and step of each row, int64 [n] (of windows [n, W], steps -1
                beyond the end), for what a caller keeps beside the buffer.
            out: Arrays to write into, by the name of the batch's attribute: "observations",
                "next_observations", "goals", "achieved_goals", "previous_achieved_goals", or some of them.
            n_step: Steps that a reward is summed over: fewer where the episode ends before or, under the goal
                of the row, the task. `next_observations` come after the last of them. Above 1 it needs a
                `gamma`, and no function as `reward`.
            gamma: Discount of a step, in 0..=1, for the sums and `discounts`.
            beta: None: all steps are equally likely. A number in 0..=1: in proportion to their priorities,
                with `weights` that undo so much of it (Schaul et al. 2016).

        Raises:
            EmptyError: When no finished episode is stored.
            ArgumentError: For a number or a word that is not known, both a probability and a ratio, or a
                `beta` where steps have no priorities.
            NonFiniteError: When the function returns NaN or infinity.
            ShapeError, DtypeError, LayoutError: For an `out` or a reward that does not fit.
        """

    def update_priorities(self, ids: ArrayLike, steps: ArrayLike, priorities: ArrayLike) -> None:
        """Give steps new priorities, such as the errors just seen plus a small number.

        A new episode's steps have the largest priority that any step ever had.

        Args:
            ids: Episode of each step, int64 [n], as in a batch. Evicted ones are passed over.
            steps: Its number in the episode, int64 [n]. Where a step comes twice the last priority counts.
            priorities: float32 [n], each above 0.

        Raises:
            ArgumentError: For a priority that is not above 0, or a buffer without a `priority_exponent`.
            NonFiniteError: For one that is NaN or infinite.
            EpisodeError, LabelError: For an episode that never was, or a step that it does not have.
            ShapeError, DtypeError: For arrays that do not fit.
        """

    def sample_windows(
        self,
        n: int,
        length: int,
        burn_in: int = 0,
        relabel: _Strategy | None = None,
        *,
        probability: float | None = None,
        ratio: int | None = None,
        on: Sequence[int | str] | None = None,
        reward: SparseReward | _RewardFunction | None = None,
        out: NDArray[Any] | None = None,
        strict: bool = False,
    ) -> WindowBatch:
        """Draw parts of finished episodes with steps before them that warm a recurrent state.

        A window has up to `length` learned steps and up to `burn_in` before them, fewer at the ends of its
        episode, which it never leaves. An episode of T steps has T + length - 1 windows, from that of its
        first step alone to that of its last; all windows of all episodes are equally likely, so every step is
        learned from as often as any other. A window has one goal, relabelled as for `sample_transitions` for
        its first learned step: where a later step of it reaches the goal ("future", "episode"), the steps
        beyond are in the window too, and `terminated` says where the task under the new goal was over.

        Args:
            n: Windows to draw, at least 1.
            length: Learned steps of a window at most, at least 1.
            burn_in: Steps before them at most.
            relabel: As for `sample_transitions`.
            probability: As for `sample_transitions`.
            ratio: As for `sample_transitions`.
            on: As for `sample_transitions`.
            reward: As for `sample_transitions`; a function is called once, with [n, burn_in + length, *goal]
                of what each step reached and of its window's goal, the latter read-only.
            out: [n, burn_in + length + 1, *observation_shape], for the observations.
            strict: Draw full windows alone, of `length` learned steps: an episode of T steps has T - length
                + 1, a shorter one none, and steps at the ends of an episode come less often. A call walks
                over the stored episodes once.

        Raises:
            EmptyError: Also where `strict` and every episode is shorter than a window.
            EmptyError, ArgumentError, NonFiniteError, ShapeError, DtypeError, LayoutError: As for
                `sample_transitions`.
        """

    def clear(self) -> None:
        """Forget all finished episodes, as if newer ones had taken their room.

        Open ones go on, ids count on, and memory is used again.

        Raises:
            OSError: Where the buffer stays on the disk and its journal cannot be written.
        """

    @staticmethod
    def reopen(path: str | PathLike[str], *, check: bool = True) -> EpisodeBuffer:
        """Go on with the folder of a persistent buffer: its finished episodes under their ids, streams idle.

        Nothing is copied. What a kill left of a last entry is cut off. Drawing begins from another state of
        the generator, which follows from the seed and the episodes so far; priorities begin anew.

        Args:
            path: Of the folder.
            check: Whether to read all frames once, for their checksums. What a power cut left of the newest
                episodes is then dropped.

        Raises:
            OSError: The fitting subclass, such as FileNotFoundError.
            ArgumentError: For a folder that another buffer uses.
            DamagedFileError: For a journal or, with `check`, frames that were altered.
        """

    def save(self, path: str | PathLike[str]) -> None:
        """Write the finished episodes and the generator to a file, as `GoalStore.save` does.

        Open episodes are not part of it: they belong to environments that run now. Frames are written from
        where they lie, as they are when the call begins: other threads go on meanwhile, and the memory of
        episodes that are evicted is used again once the call ends.

        Raises:
            OSError: The fitting subclass, such as PermissionError, and for a path that is no file (a device,
                a pipe, a directory); the file is then as it was, or new and whole where only its directory
                could not be synced.
        """

    @staticmethod
    def load(
        path: str | PathLike[str], *, mmap: bool = False, backing: str | PathLike[str] = "memory"
    ) -> EpisodeBuffer:
        """Read a buffer that `save` wrote; it goes on with the same ids and the same batches, streams idle.

        Args:
            path: Of the file.
            mmap: True: at once; a frame is read from the file when it is first drawn, and not checked. As for
                `GoalStore.load`.
            backing: Where frames are read to, as for the constructor; not with `mmap`.

        Raises:
            OSError: The fitting subclass, such as FileNotFoundError.
            DamagedFileError: For a file of another kind or version, cut short or altered.
        """

    @staticmethod
    def verify(path: str | PathLike[str]) -> None:
        """Compare every checksum of a saved buffer, without keeping frames in memory.

        Raises:
            OSError, DamagedFileError: As for `load`.
        """

    @property
    def rng_state(self) -> NDArray[np.uint64]:
        """State of the generator behind sampling, uint64 [4]; settable, also to what another buffer gave.

        Setting it raises ShapeError, DtypeError or ArgumentError for what is no state.
        """

    @rng_state.setter
    def rng_state(self, state: ArrayLike) -> None: ...
    @property
    def ids(self) -> NDArray[np.int64]:
        """Ids of the finished episodes stored, oldest first, int64 [len(self)]."""

    @property
    def open(self) -> NDArray[np.bool_]:
        """Whether each stream has an open episode, bool [num_streams]."""

    @property
    def num_steps(self) -> int:
        """Steps stored, of finished and open episodes."""

    @property
    def nbytes(self) -> int:
        """Bytes set aside for frames, goals reached, fields and priorities so far."""

    @property
    def frame_shape(self) -> tuple[int, ...]:
        """Shape of one frame."""

    @property
    def observation_shape(self) -> tuple[int, ...]:
        """Shape of one observation, as `stacking` says: (frame_stack, *frame_shape), or of one picture."""

    @property
    def stacking(self) -> Literal["frames", "channels"]:
        """How the frames of an observation lie in it."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of frames."""

    @property
    def fields(self) -> dict[str, Field]:
        """Further arrays of observations and steps, by name."""

    @property
    def goals(self) -> Literal["labels", "observations", "vectors"]:
        """What a goal is."""

    @property
    def goal_shape(self) -> tuple[int, ...]:
        """Shape of what a step reaches: of a goal vector or an observation."""

    @property
    def goal_dtype(self) -> np.dtype[Any]:
        """Of what a step reaches."""

    @property
    def action_dim(self) -> int:
        """Numbers in a continuous action; 0 where actions are numbered."""

    @property
    def priority_exponent(self) -> float | None:
        """Exponent of prioritised draws; None where steps have no priorities."""

    @property
    def num_streams(self) -> int:
        """Environments that feed the buffer."""

    @property
    def max_episode_steps(self) -> int:
        """Steps of the longest episode."""

    @property
    def capacity_steps(self) -> int:
        """Steps kept over all episodes."""

    @property
    def frame_stack(self) -> int:
        """Frames in one observation."""

    @property
    def num_goals(self) -> int:
        """Goal classes."""

    @property
    def num_interactions(self) -> int:
        """Interactions."""

    @property
    def interactions(self) -> dict[int, int]:
        """The interaction that each action does; an action that is not among them is a move."""

    @property
    def num_actions(self) -> int | None:
        """Actions in all, interactions included; None where any number is one."""

    @property
    def first_action(self) -> int:
        """The smallest number of an action."""

    def __len__(self) -> int:
        """Finished episodes stored."""

@final
class EpisodeBatch:
    """B whole episodes as arrays; T is the length of the longest, N the sum of all `lengths + 1`.

    Observations are packed, episode by episode o_0 ..= o_T, unless `padded` was asked for; the arrays of
    steps are padded with zeros.
    `vhs.relabel` works on its own copy of lengths, outcomes and last actions: writing to the arrays does not
    change its result.
    """

    @property
    def observations(self) -> NDArray[Any]:
        """Stacked frames, [N, *observation_shape], or [B, T + 1, ...] where padded."""

    @property
    def desired_goals(self) -> NDArray[Any] | None:
        """The goals told, [B, *goal_shape]; None where goals are class numbers."""

    @property
    def achieved_goals(self) -> NDArray[Any] | None:
        """The goals reached, laid out as the observations; None where observations are what is reached."""

    @property
    def fields(self) -> dict[str, NDArray[Any]]:
        """Each field by its name: of observations laid out as these, of steps [B, T, *shape] as actions."""

    @property
    def terminated(self) -> NDArray[np.bool_]:
        """Whether each episode's last step ended the task, bool [B]."""

    @property
    def offsets(self) -> NDArray[np.int64]:
        """Row of each episode's first observation, int64 [B]; its final one is row `offsets + lengths`."""

    @property
    def lengths(self) -> NDArray[np.int64]:
        """Steps of each episode, int64 [B]."""

    @property
    def actions(self) -> NDArray[Any]:
        """Actions, int64 [B, T], or float32 [B, T, action_dim]."""

    @property
    def rewards(self) -> NDArray[np.float32]:
        """Rewards, float32 [B, T]."""

    @property
    def values(self) -> NDArray[np.float32]:
        """The critic's values when acting, float32 [B, T]."""

    @property
    def mask(self) -> NDArray[np.bool_]:
        """True inside the episode, bool [B, T]."""

    @property
    def goals(self) -> NDArray[np.int64]:
        """Instructed goal classes, int64 [B]."""

    @property
    def interactions(self) -> NDArray[np.int64]:
        """Instructed interactions, int64 [B]."""

    @property
    def outcomes(self) -> NDArray[np.uint8]:
        """Numbers of `vhs.Outcome`, uint8 [B]."""

    @property
    def ids(self) -> NDArray[np.int64]:
        """Ids, int64 [B]."""

    @property
    def hindsight(self) -> Hindsight | None:
        """The new goals, where `sample_episodes` was asked to relabel."""

    def __len__(self) -> int:
        """B."""

@final
class TransitionBatch:
    """n transitions as arrays: of one step each, or of as many as `lengths` says."""

    @property
    def observations(self) -> NDArray[Any]:
        """Stacked frames before the step, [n, *observation_shape]."""

    @property
    def next_observations(self) -> NDArray[Any]:
        """Stacked frames after the step, or the last of the row's, of the same shape."""

    @property
    def goals(self) -> NDArray[Any] | None:
        """Goals, [n, *goal_shape]: the new one where relabelled, else the one told.

        Where goals are class numbers: None if nothing was to be relabelled, and zeros in rows that are not.
        """

    @property
    def achieved_goals(self) -> NDArray[Any] | None:
        """Goals reached by the step, [n, *goal_shape]; None where `next_observations` are that."""

    @property
    def previous_achieved_goals(self) -> NDArray[Any] | None:
        """Goals reached before the step, [n, *goal_shape]; None where `observations` are that."""

    @property
    def fields(self) -> dict[str, NDArray[Any]]:
        """Each field by its name, [n, *shape] or [n, *stacked shape]: of `observations`, or of the step."""

    @property
    def next_fields(self) -> dict[str, NDArray[Any]]:
        """Each field of observations by its name, of `next_observations`; none of steps."""

    @property
    def actions(self) -> NDArray[Any]:
        """Actions, int64 [n], or float32 [n, action_dim]."""

    @property
    def rewards(self) -> NDArray[np.float32]:
        """Rewards under the row's goal, float32 [n]; the discounted sum where there are several steps."""

    @property
    def lengths(self) -> NDArray[np.int64] | None:
        """Steps that each reward is summed over, at most `n_step`, int64 [n]; None without a gamma."""

    @property
    def discounts(self) -> NDArray[np.float32] | None:
        """`gamma` to the power of `lengths`, float32 [n]: what is expected after the row is worth so much.

        None where no gamma was given.
        """

    @property
    def weights(self) -> NDArray[np.float32] | None:
        """(N P)^-beta over the batch's largest, float32 [n]; None where all steps were equally likely."""

    @property
    def terminated(self) -> NDArray[np.bool_]:
        """Whether the task ended with the step, bool [n]: nothing is to be expected after it."""

    @property
    def truncated(self) -> NDArray[np.bool_]:
        """Whether the episode was cut off after the step, bool [n]: the task would have gone on."""

    @property
    def relabelled(self) -> NDArray[np.bool_]:
        """Whether each row has a new goal, bool [n]."""

    @property
    def ids(self) -> NDArray[np.int64]:
        """Id of the episode that each row is from, int64 [n]."""

    @property
    def steps(self) -> NDArray[np.int64]:
        """Step in its episode, int64 [n]."""

    @property
    def goal_ids(self) -> NDArray[np.int64]:
        """Id of the episode that the new goal is from, int64 [n]; the row's own where not relabelled."""

    @property
    def goal_steps(self) -> NDArray[np.int64]:
        """Number of the observation that reached the new goal, int64 [n]; -1 where not relabelled."""

    @property
    def labels(self) -> NDArray[np.int64]:
        """Instructed goal classes, int64 [n]."""

    @property
    def interactions(self) -> NDArray[np.int64]:
        """The interaction done on reaching the new goal, int64 [n].

        The instructed one where the row is not relabelled or the action that reached the goal was a move.
        """

    def __len__(self) -> int:
        """N."""

@final
class WindowBatch:
    """n parts of episodes as arrays; W is burn_in + length. Steps are left-aligned, zeros after the last."""

    @property
    def observations(self) -> NDArray[Any]:
        """Stacked frames, [n, W + 1, *observation_shape]."""

    @property
    def goals(self) -> NDArray[Any] | None:
        """One goal a window, [n, *goal_shape]; as in `TransitionBatch`."""

    @property
    def achieved_goals(self) -> NDArray[Any] | None:
        """Goals reached by each observation, [n, W + 1, *goal_shape]; None where observations are that."""

    @property
    def fields(self) -> dict[str, NDArray[Any]]:
        """Each field by its name: of observations [n, W + 1, *shape], of steps [n, W, *shape]."""

    @property
    def actions(self) -> NDArray[Any]:
        """Actions, int64 [n, W], or float32 [n, W, action_dim]."""

    @property
    def rewards(self) -> NDArray[np.float32]:
        """Rewards under the window's goal, float32 [n, W]."""

    @property
    def values(self) -> NDArray[np.float32]:
        """The critic's values when acting, float32 [n, W]."""

    @property
    def terminated(self) -> NDArray[np.bool_]:
        """Whether the task ended with a step, bool [n, W]."""

    @property
    def truncated(self) -> NDArray[np.bool_]:
        """Whether the episode was cut off after a step, bool [n, W]."""

    @property
    def mask(self) -> NDArray[np.bool_]:
        """True for steps to learn from, bool [n, W]: not for burn-in and not after the last."""

    @property
    def burn_in(self) -> NDArray[np.int64]:
        """Steps before the first learned one, int64 [n]."""

    @property
    def lengths(self) -> NDArray[np.int64]:
        """Steps of each window, burn-in included, int64 [n]."""

    @property
    def relabelled(self) -> NDArray[np.bool_]:
        """Whether each row has a new goal, bool [n]."""

    @property
    def ids(self) -> NDArray[np.int64]:
        """Id of the episode that each row is from, int64 [n]."""

    @property
    def steps(self) -> NDArray[np.int64]:
        """First step of the window in its episode, int64 [n]."""

    @property
    def goal_ids(self) -> NDArray[np.int64]:
        """Id of the episode that the new goal is from, int64 [n]; the row's own where not relabelled."""

    @property
    def goal_steps(self) -> NDArray[np.int64]:
        """Number of the observation that reached the new goal, int64 [n]; -1 where not relabelled."""

    @property
    def labels(self) -> NDArray[np.int64]:
        """Instructed goal classes, int64 [n]."""

    @property
    def interactions(self) -> NDArray[np.int64]:
        """The interaction done on reaching the new goal, int64 [n].

        The instructed one where the row is not relabelled or the action that reached the goal was a move.
        """

    def __len__(self) -> int:
        """N."""

@final
class SparseReward:
    """The built-in reward of relabelled steps: one number where the goal is reached, another elsewhere."""

    def __new__(
        cls, reached: float = 0.0, otherwise: float = -1.0, tolerance: float = 0.0, terminates: bool = True
    ) -> SparseReward:
        """A rule.

        Args:
            reached: Reward of a step that reaches the goal.
            otherwise: Reward of any other step.
            tolerance: Largest Euclidean distance that counts as reached, for goal vectors; 0: the same bytes.
            terminates: Whether a step that reaches the goal ends the task.

        Raises:
            ArgumentError: For rewards that are not finite, or a tolerance that is negative or NaN.
        """

    def __eq__(self, other: object, /) -> bool: ...
    @property
    def reached(self) -> float:
        """Reward of a step that reaches the goal."""

    @property
    def otherwise(self) -> float:
        """Reward of any other step."""

    @property
    def tolerance(self) -> float:
        """Largest distance that counts as reached."""

    @property
    def terminates(self) -> bool:
        """Whether a step that reaches the goal ends the task."""

@final
class Hindsight:
    """The new goals of a batch, as row numbers: no image is copied."""

    @property
    def selected(self) -> NDArray[np.bool_]:
        """Whether each episode is relabelled, bool [B]."""

    @property
    def goal_rows(self) -> NDArray[np.int64]:
        """Row of each episode's final observation in `batch.observations`, int64 [B].

        The new goal where selected.
        """

    @property
    def interactions(self) -> NDArray[np.int64]:
        """The interaction that the last action did, int64 [B].

        The instructed one where the episode is not selected or its last action is a move.
        """

    @property
    def lengths(self) -> NDArray[np.int64]:
        """Steps of each episode to the observation of `goal_rows`, int64 [B]."""

@final
class Rng:
    """A seeded generator (xoshiro256++) that samplers draw from; the same output in every version of vhs."""

    def __new__(cls, seed: int = 0) -> Rng:
        """A generator whose whole output follows from the seed, an integer in 0..2**64."""

    @staticmethod
    def from_state(state: NDArray[np.uint64]) -> Rng:
        """A generator that goes on where the one with this state stood.

        Raises:
            ShapeError, DtypeError, ArgumentError: For what is not a state: uint64 [4], not all zero.
        """

    @property
    def state(self) -> NDArray[np.uint64]:
        """The state, uint64 [4]."""

def relabel(
    batch: EpisodeBatch,
    *,
    rng: Rng | int,
    strategy: Literal["final"] = "final",
    on: Sequence[int | str] | None = None,
    probability: float = 0.8,
    ends: ArrayLike | None = None,
) -> Hindsight:
    """Take what failed episodes reached as what they were told to reach (paper, section 4.2).

    An eligible episode gets, with the given probability, its own final observation as goal and the
    interaction of its last action as interaction. One number is drawn an episode, eligible or not.

    Args:
        batch: Episodes of `EpisodeBuffer.gather` or `sample_episodes`.
        rng: A generator, which moves on, or the seed of a fresh one.
        strategy: "final": the goal is the last thing the episode saw.
        on: Outcomes whose episodes are eligible; None: ("failure",).
        probability: Of relabelling an eligible episode, in 0..=1.
        ends: Steps of each episode until it last reached something, int64 [B], in 0..=length. It is
            relabelled as if it had ended there, and not at all with 0. None: each ends where it ended.

    Raises:
        ArgumentError: For an unknown strategy or outcome, or a probability or an end out of range.
        ShapeError: When `ends` has another length than the batch.
        DtypeError: When `on` is a single word, or `rng` neither a generator nor a seed.
    """

def discounted_returns(
    rewards: ArrayLike, lengths: ArrayLike, gamma: float, *, out: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """Monte-Carlo returns `R_t = r_t + gamma * R_(t+1)` of padded episodes.

    Args:
        rewards: float32 [B, T]; what lies after an episode's end is not read.
        lengths: Steps of each episode, int64 [B], in 0..=T.
        gamma: Discount a step, in 0..=1.
        out: float32 [B, T], written and returned.

    Returns:
        float32 [B, T], zero after each episode's end.

    Raises:
        ShapeError, DtypeError, LabelError, ArgumentError: For an argument that does not fit.
        NonFiniteError: For NaN or infinity inside an episode.
    """

def egomotion(
    actions: ArrayLike,
    blocked: NDArray[np.bool_],
    lengths: ArrayLike,
    moves: ArrayLike,
    *,
    ahead_m: float = 0.0,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Dead reckoning: where the end of each padded episode lay, seen from the beginning of each of its steps.

    The moves are undone one by one from the end; an action first moves and then turns. What lies after an
    episode's end is not read.

    Args:
        actions: int64 [B, T].
        blocked: Steps that went nowhere, bool [B, T]: their way is not counted, their turn is.
        lengths: Steps of each episode, int64 [B], in 0..=T.
        moves: What each action does, float32 [actions, 3]: metres forward, metres to the left, radians to the
            left.
        ahead_m: What is looked for lies so many metres in front of the last pose, at least 0.

    Returns:
        Bearings in radians, in -pi..=pi, 0 straight ahead and positive to the left, and distances in metres:
        float32 [B, T] each, zero after an episode's end.

    Raises:
        ShapeError, DtypeError, LabelError, ArgumentError: For an argument that does not fit.
        NonFiniteError: For a move that is NaN or infinite.
    """

@final
class RasterScene:
    """What a renderer draws, while it is being collected; `vhs.RasterRenderer` fills it from a model.

    Shapes and numbers are those of MuJoCo's model. A number that makes no picture raises ValueError, what is
    not drawn NotImplementedError.
    """

    def __new__(cls, slices: int, stacks: int, quads: int, far: float) -> RasterScene:
        """An empty scene: how finely round shapes and planes are divided, and the far plane in metres."""

    def add_texture(self, is_cube: bool, data: NDArray[np.uint8]) -> int:
        """Add a texture, uint8 [height, width, 3 or 4], and return its number."""

    def add_mesh(
        self,
        vertices: NDArray[np.float32],
        normals: NDArray[np.float32],
        uv: NDArray[np.float32],
        faces: NDArray[np.int32],
        face_normals: NDArray[np.int32],
        face_uv: NDArray[np.int32],
    ) -> int:
        """Add a mesh and return its number; no texture coordinates: `uv` and `face_uv` are empty."""

    def add_height_field(self, size: Sequence[float], heights: NDArray[np.float32]) -> int:
        """Add heights in 0..1, float32 [rows, columns], and return their number.

        `size`: half sizes along x and y, largest height, depth of the base, in metres.
        """

    def set_shadows(self, size: int, clip: float, scale: float) -> None:
        """Set the texels a side of a shadow map, half its side in metres, and its share of a spot's cone."""

    def set_fog(self, rgb: Sequence[float], start: float, end: float) -> None:
        """Set the colour of fog, and from where to where it thickens, in metres."""

    def set_sky(self, texture: int, haze_rgb: Sequence[float], haze_proportion: float) -> None:
        """Set the cube texture of the sky and the haze over the horizon."""

@final
class RasterSource:
    """Where a renderer finds what MuJoCo wants to have drawn: arrays that are read anew at every frame."""

    def __new__(
        cls,
        *,
        geoms: NDArray[np.uint8],
        geom_places: Sequence[int | None],
        lights: NDArray[np.uint8],
        light_places: Sequence[int | None],
        flags: NDArray[np.uint8],
        geom_size: NDArray[np.float64],
        mat_texid: NDArray[np.int32],
        mat_texuniform: NDArray[np.uint8],
        mat_texrepeat: NDArray[np.float32],
        textures: Sequence[int | None],
        meshes: Sequence[Sequence[int]],
        line_width: float,
    ) -> RasterSource:
        """Remember the arrays of an abstract scene (`mujoco.MjvScene`) and of its model.

        Args:
            geoms: Records of the scene's geoms, uint8 [most, bytes].
            geom_places: First byte of each field in a record, None for one that this MuJoCo lacks.
            lights: Records of the scene's lights, likewise.
            light_places: As `geom_places`.
            flags: The scene's flags.
            geom_size: The model's, float64 [ngeom, 3].
            mat_texid: The model's, int32 [nmat, roles].
            mat_texuniform: The model's, as bytes [nmat].
            mat_texrepeat: The model's, float32 [nmat, 2].
            textures: For each of the model's textures its number in the `RasterScene`; None: not shown.
            meshes: For each of the model's meshes its number in the `RasterScene` and that of its hull.
            line_width: Pixels.
        """

@final
class RasterCanvas:
    """A picture of fixed size that draws one scene; the interpreter is released while it draws."""

    def __new__(
        cls, scene: RasterScene, source: RasterSource, height: int, width: int, antialias: int
    ) -> RasterCanvas:
        """A canvas of a scene.

        Args:
            scene: Textures, meshes and height fields.
            source: What is drawn.
            height: Pixels.
            width: Pixels.
            antialias: 0 off, 1 multisample, 2 supersample.
        """

    def bind(
        self,
        geom_xpos: NDArray[np.float64],
        geom_xmat: NDArray[np.float64],
        site_xpos: NDArray[np.float64],
        site_xmat: NDArray[np.float64],
        cam_xpos: NDArray[np.float64],
        cam_xmat: NDArray[np.float64],
    ) -> None:
        """Remember the arrays of one simulation; `update` reads them."""

    def update(
        self,
        fixed: int,
        gaze: Sequence[Sequence[float]] | None,
        lens: Sequence[float],
        near: float,
        far: float,
    ) -> None:
        """Read poses; look through fixed camera number `fixed`, or along `gaze` where that is -1."""

    def set_softs(
        self,
        surfaces: Sequence[
            tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]
        ],
        skins: Sequence[int],
        flexes: Sequence[tuple[int | None, NDArray[np.float32], NDArray[np.float32]]],
    ) -> None:
        """Set the surfaces that bend, in metres in the world.

        Args:
            surfaces: Vertices [n, 3], normals [n, 3], texture coordinates [n, 2] or [0, 2], faces [m, 3].
            skins: For each skin its surface.
            flexes: For each flexible body its surface or None, its vertices that are shown as balls [n, 3],
                and its edges that are shown as tubes [n, 6].
        """

    def take(self, geoms: int, lights: int, is_numbered: bool = False) -> None:
        """Read the first geoms and lights of the source, and its flags; what follows draws them.

        `is_numbered`: segmentation shows the numbers that MuJoCo gave geoms for it instead of objects.
        """

    def draw(self, out: NDArray[np.uint8], is_planar: bool) -> None:
        """Draw colours into uint8 [height, width, 3], or [3, height, width] where planar."""

    def draw_depth(self, out: NDArray[np.float32]) -> None:
        """Draw distances in metres into float32 [height, width]."""

    def draw_tags(self, out: NDArray[np.int32]) -> None:
        """Draw object number and type into int32 [height, width, 2]; -1 is background."""

    def draw_all(
        self,
        count: int,
        prepare: Callable[[int], None],
        out: NDArray[np.uint8],
        is_planar: bool,
        threads: int,
    ) -> None:
        """Draw many pictures on some threads, as `draw` does, one after the other into `out`.

        `prepare` is called with 0, 1, ... and has this canvas read what is drawn; threads draw meanwhile.
        """

    def draw_all_depth(
        self, count: int, prepare: Callable[[int], None], out: NDArray[np.float32], threads: int
    ) -> None:
        """As `draw_all`, for distances."""

    def draw_all_tags(
        self, count: int, prepare: Callable[[int], None], out: NDArray[np.int32], threads: int
    ) -> None:
        """As `draw_all`, for segmentation."""

    @staticmethod
    def orbit(
        look_at: Sequence[float], distance: float, azimuth: float, elevation: float
    ) -> tuple[list[float], list[float], list[float]]:
        """Position, gaze and up vector of a camera that circles a point; angles in degrees."""

# The two ends of a rollout pool, for `vhs.rollout` alone: `RolloutPool` is the face for users. `sizes` are
# num_workers, envs_per_worker, action_bytes, observation_bytes, blob_bytes; `offsets` where in shared memory
# lie the first payload, from one payload to the next, from a payload to its observation and to its final
# observation, the first blob, from one blob to the next, and the end, all in bytes.

@final
class RolloutLearner:
    """The learner's end of a pool.

    Every call of a forked copy is refused with an `ArgumentError`: it would drive its parent's workers.
    """

    def __new__(
        cls,
        sizes: tuple[int, int, int, int, int],
        leaves: Sequence[tuple[int, int]],
        seed: int | None,
        deadline_s: float | None,
        dump_signal: int,
    ) -> RolloutLearner:
        """Make the shared memory and listen for deaths.

        `leaves` are offset and size of an observation's parts.
        """

    @property
    def memory(self) -> int:
        """File descriptor of the shared memory."""

    @property
    def offsets(self) -> list[int]: ...
    @property
    def block_bytes(self) -> int:
        """Size of the block that `recv` fills."""

    @property
    def columns(self) -> tuple[list[int], list[int], list[int]]:
        """Where in a block lie scalar columns, observation leaves and final observation leaves, in bytes."""

    def send(
        self,
        env_ids: ArrayLike,
        actions: Sequence[tuple[int, int, NDArray[Any]]],
        code: int,
        version: int,
        blobs: Sequence[bytes],
    ) -> None:
        """Give a command to each environment.

        `actions` are offset and size of a row, and the rows, contiguous. There is a blob for each
        environment, one for all, or none.
        """

    def check_held(self, env_ids: ArrayLike) -> None:
        """Refuse environments that do not exist, are named twice or have a command under way."""

    def under_way(self, ticket: int) -> int:
        """Commands whose answers have not been received; what was filled for `ticket` is not received."""

    def is_filled(self, ticket: int) -> bool:
        """Whether `recv` has filled a block for this ticket."""

    def has_news(self) -> bool:
        """Whether a death or a notice waits to be seen to."""

    def wait(self, wanted: int, limit_s: float) -> bool:
        """Whether so many answers lie ready.

        False after `limit_s`, or when a death or a notice wants attention.
        """

    def recv(
        self, block: NDArray[np.uint8], ticket: int, wanted: int | None, limit_s: float
    ) -> tuple[int, int, int] | None:
        """Wait as `wait` and fill the block: rows, rows with a final observation, rows to look at.

        None also where there are not so many under way; without a number, all that are.
        Once a ticket: called again with the same ticket and block, after an interrupt, it tells the same.
        """

    def seed_next(self, env_ids: ArrayLike, seeds: Sequence[int | None]) -> None: ...
    def reseed(self, seed: int | None) -> None: ...
    def expect_start(self, worker: int, limit_s: float) -> None: ...
    def listen_to(self, worker: int, pid: int) -> None:
        """Listen to the process that now is this worker."""

    def take_deaths(self) -> list[tuple[int, bool]]:
        """Dead workers, and whether each was killed for taking too long."""

    def take_notices(self) -> list[tuple[int, int, int]]:
        """Environments that failed or answered a call: environment, flags, length of the pickled part."""

    def reclaim(self, worker: int, again: bool) -> tuple[list[int], bool]:
        """Take a dead worker's slots: whose commands or answers are lost, and whether it ever answered.

        The lost are asked to begin an episode where `again`, and have no command under way otherwise.
        """

    @property
    def stats(self) -> tuple[int, int, int, int, int]:
        """Steps, episodes, cut episodes, quarantined episodes, restarts."""

    def close(self) -> None:
        """Tell the workers to leave and stop listening; a `recv` of another thread ends with None."""

    def free(self) -> None:
        """Give back the shared memory of payloads and blobs, once the workers are gone."""

@final
class RolloutWorker:
    """A worker's end of a pool."""

    def __new__(
        cls,
        memory: int,
        sizes: tuple[int, int, int, int, int],
        worker: int,
        deadline_s: float | None,
        cpu: int | None,
    ) -> RolloutWorker:
        """Take up the post of a worker, before long on a core of its own if one is given."""

    @property
    def offsets(self) -> list[int]: ...
    @property
    def epoch(self) -> int:
        """Which incarnation of the worker this is."""

    def next(self, limit_s: float) -> tuple[int, int, int, int | None, int]:
        """Environment within the worker, code, version, next seed, length of the pickled part.

        The environment is -1 when nothing came within `limit_s` and -2 when the pool closes.
        """

    def untie(self) -> None:
        """Let this thread run anywhere for a while: what it starts now inherits where it may run."""

    def allow(self, extra_s: float) -> None:
        """Give the command under way so much time from now."""

    def commit(
        self, env: int, flags: int, reward: float, step: int, seed: int, blob_bytes: int, version: int
    ) -> None:
        """Answer the command of an environment."""

    @staticmethod
    def end_with(parent: int, by_signal: bool) -> None:
        """Make this process end with its parent."""

class VhsError(Exception):
    """Base of everything that vhs refuses, except errors of the operating system (OSError)."""

class ShapeError(VhsError, ValueError):
    """An array has another shape than expected."""

class DtypeError(VhsError, TypeError):
    """An array or a number has another type than expected."""

class LayoutError(VhsError, ValueError):
    """An `out` array cannot be written in place: not contiguous, read-only or in use."""

class ArgumentError(VhsError, ValueError):
    """A setting is out of range, or a word is not one of those known."""

class LabelError(VhsError, IndexError):
    """A class, goal, interaction, action or stream number is out of range."""

class NonFiniteError(VhsError, ValueError):
    """A reward, value or feature is NaN or infinite."""

class EmptyError(VhsError, LookupError):
    """Something was to be sampled from nothing."""

class EpisodeError(VhsError, LookupError):
    """No episode with this id is stored: it was evicted or never existed."""

class ProtocolError(VhsError, RuntimeError):
    """A call came in the wrong state of a stream, such as finishing an episode twice."""

class OutOfMemoryError(VhsError, MemoryError):
    """The allocator refused."""

class DamagedFileError(VhsError, ValueError):
    """A file is not one of ours, is cut short or has been altered."""

class UnsupportedError(VhsError, NotImplementedError):
    """A model or an option asks for something that the renderer does not draw."""
