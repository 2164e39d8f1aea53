"""The environment: a robot in a room, an instruction, and how episodes end.

Owns `RoomEnv`, the gymnasium face of the three tasks. The order of one step: move (or hold) for one control
period of real dynamics, see what is in reach, name the outcome, reward it, draw.

Invariants: same seed, same episode, bit for bit; `terminated` means success or failure and `truncated` means
timeout, never both; `info` names the outcome and the reached object only at the end, for evaluation: a
learner must not read the reached object. Source: paper, experiments section; docs/reference/rooms.md.
"""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, SupportsFloat, SupportsIndex

import gymnasium
import numpy as np
from numpy.typing import NDArray

from vhs import Outcome
from vhs.envs.config import (
    FIRST_INTERACTION,
    HEADINGS,
    OBJECT_NAMES,
    TASKS,
    RoomConfig,
    RoomTask,
)
from vhs.envs.kinematics import Pose
from vhs.envs.placement import sample_layout
from vhs.envs.rendering import check_renderer, first_person_source, onlooker_source
from vhs.envs.rewards import compute_reward
from vhs.envs.scene import ONLOOKER_PX, ObjectPose, load_room
from vhs.envs.world import World

Observation = dict[str, Any]
"""`image` uint8 [84, 84, 3], `goal` and `interaction` numpy int64 scalars."""

_NOTHING = -1
"""What `info` reports as reached object or interaction when there is none."""


