"""`Batches`: tensors drawn ahead by a thread, and by the workers of a real `DataLoader`."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import vhs

torch = pytest.importorskip("torch", reason="an adapter for it")

from torch.utils.data import DataLoader  # noqa: E402

from vhs.adapters.torch import Batches, tensors_of  # noqa: E402

# Later versions of Python warn of forks beside threads: that these go well is what is tested.
pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")


def filled(seed: int = 0) -> vhs.EpisodeBuffer:
    buffer = vhs.EpisodeBuffer(
        (4, 4),
        num_streams=1,
        max_episode_steps=10,
        capacity_steps=500,
        fields={"compass": vhs.Field((2,))},
        goals="observations",
        seed=seed,
    )
    for episode in range(20):
        frames = np.full((11, 4, 4), episode, np.uint8) + np.arange(0, 220, 20, np.uint8)[:, None, None]
        goal, compass = np.stack([frames[3], frames[3]]), {"compass": np.zeros(2, np.float32)}
        buffer.begin(0, frames[0], desired_goal=goal, fields=compass)
        for frame in frames[1:]:
            buffer.append(0, 0, -1.0, None, frame, fields=compass)
        buffer.finish(0, "timeout")
    return buffer


def rows(batch: dict[str, Any]) -> list[tuple[int, int]]:
    return list(zip(batch["ids"].tolist(), batch["steps"].tolist(), strict=True))


def test_a_batch_becomes_tensors_that_share_its_memory() -> None:
    buffer = filled()
    batch = buffer.sample_transitions(8, "future")
    tensors = tensors_of(batch)
    assert tensors["observations"].data_ptr() == batch.observations.ctypes.data
    assert (tensors["observations"].dtype, tensors["actions"].dtype) == (torch.uint8, torch.int64)
    assert tensors["fields"]["compass"].shape == (8, 2)
    assert "achieved_goals" not in tensors  # None here: `next_observations` are that
    windows, episodes = buffer.sample_windows(3, 4), buffer.sample_episodes(2, "final", on=["timeout"])
    assert tensors_of(windows)["observations"].shape == (3, 5, 2, 4, 4)
    assert tensors_of(episodes)["hindsight"]["selected"].all()
    pair = tensors_of((np.zeros(2), {"labels": np.ones(3)}))
    assert pair["0"].shape == (2,)
    assert pair["1"]["labels"].shape == (3,)
    with pytest.raises(TypeError, match="expected a batch"):
        tensors_of("batch")


def test_batches_are_those_of_direct_calls_in_their_order() -> None:
    direct, buffer = filled(), filled()
    wanted = [rows(tensors_of(direct.sample_transitions(16, "future"))) for _ in range(12)]
    taken = [rows(batch) for batch in Batches(lambda: buffer.sample_transitions(16, "future"), count=12)]
    assert taken == wanted


@pytest.mark.parametrize("ahead", [1, 3])
def test_so_many_are_drawn_before_they_are_asked_for(ahead: int) -> None:
    buffer, waiting, drawn = filled(), threading.Event(), []

    def draw() -> Any:
        drawn.append(threading.current_thread())
        if len(drawn) == 1 + ahead:
            waiting.set()
        return buffer.sample_transitions(4)

    batches = iter(Batches(draw, ahead=ahead))
    next(batches)
    assert waiting.wait(30)
    assert len(drawn) == 1 + ahead
    assert threading.current_thread() not in drawn
    batches.close()  # type: ignore[attr-defined] # it is a generator
    assert not drawn[0].is_alive()


def test_an_error_is_raised_in_its_turn_and_the_thread_ends() -> None:
    buffer, calls = filled(), []

    def draw() -> Any:
        calls.append(threading.current_thread())
        return buffer.sample_transitions(4 if len(calls) < 3 else 0)

    batches: Iterator[Any] = iter(Batches(draw))
    assert len(next(batches)["ids"]) == len(next(batches)["ids"]) == 4
    with pytest.raises(vhs.ArgumentError):
        next(batches)
    assert not calls[0].is_alive()


@pytest.mark.slow
def test_workers_of_a_loader_draw_different_batches_in_every_epoch() -> None:
    buffer = filled()
    data = Batches(lambda: buffer.sample_transitions(16, "future"), count=7)
    loader = DataLoader(data, batch_size=None, num_workers=2, multiprocessing_context="fork")
    first, second = ([tuple(rows(batch)) for batch in loader] for _ in range(2))
    assert len(first) == len(second) == 7
    assert len({*first, *second}) == 14


@pytest.mark.slow
def test_forks_beside_a_thread_that_draws_neither_hang_nor_repeat() -> None:
    buffer = filled()
    seen: set[tuple[tuple[int, int], ...]] = set()
    ahead = iter(Batches(lambda: buffer.sample_transitions(64, "future"), ahead=8))
    for _ in range(5):
        seen.add(tuple(rows(next(ahead))))
        data = Batches(lambda: buffer.sample_transitions(16, "future"), count=4)
        loader = DataLoader(data, batch_size=None, num_workers=2, multiprocessing_context="fork", timeout=60)
        seen |= {tuple(rows(batch)) for batch in loader}
    ahead.close()  # type: ignore[attr-defined] # it is a generator
    assert len(seen) == 5 * (1 + 4)


@pytest.mark.slow
def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(vhs.ArgumentError, match="ahead"):
        Batches(dict, ahead=0)
    with pytest.raises(vhs.ArgumentError, match="count"):
        Batches(dict, count=-1)
    data = Batches(lambda: filled().sample_transitions(4), device="meta")
    loader = DataLoader(data, batch_size=None, num_workers=1, multiprocessing_context="fork")
    with pytest.raises(vhs.ArgumentError, match="worker of a loader"):
        next(iter(loader))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_batches_arrive_on_the_gpu() -> None:
    buffer, direct = filled(), filled()
    for batch in Batches(lambda: buffer.sample_transitions(64, "future"), count=20, device="cuda"):
        wanted = direct.sample_transitions(64, "future")
        assert batch["observations"].device.type == "cuda"
        np.testing.assert_array_equal(batch["observations"].cpu(), wanted.observations)
