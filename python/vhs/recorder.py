"""A gymnasium wrapper that makes any goal-conditioned environment feed an `EpisodeBuffer`.

Environments say what they want and what was reached in three ways; a `GoalReader` turns each into a `Seen`:
dictionaries with `achieved_goal` and `desired_goal` (`GoalDict`), a class or a picture beside an image
(`Instruction`), or whatever a function of the user's makes of an observation.

The wrapper records the last observation of an episode before anything resets the environment, so hindsight
always has it. It needs gymnasium; `import vhs` alone does not import it.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from os import PathLike
from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from vhs._core import EpisodeBuffer, Field, LabelError, ProtocolError
from vhs.actions import stored_action
from vhs.buffer import as_goal
from vhs.buffer import make_buffer as buffer_of
from vhs.streams import EnvReward, copied, reads_infos, streams_of
from vhs.task import (
    GoalDict,
    GoalReader,
    Instruction,
    Judge,
    Outcome,
    Seen,
    default_outcome,
    read_spec,
    reader_of,
)

__all__ = [
    "GoalDict",
    "GoalReader",
    "HindsightRecorder",
    "Instruction",
    "Seen",
    "default_outcome",
    "make_buffer",
    "reader_of",
]


class HindsightRecorder(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Records every step of an environment in one stream of a buffer.

    Several recorders may share a buffer, each with a stream of its own: a stream is that of the recorder that
    was reset last, and another one steps its environment unrecorded from then on, with a warning. An episode
    that is reset before it has ended is kept as a timeout if it has a step, and dropped otherwise; one in
    which a step raised is dropped.

    Numbered actions are stored, and given back by samplers, as the environment counts them: those of
    `Discrete(3, start=5)` are 5, 6 and 7. In a buffer that was not made by `make_buffer` they begin with its
    `first_action`.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        buffer: EpisodeBuffer,
        *,
        stream: int = 0,
        reader: GoalReader | None = None,
        judge: Judge | None = None,
        infos: bool | None = None,
    ) -> None:
        """Wrap an environment.

        Args:
            env: To be recorded.
            buffer: Takes the steps; `make_buffer` builds one that fits.
            stream: Of the buffer, for this environment alone.
            reader: Turns an observation into a `Seen`; None: by the observation space, `GoalDict` or
                `Instruction`.
            judge: Says how an episode ended; None: `default_outcome`.
            infos: Whether to keep the info of every step for `reward`, in memory and as long as the buffer
                stores the step. None: where `compute_reward`, asked about the first step, reads its info.

        Raises:
            LabelError: For a stream that the buffer does not have.
        """
        super().__init__(env)
        if not 0 <= stream < buffer.num_streams:
            raise LabelError(f"`stream`: expected a number in 0..{buffer.num_streams}, got {stream}")
        self.buffer = buffer
        self.stream = stream
        self.value = 0.0
        """The critic's value at the newest observation, where there is a critic; set it before `step`."""
        self.fields: dict[str, Any] = {}
        """Of the next step each field of steps, such as a log-probability; set it before `step`."""
        self.last_id: int | None = None
        """Id of the newest episode that this environment finished."""
        self._reader = reader or reader_of(env.observation_space)
        self._judge = judge or default_outcome
        self._streams = streams_of(buffer)
        self._keeps_infos = infos
        self._infos: list[dict[str, Any]] = []
        self._goal_told: NDArray[Any] | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, Any]:
        """Reset the environment and open an episode.

        Raises:
            ShapeError, DtypeError: For a frame or goal that the buffer cannot hold. Numbers are converted
                where nothing but precision is lost (float64 to float32, int64 to uint8 if it fits), shapes
                never.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        self._leave_open_episode()
        self._streams.claim(self.stream, self)
        self._infos = []
        seen = self._reader(observation)
        self._goal_told = seen.desired_goal
        self.buffer.begin(
            self.stream,
            self._frame(seen),
            seen.label,
            seen.interaction,
            desired_goal=self._goal(seen.desired_goal),
            achieved_goal=self._goal(seen.achieved_goal),
            fields=self._fields(seen),
        )
        return observation, info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Step the environment and record what came of it.

        Raises:
            ShapeError, DtypeError: As for `reset`.
        """
        if self._streams.is_of_another(self.stream, self):
            warnings.warn(
                f"`step` on stream {self.stream}: expected this recorder's own, found that another one was "
                "reset on it since; this step is not recorded",
                RuntimeWarning,
                stacklevel=2,
            )
            return self.env.step(action)
        try:
            result = self.env.step(action)
            self._record(action, *result)
        except BaseException:
            # What came of the step is not known, or not stored: what follows would be another episode.
            if self.buffer.open[self.stream]:
                self.buffer.abort(self.stream)
            raise
        return result

    def _record(
        self,
        action: Any,
        observation: Any,
        reward: Any,
        terminated: bool,
        truncated: bool,
        info: dict[str, Any],
    ) -> None:
        seen = self._reader(observation)
        self.buffer.append(
            self.stream,
            self._action(action),
            float(reward),
            self.value,
            self._frame(seen),
            achieved_goal=self._goal(seen.achieved_goal),
            fields={**self._fields(seen), **self.fields},
        )
        if self._keeps_infos is None:
            self._keeps_infos = self._reads_infos(seen)
        if self._keeps_infos:
            self._infos.append(copied(info))
        if terminated or truncated:
            self._finish(self._judge(float(reward), terminated, truncated, info), bool(terminated))

    def _finish(self, outcome: Outcome, terminated: bool) -> None:
        self.last_id = self.buffer.finish(self.stream, outcome, terminated=terminated)
        if self._keeps_infos:
            self._streams.keep(self.last_id, self._infos, int(self.buffer.ids[0]))

    def _reads_infos(self, seen: Seen) -> bool:
        if seen.achieved_goal is None or self._goal_told is None:
            return False
        try:
            compute = self.env.get_wrapper_attr("compute_reward")
        except AttributeError:
            return False
        return reads_infos(compute, np.asarray(seen.achieved_goal), np.asarray(self._goal_told))

    @property
    def reward(self) -> Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]]:
        """The environment's own `compute_reward`, as `sample_transitions(reward=...)` takes it.

        It is called once a batch, with the infos of the steps as they were recorded: a sequence of
        dictionaries, `infos["key"]` the array of an entry. They say what held under the old goal.
        """
        return EnvReward(self.env.get_wrapper_attr("compute_reward"), self.buffer)

    def _leave_open_episode(self) -> None:
        if not self.buffer.open[self.stream]:
            return
        try:
            if self._streams.is_of_another(self.stream, self):
                self.buffer.finish(self.stream, Outcome.TIMEOUT)
            else:
                self._finish(Outcome.TIMEOUT, False)
        except ProtocolError:  # not a step of it was taken
            self.buffer.abort(self.stream)

    def _action(self, action: Any) -> Any:
        stored = stored_action(action, self.env.action_space)
        return stored if self.buffer.action_dim else stored + self.buffer.first_action

    def _frame(self, seen: Seen) -> NDArray[Any]:
        return _converted(np.atleast_1d(seen.frame), self.buffer.dtype)

    def _fields(self, seen: Seen) -> dict[str, NDArray[Any]]:
        known = self.buffer.fields
        return {name: _as_field(part, known.get(name)) for name, part in seen.fields.items()}

    def _goal(self, goal: NDArray[Any] | None) -> NDArray[Any] | None:
        if goal is None:
            return None
        return as_goal(self.buffer, _converted(np.atleast_1d(goal), self.buffer.goal_dtype))