class RoomEnv(gymnasium.Env[Observation, np.int64]):
    """Find the instructed object in a room and, in Tasks 2 and 3, use the instructed interaction on it.

    Actions: 0 MoveForward, 1 TurnLeft, 2 TurnRight, then the task's interactions.
    """

    # A plain class attribute, not a ClassVar, because gymnasium declares it so.
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 4}  # noqa: RUF012

    def __init__(
        self,
        task: RoomTask | str,
        config: RoomConfig | None = None,
        *,
        render_mode: str | None = None,
        renderer: str = "raster",
        objects_dir: str | Path | None = None,
        horizon_steps: int | None = None,
    ) -> None:
        """Load the room; nothing is drawn before the first reset.

        Args:
            task: one of `TASKS`, or its name.
            config: the room's numbers; the defaults are those of the three tasks.
            render_mode: "rgb_array" for `render`'s third-person view, or None.
            renderer: what draws observations, a key of `vhs.envs.rendering.RENDERERS`.
            objects_dir: folder with meshes of your own; see `vhs.envs.objects`.
            horizon_steps: in place of the one in `config`.
        """
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode: expected 'rgb_array' or None, found {render_mode!r}")
        check_renderer(renderer)
        self.task = _find_task(task)
        self.config = RoomConfig() if config is None else config
        if horizon_steps is not None:
            self.config = replace(self.config, horizon_steps=horizon_steps)
        self.render_mode = render_mode
        size_px = self.config.image_px
        # Task 1 has no interactions; its instruction keeps the key, always 0: one agent fits all tasks.
        self._num_interactions = max(1, self.task.interactions)
        self.observation_space: gymnasium.spaces.Dict = gymnasium.spaces.Dict(
            {
                "image": gymnasium.spaces.Box(0, 255, (size_px, size_px, 3), np.uint8),
                "goal": gymnasium.spaces.Discrete(len(OBJECT_NAMES)),
                "interaction": gymnasium.spaces.Discrete(self._num_interactions),
            }
        )
        self.action_space: gymnasium.spaces.Discrete = gymnasium.spaces.Discrete(self.task.num_actions)
        self.renderer = renderer
        self._room = load_room(self.config, None if objects_dir is None else Path(objects_dir))
        self.world = World(self._room, self.config)
        """True state, for oracle, evaluation and tests; a learner must not read it."""
        self._goal = self._interaction = 0
        self._steps = 0
        self._is_running = False

    # -- gymnasium -----------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode: new places, postures, heading and instruction.

        Args:
            seed: seeds the environment's generator; None goes on with the present one.
            options: `goal` (any class label) and `interaction` fix the instruction; it is drawn otherwise,
                the goal of `RoomConfig.goals`.

        Returns:
            First observation, and an empty info.
        """
        instruction = self._check_options(options)
        super().reset(seed=seed)
        # All draws are made whatever the options say, so that fixing the goal does not change the room.
        poses = sample_layout(self._room, self.config, self.np_random)
        asked = self.config.goal_labels
        heading, drawn, interaction = self.np_random.integers(
            (HEADINGS, len(asked), self._num_interactions)
        ).tolist()
        self._goal = instruction.get("goal", asked[drawn])
        self._interaction = instruction.get("interaction", interaction)
        self.arrange(Pose(0.0, 0.0, heading), poses)
        return self._observe(), {}

    def step(self, action: np.int64 | int) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Carry one action out.

        Returns:
            Observation, reward, terminated (success or failure), truncated (timeout), and info: empty
            while the episode runs, else `outcome`, `reached_object` and `reached_interaction` (-1 where
            there is none).
        """
        chosen = self._check_action(action)
        interaction = chosen - FIRST_INTERACTION if chosen >= FIRST_INTERACTION else _NOTHING
        self.world.move(chosen)
        self._steps += 1
        reached = (
            self.world.object_in_reach() if interaction >= 0 or self.task.interactions == 0 else _NOTHING
        )
        outcome = self._outcome(reached, interaction)
        info: dict[str, Any] = {}
        if outcome is not None:
            self._is_running = False
            info = {
                "outcome": outcome.name.lower(),
                "reached_object": reached,
                "reached_interaction": interaction if reached >= 0 else _NOTHING,
            }
        reward = compute_reward(outcome, self.config)
        is_timeout = outcome is Outcome.TIMEOUT
        return self._observe(), reward, outcome is not None and not is_timeout, is_timeout, info

    def render(self) -> NDArray[np.uint8] | None:
        """Third-person view of the room, uint8 [480, 480, 3]; None without a render mode."""
        if self.render_mode is None:
            return None
        picture = np.empty((ONLOOKER_PX, ONLOOKER_PX, 3), np.uint8)
        onlooker_source(self.renderer, self._room.model, ONLOOKER_PX).render(self.world.data, picture)
        return picture

    # -- true state, for oracle, evaluation and tests ------------------------------------------------------

    @property
    def goal(self) -> int:
        """Class label of the instructed object."""
        return self._goal

    @property
    def interaction(self) -> int:
        """Instructed interaction; 0 in Task 1."""
        return self._interaction

    @property
    def steps(self) -> int:
        """Steps taken since the reset."""
        return self._steps

    def arrange(self, start: Pose, poses: Sequence[ObjectPose]) -> None:
        """Start an episode from a state of your own, at rest; the instruction stays as it is.

        Args:
            start: the robot's commanded pose.
            poses: one pose per object, in order of the class labels; nothing checks that they are fair.
        """
        self.world.arrange(start, poses)
        self._steps = 0
        self._is_running = True

    # -- parts of a step -----------------------------------------------------------------------------------

    def _outcome(self, reached: int, interaction: int) -> Outcome | None:
        """Name how this step ended the episode; reaching on the last step is not a timeout."""
        if reached >= 0:
            is_right = reached == self._goal and (
                self.task.interactions == 0 or interaction == self._interaction
            )
            return Outcome.SUCCESS if is_right else Outcome.FAILURE
        return Outcome.TIMEOUT if self._steps >= self.config.horizon_steps else None

    def _observe(self) -> Observation:
        """Draw the first-person view and repeat the instruction."""
        size_px = self.config.image_px
        image = np.empty((size_px, size_px, 3), np.uint8)
        first_person_source(self.renderer, self._room.model, size_px).render(self.world.data, image)
        return {"image": image, "goal": np.int64(self._goal), "interaction": np.int64(self._interaction)}

    # -- checks --------------------------------------------------------------------------------------------

    def _check_action(self, action: np.int64 | int) -> int:
        """The action as an int, if the episode runs and the task has it."""
        if not self._is_running:
            raise gymnasium.error.ResetNeeded(
                "step: expected a running episode, found none: call reset first"
            )
        return _checked_index("action", action, self.task.num_actions)

    def _check_options(self, options: Mapping[str, Any] | None) -> dict[str, int]:
        """The instruction that the options fix."""
        limits = {"goal": len(OBJECT_NAMES), "interaction": self._num_interactions}
        given = {} if options is None else dict(options)
        unknown = sorted(set(given) - set(limits))
        if unknown:
            raise ValueError(f"reset options: expected only {sorted(limits)}, found {unknown}")
        return {
            name: _checked_index(f"reset option {name!r}", value, limits[name])
            for name, value in given.items()
        }


def _checked_index(name: str, value: SupportsIndex, limit: int) -> int:
    """An integer of any kind in 0..limit; an error that names what was expected otherwise."""
    try:
        index = operator.index(value)
    except TypeError as error:
        raise TypeError(f"{name}: expected an int in 0..{limit - 1}, found {value!r}") from error
    if not 0 <= index < limit:
        raise ValueError(f"{name}: expected an int in 0..{limit - 1}, found {index}")
    return index


def _find_task(task: RoomTask | str) -> RoomTask:
    """The task of a name."""
    if isinstance(task, RoomTask):
        return task
    by_name = {known.name: known for known in TASKS}
    if task not in by_name:
        raise ValueError(f"task: expected one of {sorted(by_name)}, found {task!r}")
    return by_name[task]
