"""A gymnasium wrapper that makes any goal-conditioned environment feed an `EpisodeBuffer`.

Environments say what they want and what was reached in three ways; a `GoalReader` turns each into a `Seen`:
dictionaries with `achieved_goal` and `desired_goal` (`GoalDict`), a class or a picture beside an image
(`Instruction`), or whatever a function of the user's makes of an observation.

The wrapper records the last observation of an episode before anything resets the environment, so hindsight
always has it. It needs gymnasium; `import vhs` alone does not import it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from os import PathLike
from typing import Any, Literal, SupportsFloat

import gymnasium
import numpy as np
from numpy.typing import NDArray

from vhs._core import EpisodeBuffer, ProtocolError
from vhs.actions import stored_action
from vhs.buffer import as_goal
from vhs.buffer import make_buffer as buffer_of
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

    Several recorders may share a buffer, each with a stream of its own. An episode that is reset before it
    has ended is kept as a timeout if it has a step, and dropped otherwise.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        buffer: EpisodeBuffer,
        *,
        stream: int = 0,
        reader: GoalReader | None = None,
        judge: Judge | None = None,
    ) -> None:
        """Wrap an environment.

        Args:
            env: To be recorded.
            buffer: Takes the steps; `make_buffer` builds one that fits.
            stream: Of the buffer, for this environment alone.
            reader: Turns an observation into a `Seen`; None: by the observation space, `GoalDict` or
                `Instruction`.
            judge: Says how an episode ended; None: `default_outcome`.
        """
        super().__init__(env)
        self.buffer = buffer
        self.stream = stream
        self.value = 0.0
        """The critic's value at the newest observation, where there is a critic; set it before `step`."""
        self.last_id: int | None = None
        """Id of the newest episode that this environment finished."""
        self._reader = reader or reader_of(env.observation_space)
        self._judge = judge or default_outcome

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, Any]:
        """Reset the environment and open an episode.

        Raises:
            ShapeError, DtypeError: For a frame or goal that the buffer cannot hold. Types are converted where
                nothing but precision is lost (float64 to float32, bool to uint8), shapes never.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        self._leave_open_episode()
        seen = self._reader(observation)
        self.buffer.begin(
            self.stream,
            self._frame(seen),
            seen.label,
            seen.interaction,
            desired_goal=self._goal(seen.desired_goal),
            achieved_goal=self._goal(seen.achieved_goal),
        )
        return observation, info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Step the environment and record what came of it.

        Raises:
            ShapeError, DtypeError: As for `reset`.
        """
        observation, reward, terminated, truncated, info = self.env.step(action)
        seen = self._reader(observation)
        self.buffer.append(
            self.stream,
            stored_action(action, self.env.action_space),
            float(reward),
            self.value,
            self._frame(seen),
            achieved_goal=self._goal(seen.achieved_goal),
        )
        if terminated or truncated:
            outcome = self._judge(float(reward), terminated, truncated, info)
            self.last_id = self.buffer.finish(self.stream, outcome, terminated=bool(terminated))
        return observation, reward, terminated, truncated, info

    @property
    def reward(self) -> Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]]:
        """The environment's own `compute_reward`, as `sample_transitions(reward=...)` takes it."""
        compute = self.env.get_wrapper_attr("compute_reward")
        return lambda achieved, goals: compute(achieved, goals, {})

    def _leave_open_episode(self) -> None:
        if not self.buffer.open[self.stream]:
            return
        try:
            self.last_id = self.buffer.finish(self.stream, Outcome.TIMEOUT)
        except ProtocolError:  # not a step of it was taken
            self.buffer.abort(self.stream)

    def _frame(self, seen: Seen) -> NDArray[Any]:
        return _converted(seen.frame, self.buffer.dtype)

    def _goal(self, goal: NDArray[Any] | None) -> NDArray[Any] | None:
        if goal is None:
            return None
        return as_goal(self.buffer, _converted(goal, self.buffer.goal_dtype))


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
    """A buffer that fits an environment: sizes and types are read off its spaces and one observation.

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
            needed where there are several.
        backing: As for `EpisodeBuffer`.
        seed: Of the buffer's generator.

    Raises:
        ArgumentError: For an environment without a limit of steps where none is given, with actions that are
            neither numbered nor real, or with several interactions and no word of which action does which.
    """
    observation, _ = env.reset()
    space = env.action_space
    start = int(space.start) if isinstance(space, gymnasium.spaces.Discrete) else 0
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
        backing=backing,
        seed=seed,
    )


def _converted(array: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    """An array in the type that a buffer stores, or as it is where that would lose more than precision."""
    array = np.atleast_1d(array)
    # numpy counts integers of every width as one kind, and lets them wrap around.
    rule: Literal["safe", "same_kind"] = "same_kind" if dtype.kind == "f" else "safe"
    return array.astype(dtype, copy=False) if np.can_cast(array.dtype, dtype, rule) else array
