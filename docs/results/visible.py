"""What an agent did in rooms, and how much of each object its robot saw; for the scripts beside this one."""

from collections.abc import Iterator
from itertools import islice

import mujoco
import numpy as np

from vhs import RasterRenderer
from vhs.acting.episodes import EndedEpisode, Episodes
from vhs.acting.policy import Policy
from vhs.acting.seeds import episode_seeds
from vhs.acting.setup import make_buffer, make_env
from vhs.acting.stepping import LocalStepping
from vhs.envs import OBJECT_NAMES, RoomEnv
from vhs.envs.robot import CAMERA


class Visible:
    """Pixels of each object in the robot's view, of 84 x 84."""

    def __init__(self, room: RoomEnv) -> None:
        """Prepare to look through the eyes of `room`."""
        model = room.world.model
        self._room = room
        self._renderer = RasterRenderer(model, 84, 84)
        self._renderer.enable_segmentation_rendering()
        names = [model.body(body).name for body in range(model.nbody)]
        bodies = [next(i for i, name in enumerate(names) if wanted in name) for wanted in OBJECT_NAMES]
        # What is no object counts under one class more.
        self._class_of_geom = np.full(model.ngeom, len(OBJECT_NAMES))
        for label, body in enumerate(bodies):
            self._class_of_geom[model.geom_bodyid == body] = label

    def __call__(self) -> list[int]:
        """Pixels now, of each object, in the order of the class labels."""
        self._renderer.update_scene(self._room.world.data, camera=CAMERA)
        ids, kinds = np.moveaxis(self._renderer.render(), -1, 0)
        seen = self._class_of_geom[ids[kinds == int(mujoco.mjtObj.mjOBJ_GEOM)]]
        return np.bincount(seen, minlength=len(OBJECT_NAMES) + 1)[: len(OBJECT_NAMES)].tolist()


def played(
    trained: Policy, episodes: int, seed: int, greedy: bool
) -> Iterator[tuple[EndedEpisode, list[int]]]:
    """Play as `vhs eval` does: each episode and its actions, to be looked at again from its seed."""
    envs = [make_env(trained.task, trained.spec) for _ in range(16)]
    buffer = make_buffer(trained.config, trained.spec, len(envs), len(envs))
    seeds = islice(episode_seeds(seed, purpose=1), episodes)
    running = Episodes(LocalStepping(envs), trained.player(buffer, seed, greedy), buffer, seeds)
    running.start()
    while not running.is_done:
        for ended in running.step():
            batch = buffer.gather(np.array([ended.id], dtype=np.int64))
            yield ended, batch.actions[0, : ended.steps].tolist()