def make_buffer(
    env: gymnasium.Env[Any, Any],
    *,
    capacity_steps: int,
    max_episode_steps: int | None = None,
    reader: GoalReader | None = None,
    num_streams: int = 1,
    frame_stack: int = 1,
    num_goals: int | None = None,
    num_interactions: int = 0,
    interactions: Mapping[int, int] | None = None,
    backing: str | PathLike[str] = "memory",
    seed: int = 0,
) -> EpisodeBuffer:
    """A buffer that fits an environment: types are read off its spaces, sizes off one observation.

    Args:
        env: Any environment that `HindsightRecorder` can wrap; it is reset once.
        capacity_steps: Steps kept over all episodes.
        max_episode_steps: Of the longest episode; None: that of the environment's registration.
        reader: As for `HindsightRecorder`.
        num_streams: Environments that will feed the buffer.
        frame_stack: Frames in one observation.
        num_goals: Goal classes, where an instruction names one; None: those of the space's "goal", else 1.
        num_interactions: Interactions, where an instruction names one; `interactions` may name more.
        interactions: The interaction that each of the environment's actions does, as for `EpisodeBuffer`:
            needed where there are several. Actions are as the environment counts them, from the start of its
            space.
        backing: As for `EpisodeBuffer`.
        seed: Of the buffer's generator.

    Raises:
        ArgumentError: For an environment without a limit of steps where none is given, with actions that are
            neither numbered nor real, or with several interactions and no word of which action does which.
    """
    observation = _as_said(env.observation_space, env.reset()[0])
    start = int(env.action_space.start) if isinstance(env.action_space, spaces.Discrete) else 0
    spec = read_spec(
        env,
        observation,
        reader=reader,
        max_episode_steps=max_episode_steps,
        num_goals=num_goals,
        interactions={action - start: done for action, done in (interactions or {}).items()},
        num_interactions=num_interactions,
    )
    return buffer_of(
        spec,
        capacity_steps=capacity_steps,
        num_streams=num_streams,
        frame_stack=frame_stack,
        first_action=start,
        backing=backing,
        seed=seed,
    )


def _as_said(space: spaces.Space[Any], observation: Any) -> Any:
    """An observation in the types that its space says, whatever this one happens to have."""
    if isinstance(space, spaces.Dict) and isinstance(observation, Mapping):
        parts = space.spaces
        return {
            key: _as_said(parts[key], part) if key in parts else part for key, part in observation.items()
        }
    if isinstance(space, spaces.Tuple) and isinstance(observation, tuple | list):
        return tuple(_as_said(part, own) for part, own in zip(space.spaces, observation, strict=False))
    if isinstance(space, spaces.Box | spaces.MultiBinary | spaces.MultiDiscrete):
        return np.asarray(observation).astype(space.dtype)
    return observation


def _as_field(part: Any, field: Field | None) -> NDArray[Any]:
    """A further array as the buffer stores it; one that it does not have is for it to refuse."""
    return np.asarray(part) if field is None else _converted(np.asarray(part), field.dtype)


def _converted(array: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    """An array in the type that a buffer stores, or as it is where that would lose more than precision."""
    if array.dtype == dtype or np.can_cast(array.dtype, dtype, "safe"):
        return array.astype(dtype, copy=False)
    if dtype.kind in "iu" and array.dtype.kind in "iu":
        # numpy lets integers wrap around.
        limits = np.iinfo(dtype)
        if array.size == 0 or (limits.min <= int(array.min()) and int(array.max()) <= limits.max):
            return array.astype(dtype)
    elif dtype.kind == "f" and array.dtype.kind in "iuf":
        with np.errstate(over="ignore"):
            near = array.astype(dtype)
        if np.array_equal(np.isfinite(near), np.isfinite(array)):
            return near
    return array
