"""What the images show: every object tellable from the others, the goal in view when reached, no robot."""

from __future__ import annotations

import math
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from vhs.envs import OBJECT_NAMES, NoOpenGLError, RoomEnv, plan
from vhs.envs.config import FIRST_INTERACTION, INTERACTIVE_OBJECT_NAV
from vhs.envs.kinematics import Pose
from vhs.envs.rendering import MujocoImageSource, first_person_source
from vhs.envs.robot import CAMERA, COLLISION_GROUP
from vhs.envs.scene import ObjectPose

Arrange = Callable[..., None]
Image = NDArray[np.uint8]
pytestmark = pytest.mark.usefixtures("opengl")


@pytest.fixture(scope="module")
def room() -> RoomEnv:
    env = RoomEnv(INTERACTIVE_OBJECT_NAV, render_mode="rgb_array")
    env.reset(seed=0)
    return env


@pytest.fixture(scope="module")
def segmenter(room: RoomEnv) -> Iterator[mujoco.Renderer]:
    with mujoco.Renderer(room.world.model, 84, 84) as renderer:
        renderer.enable_segmentation_rendering()
        yield renderer


def look(env: RoomEnv) -> Image:
    image = np.empty((84, 84, 3), np.uint8)
    first_person_source("mujoco", env.world.model, 84).render(env.world.data, image)
    return image


def object_pixels(env: RoomEnv, segmenter: mujoco.Renderer) -> NDArray[np.int64]:
    """Pixels of each object in the first-person view, by MuJoCo's segmentation, [5]."""
    model = env.world.model
    option = mujoco.MjvOption()
    # The robot is drawn here: what it covered would not count.
    option.geomgroup[COLLISION_GROUP] = 0
    option.geomgroup[4] = 1
    segmenter.update_scene(env.world.data, CAMERA, option)
    ids = segmenter.render()
    geoms = ids[..., 0][ids[..., 1] == int(mujoco.mjtObj.mjOBJ_GEOM)]
    bodies = model.geom_bodyid[geoms]
    return np.array([np.count_nonzero(bodies == model.body(name).id) for name in OBJECT_NAMES])


def test_every_object_can_be_told_apart_from_two_metres(room: RoomEnv, arrange: Arrange) -> None:
    rng = np.random.default_rng(0)
    colours: list[list[NDArray[np.float64]]] = [[] for _ in OBJECT_NAMES]
    fewest = 84 * 84
    for sample in range(40):
        # From a corner region across the room: 2 m away, in any posture, before any of the walls.
        start = Pose(*((-0.7, -0.7, 1), (0.7, -0.7, 3), (0.7, 0.7, 5), (-0.7, 0.7, 7))[sample % 4])
        angle = start.heading * math.pi / 4
        x_m, y_m = start.x_m + 2.0 * math.cos(angle), start.y_m + 2.0 * math.sin(angle)
        arrange(room, start)
        empty = look(room).astype(int)
        for label in range(len(OBJECT_NAMES)):
            pose = ObjectPose(x_m, y_m, float(rng.uniform(0, math.tau)), bool(rng.random() < 0.5))
            arrange(room, start, {label: pose})
            image = look(room).astype(int)
            differs = np.abs(image - empty).sum(axis=2) > 30
            fewest = min(fewest, int(differs.sum()))
            colours[label].append(image[differs].mean(axis=0))
    # Nearest class mean of the other half, by mean colour alone; shape can only help.
    means = np.array([np.mean(known[::2], axis=0) for known in colours])
    right = [
        int(np.argmin(np.linalg.norm(means - colour, axis=1))) == label
        for label, known in enumerate(colours)
        for colour in known[1::2]
    ]
    closest = min(float(np.linalg.norm(means[i] - means[j])) for i in range(len(means)) for j in range(i))
    print(f"at 2 m: {fewest} pixels or more, mean colours {closest:.0f} apart, {np.mean(right):.3f} right")
    assert fewest >= 8
    assert closest > 40
    assert np.mean(right) >= 0.98


def test_what_is_reached_is_in_view(segmenter: mujoco.Renderer) -> None:
    env = RoomEnv(INTERACTIVE_OBJECT_NAV)
    seen = []
    for seed in range(150):
        env.reset(seed=seed)
        for action in plan(env)[:-1]:
            env.world.move(action)
        assert env.world.object_in_reach() == env.goal
        seen.append(int(object_pixels(env, segmenter)[env.goal]))
    print(f"goal pixels when reached: least {min(seen)}, median {np.median(seen):.0f} of {84 * 84}")
    assert min(seen) >= 40


@pytest.mark.parametrize("is_lying", [False, True])
@pytest.mark.parametrize("label", range(5))
def test_an_object_against_the_bumper_is_still_in_view(
    room: RoomEnv, segmenter: mujoco.Renderer, arrange: Arrange, label: int, is_lying: bool
) -> None:
    pixels = []
    for turn in range(8):
        arrange(room, Pose(-0.2, 0.0, 0), {label: ObjectPose(0.5, 0.0, turn * math.pi / 8, is_lying)})
        for _ in range(2):
            room.world.move(0)
        pixels.append(int(object_pixels(room, segmenter)[label]))
    print(
        f"{OBJECT_NAMES[label]} {'lying' if is_lying else 'upright'} against the bumper: {min(pixels)} pixels"
    )
    assert min(pixels) >= 40


