"""`RasterRenderer` behaves like `mujoco.Renderer`, and says so when it cannot."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

import mujoco
import numpy as np
import pytest
from raster_support import scatter, shapes_model

from vhs.raster import RasterRenderer


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return shapes_model()


@pytest.fixture
def data(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    scatter(model, data, np.random.default_rng(0), 0.1)
    return data


@pytest.fixture
def renderer(model: mujoco.MjModel) -> RasterRenderer:
    return RasterRenderer(model, 40, 56)


def picture(renderer: RasterRenderer, data: mujoco.MjData, camera: object = "fixed") -> np.ndarray:
    renderer.update_scene(data, camera)
    return renderer.render()


def test_results_have_the_documented_shapes_and_types(renderer: RasterRenderer, data: mujoco.MjData) -> None:
    assert (picture(renderer, data).shape, picture(renderer, data).dtype) == ((40, 56, 3), np.uint8)
    renderer.enable_depth_rendering()
    assert (renderer.render().shape, renderer.render().dtype) == ((40, 56), np.float32)
    renderer.enable_segmentation_rendering()
    assert (renderer.render().shape, renderer.render().dtype) == ((40, 56, 2), np.int32)
    renderer.disable_segmentation_rendering()
    assert renderer.render().shape == (40, 56, 3)


def test_out_takes_the_picture_in_any_layout(renderer: RasterRenderer, data: mujoco.MjData) -> None:
    expected = picture(renderer, data)
    for out in (
        np.zeros((40, 56, 3), np.uint8),
        np.zeros((40, 56, 3), np.float32),
        np.zeros((80, 56, 3), np.uint8)[::2],
    ):
        assert renderer.render(out=out) is out
        assert np.array_equal(out, expected)
    planar = renderer.render(out=np.zeros((3, 40, 56), np.uint8))
    assert np.array_equal(planar, expected.transpose(2, 0, 1))


def test_out_of_another_shape_is_refused(renderer: RasterRenderer, data: mujoco.MjData) -> None:
    renderer.update_scene(data)
    with pytest.raises(ValueError, match=r"expected shape \(40, 56, 3\).*got \(40, 55, 3\)"):
        renderer.render(out=np.zeros((40, 55, 3), np.uint8))


def test_the_scene_is_that_of_the_last_update(renderer: RasterRenderer, data: mujoco.MjData) -> None:
    before = picture(renderer, data)
    data.geom_xpos[1:] += 0.3
    assert np.array_equal(renderer.render(), before)
    renderer.update_scene(data, "fixed")
    assert not np.array_equal(renderer.render(), before)


def test_the_same_state_gives_the_same_bytes(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    expected = picture(RasterRenderer(model, 40, 56), data)
    pictures: list[np.ndarray] = []

    def draw() -> None:
        pictures.append(picture(RasterRenderer(model, 40, 56), data))

    threads = [threading.Thread(target=draw) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(pictures) == 4
    assert all(np.array_equal(other, expected) for other in pictures)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["colour", "depth", "segmentation"])
@pytest.mark.parametrize("threads", [1, 3])
def test_a_batch_equals_its_single_pictures(model: mujoco.MjModel, mode: str, threads: int) -> None:
    rng, datas = np.random.default_rng(2), [mujoco.MjData(model) for _ in range(40)]
    for data in datas:
        scatter(model, data, rng, 0.1)
    renderer, free = RasterRenderer(model, 20, 28), mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, free)
    if mode != "colour":
        getattr(renderer, f"enable_{mode}_rendering")()
    cameras = ["fixed", "lens", free]
    batch = renderer.render_batch(datas, cameras, threads=threads)
    one = picture(renderer, datas[0], "fixed")
    assert (batch.shape, batch.dtype) == ((40, 3, *one.shape), one.dtype)
    for data, row in zip(datas, batch, strict=True):
        for camera, found in zip(cameras, row, strict=True):
            assert np.array_equal(picture(renderer, data, camera), found)
    assert np.array_equal(renderer.render_batch(datas, "lens", threads=threads), batch[:, 1])


def test_a_batch_goes_into_any_array_of_its_shape(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    renderer = RasterRenderer(model, 20, 28)
    expected = renderer.render_batch([data, data], ["fixed"])
    for out in (np.zeros((2, 1, 20, 28, 3), np.float32), np.zeros((4, 1, 20, 28, 3), np.uint8)[::2]):
        assert renderer.render_batch([data, data], ["fixed"], out=out) is out
        assert np.array_equal(out, expected)
    planar = renderer.render_batch([data, data], ["fixed"], out=np.zeros((2, 1, 3, 20, 28), np.uint8))
    assert np.array_equal(planar, expected.transpose(0, 1, 4, 2, 3))
    assert renderer.render_batch([], ["fixed"]).shape == (0, 1, 20, 28, 3)
    with pytest.raises(ValueError, match=r"expected shape \(2, 20, 28, 3\), got \(1, 20, 28, 3\)"):
        renderer.render_batch([data, data], "fixed", out=np.zeros((1, 20, 28, 3), np.uint8))


def test_a_batch_that_fails_leaves_nothing_behind(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    renderer, lost = RasterRenderer(model, 20, 28), mujoco.MjData(model)
    lost.geom_xpos[:] = np.nan
    with pytest.raises(ValueError, match="pose of geom 0"):
        renderer.render_batch([data, lost])
    assert np.array_equal(renderer.render_batch([data], -1)[0], picture(renderer, data, -1))


def test_refresh_reads_meshes_again(data: mujoco.MjData) -> None:
    model = shapes_model()
    renderer = RasterRenderer(model, 40, 56)
    before = picture(renderer, data)
    model.mesh_vert[:] *= 2
    assert np.array_equal(picture(renderer, data), before)
    renderer.refresh()
    assert not np.array_equal(picture(renderer, data), before)


def test_nan_in_a_pose_is_an_error_and_keeps_the_scene(renderer: RasterRenderer, data: mujoco.MjData) -> None:
    before = picture(renderer, data)
    data.geom_xpos[4, 1] = np.nan
    with pytest.raises(ValueError, match="pose of geom 4: expected finite numbers"):
        renderer.update_scene(data, "fixed")
    assert np.array_equal(renderer.render(), before)


@pytest.mark.parametrize(
    ("camera", "message"),
    [("nowhere", "nowhere"), (3, "from -1 to 2, got 3"), (-2, "from -1 to 2, got -2")],
)
def test_unknown_cameras_are_refused(
    renderer: RasterRenderer, data: mujoco.MjData, camera: object, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        renderer.update_scene(data, camera)


def test_text_is_refused(renderer: RasterRenderer, data: mujoco.MjData) -> None:
    option = mujoco.MjvOption()
    option.label = mujoco.mjtLabel.mjLABEL_GEOM
    with pytest.raises(NotImplementedError, match="text labels"):
        renderer.update_scene(data, scene_option=option)
    renderer.update_scene(data)
    renderer.scene.geoms[0].label = "floor"
    with pytest.raises(NotImplementedError, match="text labels"):
        renderer.render()


@pytest.mark.parametrize(
    ("flag", "message"),
    [("WIREFRAME", "wireframe"), ("ADDITIVE", "additive"), ("SEGMENT", "enable_segmentation_rendering")],
)
def test_flags_that_are_not_obeyed_are_refused(
    renderer: RasterRenderer, data: mujoco.MjData, flag: str, message: str
) -> None:
    renderer.update_scene(data)
    renderer.scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = 1
    with pytest.raises(NotImplementedError, match=message):
        renderer.render()


def test_the_flags_of_sky_and_haze_are_obeyed(data: mujoco.MjData) -> None:
    model = shapes_model()
    model.geom_size[0, :2] = 0
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    camera.elevation = -5
    renderer = RasterRenderer(model, 40, 56)
    pictures = []
    for sky, haze in ((1, 1), (1, 0), (0, 1), (0, 0)):
        flags = renderer.scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SKYBOX], flags[mujoco.mjtRndFlag.mjRND_HAZE] = sky, haze
        pictures.append(picture(renderer, data, camera))
    assert len({image.tobytes() for image in pictures}) == 3, "there is no haze without a sky"
    without = RasterRenderer(model, 40, 56, has_sky=False)
    assert np.array_equal(pictures[2], picture(without, data, camera))


def test_a_closed_renderer_says_so(renderer: RasterRenderer, data: mujoco.MjData) -> None:
    with renderer:
        picture(renderer, data)
    with pytest.raises(RuntimeError, match="closed"):
        renderer.render()


@pytest.mark.parametrize("size", [(0, 10), (10, 9000)])
def test_impossible_sizes_are_refused(model: mujoco.MjModel, size: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="expected 1 to 8192"):
        RasterRenderer(model, *size)


def test_importing_the_renderer_imports_no_mujoco() -> None:
    code = "import sys, vhs.raster; sys.exit('mujoco' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_worker_draws_with_the_renderer_of_its_parent(
    renderer: RasterRenderer, data: mujoco.MjData
) -> None:
    expected = picture(renderer, data)
    worker = os.fork()
    if worker == 0:
        os._exit(0 if np.array_equal(picture(renderer, data), expected) else 1)
    assert os.waitpid(worker, 0)[1] == 0