def test_leaving_the_robot_out_of_its_own_view_changes_no_pixel(room: RoomEnv) -> None:
    model = room.world.model
    with mujoco.Renderer(model, 84, 84) as renderer:
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        option = mujoco.MjvOption()
        option.geomgroup[:] = 1
        option.geomgroup[COLLISION_GROUP] = 0
        for seed in range(10):
            room.reset(seed=seed)
            room.step(int(seed % 3))
            renderer.update_scene(room.world.data, CAMERA, option)
            assert np.array_equal(renderer.render(), look(room))


def test_the_image_follows_the_last_movement(room: RoomEnv) -> None:
    observation, _ = room.reset(seed=2)
    images = [observation["image"]]
    images.extend(room.step(action)[0]["image"] for action in (0, 1, 2, FIRST_INTERACTION))
    assert not np.array_equal(images[0], images[1])
    assert not np.array_equal(images[1], images[2])
    # A turn left and a turn right lead back to the same view, but for what is left of their motion.
    assert np.mean(np.abs(images[1].astype(int) - images[3].astype(int))) < 1.0
    assert np.mean(np.abs(images[3].astype(int) - images[4].astype(int))) < 1.0


def test_walls_fill_the_view_from_everywhere(
    room: RoomEnv, segmenter: mujoco.Renderer, arrange: Arrange
) -> None:
    for x_m, y_m in ((-1.2, -1.2), (1.2, 1.2), (1.2, -1.2), (-1.2, 1.2), (0.0, 0.0)):
        for heading in range(8):
            arrange(room, Pose(x_m, y_m, heading))
            segmenter.update_scene(room.world.data, CAMERA)
            assert (segmenter.render()[..., 0] >= 0).all()


def test_the_four_walls_look_different(room: RoomEnv, arrange: Arrange) -> None:
    means = []
    for heading in (0, 2, 4, 6):
        arrange(room, Pose(0.0, 0.0, heading))
        means.append(look(room)[:20].reshape(-1, 3).mean(axis=0))
    gaps = [float(np.linalg.norm(means[i] - means[j])) for i in range(4) for j in range(i)]
    assert min(gaps) > 5


def test_the_third_person_view_shows_robot_and_objects(room: RoomEnv, arrange: Arrange) -> None:
    room.reset(seed=1)
    with_objects = room.render()
    assert with_objects is not None
    assert with_objects.shape == (480, 480, 3)
    assert with_objects.dtype == np.uint8
    start = room.world.start_pose
    arrange(room, start)
    without = room.render()
    assert without is not None
    assert np.count_nonzero(np.abs(with_objects.astype(int) - without).sum(axis=2) > 30) > 1000
    arrange(room, Pose(0.8, 0.8, 0))
    moved = room.render()
    assert moved is not None
    assert np.count_nonzero(np.abs(moved.astype(int) - without).sum(axis=2) > 30) > 2000


def test_without_a_render_mode_nothing_is_rendered() -> None:
    assert RoomEnv(INTERACTIVE_OBJECT_NAV, renderer="none").render() is None


def test_no_opengl_is_one_clear_error(room: RoomEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object, **kwargs: object) -> None:
        raise RuntimeError("no display")

    monkeypatch.setattr(mujoco, "Renderer", refuse)
    with pytest.raises(NoOpenGLError, match=r"no display.*apt-get install libegl1 libgl1-mesa-dri") as caught:
        MujocoImageSource(room.world.model, 84, 84, is_onlooker=False)
    assert isinstance(caught.value.__cause__, RuntimeError)


def test_sources_are_shared_within_a_thread_and_closed_beyond_a_few(room: RoomEnv) -> None:
    model = room.world.model
    first = first_person_source("mujoco", model, 84)
    assert first_person_source("mujoco", model, 84) is first
    for size_px in range(20, 28):
        first_person_source("mujoco", model, size_px)
    assert first_person_source("mujoco", model, 84) is not first


@pytest.mark.parametrize("renderer", ["raster", "mujoco"])
def test_a_forked_worker_draws_the_same_picture_as_its_parent(renderer: str) -> None:
    code = f"""
import os, gymnasium, vhs.envs
env = gymnasium.make("vhs/InteractiveObjectNav-v0", renderer={renderer!r})
before = env.reset(seed=3)[0]["image"]
child = os.fork()
after = env.reset(seed=3)[0]["image"]
same = bool((before == after).all()) and before.std() > 5
if child == 0:
    os._exit(0 if same else 1)
print(same, os.waitpid(child, 0)[1])
"""
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60
    )
    assert result.stdout.strip() == "True 0", result.stderr


def test_each_thread_draws_for_itself(room: RoomEnv) -> None:
    room.reset(seed=4)
    here = look(room)
    found: list[Image] = []
    worker = threading.Thread(target=lambda: found.append(look(room)))
    worker.start()
    worker.join()
    assert np.array_equal(found[0], here)
    assert np.array_equal(look(room), here)
