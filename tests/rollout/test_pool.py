"""The pool's own face: batches, seeds, versions, modes, refusals."""

import gc
import os
import time
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from rollout_envs import Floats, Ledger, length_of, open_descriptors

import vhs
from vhs import ArgumentError, DtypeError, LabelError, ProtocolError, ShapeError
from vhs.rollout import Batch, PoolClosedError, RolloutPool

pytestmark = pytest.mark.slow


def collect(pool: RolloutPool, steps: int) -> list[tuple[Any, ...]]:
    """Lock-step with actions that follow from the step alone; every byte of every batch."""
    pool.reset()
    rows = []
    for step in range(steps):
        batch = pool.recv()
        leaves = batch.observation
        rows.append(
            (
                batch.env_ids.tobytes(),
                batch.rewards.tobytes(),
                batch.terminated.tobytes(),
                batch.truncated.tobytes(),
                batch.seeds.tobytes(),
                batch.steps.tobytes(),
                *(leaf.tobytes() for leaf in leaves.values()),
                *(leaf.tobytes() for leaf in batch.final_observation.values()),
                repr(sorted(batch.infos.items())),
            )
        )
        pool.send(np.arange(len(batch)) + step, batch.env_ids)
    pool.recv()
    return rows


@pytest.mark.parametrize("autoreset", ["SameStep", "NextStep"])
def test_lock_step_results_are_the_same_for_any_number_of_workers(autoreset: str) -> None:
    results = []
    for workers in (1, 2, 3, 6):
        with RolloutPool(Ledger, workers, 6 // workers, seed=11, autoreset=autoreset) as pool:
            results.append(collect(pool, 40))
    assert all(result == results[0] for result in results[1:])


def test_other_seeds_give_other_episodes() -> None:
    results = []
    for seed in (1, 2):
        with RolloutPool(Ledger, 1, 2, seed=seed) as pool:
            results.append(collect(pool, 3))
    assert results[0] != results[1]


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_both_start_methods_and_closures_work(method: str) -> None:
    cut = length_of(3)
    with RolloutPool(lambda: Ledger() if cut else None, 2, 1, start_method=method) as pool:  # type: ignore[arg-type,return-value]
        pool.reset(seeds=[3, 4])
        assert pool.recv().observation["seed"].tolist() == [3, 4]


def test_first_ready_takes_what_is_there() -> None:
    with RolloutPool([Ledger, Slow], 2, 1, seed=0) as pool:
        pool.reset()
        pool.recv()
        pool.send([1, 2])
        batch = pool.recv(1)
        assert batch.env_ids.tolist() == [0]
        assert pool.num_under_way == 1
        pool.send([3], [0])
        assert pool.recv(2).rewards.tolist() == [3.0, 2.0]


class Slow(Ledger):
    def step(self, action: Any) -> Any:
        time.sleep(1.0)
        return super().step(action)


def test_more_environments_than_cores_all_answer() -> None:
    with RolloutPool(Ledger, 12, 3, seed=0) as pool:
        pool.reset()
        for _ in range(20):
            batch = pool.recv()
            assert batch.env_ids.tolist() == list(range(36))
            pool.send(np.zeros(36, np.int64))
        pool.recv()
        assert pool.stats.steps == 36 * 20


def test_versions_steps_and_seeds_come_back() -> None:
    with RolloutPool(Ledger, 1, 2, autoreset="Disabled") as pool:
        pool.reset(seeds=[10, 13])
        batch = pool.recv()
        assert batch.seeds.tolist() == [10, 13]
        assert batch.steps.tolist() == [0, 0]
        pool.send([0, 0], version=41)
        batch = pool.recv()
        assert batch.versions.tolist() == [41, 41]
        assert batch.steps.tolist() == [1, 1]


def test_the_learner_chooses_the_seed_of_each_episode() -> None:
    with RolloutPool(Ledger, 1, 1, seed=5) as pool:
        pool.reset(seeds=[20])  # two steps
        batch = pool.recv()
        begun = [int(batch.seeds[0])]
        waiting = iter([25, 30, 35])
        pool.seed_next([0], [next(waiting)])
        while len(begun) < 4:
            pool.send([0])
            batch = pool.recv()
            if batch.is_first[0]:
                begun.append(int(batch.seeds[0]))
                pool.seed_next([0], [next(waiting, None)])
        assert begun == [20, 25, 30, 35]
        assert batch.observation["seed"].tolist() == [35]


def test_disabled_autoreset_waits_for_a_reset_with_options() -> None:
    with RolloutPool(Ledger, 1, 2, autoreset="Disabled") as pool:
        pool.reset(seeds=[20, 24], options={"room": 7})
        batch = pool.recv()
        assert batch.infos == {0: {"options": {"room": 7}}, 1: {"options": {"room": 7}}}
        for _ in range(2):
            pool.send([0, 0])
            batch = pool.recv()
        assert batch.terminated.tolist() == [True, False]
        assert not batch.is_first.any()
        assert batch.infos[0] == {"last": 20}
        assert batch.observation["step"].tolist() == [2, 2], "the final observation is the observation"
        pool.send([0], [0])
        with pytest.raises(gym.error.ResetNeeded, match="call reset first"):
            pool.recv()
        pool.reset([0], seeds=[21])
        batch = pool.recv()
        assert batch.env_ids.tolist() == [0]
        assert batch.is_first.tolist() == [True]
        assert batch.observation["seed"].tolist() == [21]


def test_final_observation_and_infos_survive_the_autoreset() -> None:
    with RolloutPool(Ledger, 1, 3) as pool:
        pool.reset(seeds=[20, 24, 25])
        pool.recv()
        pool.seed_next([0, 1, 2], [7, 8, 9])
        for _ in range(2):
            pool.send([0, 0, 0])
            batch = pool.recv()
        assert batch.final_rows.tolist() == [0, 2]
        assert batch.final_observation["seed"].tolist() == [20, 25]
        assert batch.final_observation["step"].tolist() == [2, 2]
        assert batch.observation["seed"].tolist() == [7, 24, 9]
        assert batch.terminated.tolist() == [True, False, False]
        assert batch.truncated.tolist() == [False, False, True]
        assert batch.infos[0]["final_info"] == {"last": 20}


def test_kept_arrays_never_change_and_dropped_ones_are_recycled() -> None:
    with RolloutPool(Ledger, 1, 2, seed=0) as pool:
        pool.reset()
        kept: list[tuple[Any, Any]] = []
        for step in range(60):
            batch = pool.recv()
            if step % 10 == 0:
                array = batch.observation["bytes"][1:]
                kept.append((torch.from_numpy(array), array.copy()))
            pool.send([0, 0])
            del batch
        pool.recv()
        for tensor, copy in kept:
            assert np.array_equal(tensor.numpy(), copy)
        assert len(pool._blocks) <= len(kept) + 2
        del kept, array, tensor
        gc.collect()
        before = len(pool._blocks)
        for _ in range(20):
            pool.send([0, 0])
            pool.recv()
        assert len(pool._blocks) == before


def test_an_array_of_few_rows_does_not_hold_the_memory_of_all() -> None:
    with RolloutPool(Ledger, 1, 16, seed=0) as pool:
        for count in (1, 3, 4, 16):
            pool.reset(list(range(count)))
            batch = pool.recv()
            array = batch.observation["bytes"]
            assert np.shares_memory(array, batch.observation["bytes"])
            held = array if array.base is None else array.base
            assert (held.nbytes == array.nbytes) == (4 * count < 16)
            assert batch.observation["seed"].tolist() == batch.seeds.tolist()


def test_a_call_reaches_every_environment() -> None:
    with RolloutPool(Ledger, 2, 2, seed=0) as pool:
        assert pool.call("double", 21) == (42, 42, 42, 42)
        pool.reset()
        seeds = pool.recv().seeds.tolist()
        assert list(pool.call("seed")) == seeds
        with pytest.raises(AttributeError, match="no_such_thing"):
            pool.call("no_such_thing")
        pool.send([0] * 4)
        with pytest.raises(ProtocolError, match="expected no commands under way, found 4"):
            pool.call("double", 1)
        assert len(pool.recv()) == 4


def test_float_actions_and_observations() -> None:
    with RolloutPool(Floats, 1, 2) as pool:
        pool.reset(seeds=[0, 2])
        pool.recv()
        pool.send(torch.tensor([[0.5, 0.25], [1.0, -1.0]]))
        batch = pool.recv()
        assert batch.rewards.tolist() == [0.75, 0.0]
        assert batch.observation.tolist() == [[1.0] * 4] * 2
        with pytest.raises(ShapeError, match=r"actions: expected shape \(2, 2\), got \(2,\)"):
            pool.send(np.zeros(2, np.float32))
        with pytest.raises(DtypeError, match="actions: expected float32, got complex128"):
            pool.send(np.zeros((2, 2), np.complex128))


def test_refusals_change_nothing() -> None:
    with RolloutPool(Ledger, 1, 2, seed=0) as pool:
        with pytest.raises(ProtocolError, match="found 0 under way"):
            pool.recv()
        pool.reset([1])
        with pytest.raises(ProtocolError, match="`send` on stream 1"):
            pool.reset()
        with pytest.raises(LabelError, match=r"0\.\.2, got 2"):
            pool.reset([2])
        with pytest.raises(LabelError, match="got -1"):
            pool.send([0], [-1])
        with pytest.raises(ArgumentError, match="environment 0 twice"):
            pool.send([0, 0], [0, 0])
        with pytest.raises(ProtocolError, match="found 1 under way"):
            pool.recv(2)
        assert pool.recv().env_ids.tolist() == [1]
        pool.reset([0])
        assert pool.recv().env_ids.tolist() == [0]
        pool.send([0, 0])
        assert pool.recv().steps.tolist() == [1, 1]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"num_workers": 0}, "`num_workers`: expected a number of at least 1, got 0"),
        ({"envs_per_worker": 257}, r"`envs_per_worker`: expected a number in 1\.\.=256, got 257"),
        ({"seed": -1}, "seed: expected"),
        ({"on_error": "ignore"}, "on_error: expected one of"),
        ({"start_method": "forkserver"}, "start_method: expected"),
        ({"autoreset": "Sometimes"}, r"autoreset: expected one of .*'NextStep'.*, got 'Sometimes'"),
        ({"env_fn": "vhs/ObjectNav-v0"}, "env_fn: expected a function that makes an environment.* got str"),
        ({"env_fn": gym.Env()}, "env_fn: expected a function .* got Env"),
        ({"env_fn": [Ledger, Ledger]}, "env_fn: expected one function or 1 of them, got 2"),
    ],
)
def test_settings_out_of_range_are_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RolloutPool(**{"env_fn": Ledger, "num_workers": 1, "envs_per_worker": 1} | wrong)


def test_a_wrong_observation_is_an_error_that_names_the_part() -> None:
    with RolloutPool(WrongShape, 1) as pool:
        pool.reset()
        with pytest.raises(
            ShapeError, match=r"observation\['bytes'\]: expected shape \(20000,\), got \(3,\)"
        ):
            pool.recv()


class WrongShape(Ledger):
    def observe(self) -> dict[str, Any]:
        return super().observe() | {"bytes": np.zeros(3, np.uint8)}


def test_infos_larger_than_their_room_arrive_whole_and_leave_no_memory_behind() -> None:
    with RolloutPool(Verbose, 1, 2, info_bytes=4096) as pool:
        pool.reset(seeds=[4, 9])  # of six steps
        pool.recv()
        for sizes in ([3000, 5000], [9000, 8000], [10, 9999], [4000, 4100]):
            pool.send(sizes)
            infos = pool.recv().infos
            assert [len(infos[row]["long"]) for row in range(2)] == [1000 * size for size in sizes]
        pool.send([1, 1])
        pool.recv()
        assert memory_of_files() < 1 << 20


def memory_of_files() -> int:
    """Bytes that this process's nameless files take."""
    files = [Path(f"/proc/self/fd/{number}") for number in os.listdir("/proc/self/fd")]
    found = [file for file in files if "vhs-rollout-overflow" in str(file.resolve(strict=False))]
    assert found
    return sum(file.stat().st_blocks * 512 for file in found)


class Verbose(Ledger):
    action_space = gym.spaces.Discrete(10_000)

    def step(self, action: Any) -> Any:
        return *super().step(action)[:4], {"long": "x" * 1000 * int(action)}


def test_options_calls_and_errors_larger_than_their_room_arrive_whole() -> None:
    with RolloutPool(Loud, 1, 2, info_bytes=4096) as pool:
        pool.reset(options={"long": "x" * 50_000})
        assert [len(info["options"]["long"]) for info in pool.recv().infos.values()] == [50_000] * 2
        assert pool.call("echo", "y" * 60_000) == ("y" * 60_000,) * 2
        assert [len(frames) for frames in pool.call("film")] == [20] * 2
        pool.send([999, 0])
        with pytest.raises(ValueError, match="x" * 30_000):
            pool.recv()


class Loud(Ledger):
    def echo(self, text: str) -> str:
        return text

    def film(self) -> list[np.ndarray]:
        return [np.zeros((400, 600, 3), np.uint8)] * 20

    def step(self, action: Any) -> Any:
        if action == 999:
            raise ValueError("x" * 30_000)
        return super().step(action)


def test_a_timeout_loses_nothing() -> None:
    with RolloutPool(Slow, 1, seed=0) as pool:
        pool.reset()
        pool.recv()
        pool.send([0])
        with pytest.raises(TimeoutError):
            pool.recv(timeout=0.05)
        assert pool.recv(timeout=10).steps.tolist() == [1]


def test_close_ends_everything_and_may_be_repeated() -> None:
    descriptors = open_descriptors()
    pool = RolloutPool(Ledger, 3, 1, seed=0)
    pool.reset()
    batch = pool.recv()
    pids = pool.pids
    pool.close()
    pool.close()
    assert pool.closed
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)
    with pytest.raises(PoolClosedError):
        pool.send([0, 0, 0])
    assert (batch.observation["bytes"][0] == batch.observation["bytes"][0, 0]).all(), "batches stay"
    del pool, batch
    assert open_descriptors() == descriptors


def test_a_forgotten_pool_ends_its_workers() -> None:
    pool = RolloutPool(Ledger, 1)
    (pid,) = pool.pids
    del pool
    gc.collect()
    assert not Path(f"/proc/{pid}").exists()


def test_idle_workers_and_an_idle_learner_take_next_to_no_time() -> None:
    with RolloutPool(Ledger, 2, 2, seed=0) as pool:
        pool.reset()
        pool.recv()
        time.sleep(0.3)

        def spent_s() -> list[float]:
            ticks = [
                Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[11:13] for pid in pool.pids
            ]
            return [sum(map(int, pair)) / os.sysconf("SC_CLK_TCK") for pair in ticks]

        before, learner_s = spent_s(), time.process_time()
        time.sleep(2.0)
        assert time.process_time() - learner_s <= 0.1, "no thread of the learner spins"
        assert all(b - a <= 0.02 for a, b in zip(before, spent_s(), strict=True)), "one per cent"


def test_unseeded_pools_differ_and_seeded_ones_agree() -> None:
    def first(seed: int | None) -> list[int]:
        with RolloutPool(Ledger, 1, 2, seed=seed) as pool:
            pool.reset()
            return [int(x) for x in pool.recv().observation["seed"]]

    assert first(None) != first(None)
    assert first(3) == first(3)
    assert len(set(first(3))) == 2


def test_the_name_is_at_the_top_and_brings_nothing_with_it() -> None:
    assert vhs.RolloutPool is RolloutPool
    script = "import sys, vhs; assert not {'gymnasium', 'torch', 'mujoco', 'vhs.rollout'} & set(sys.modules)"
    assert os.system(f'{os.sys.executable} -c "{script}"') == 0  # type: ignore[attr-defined]


def test_a_batch_says_how_long_it_is() -> None:
    with RolloutPool(partial(Ledger), 1, 2, seed=0) as pool:
        pool.reset()
        batch = pool.recv()
        assert isinstance(batch, Batch)
        assert len(batch) == 2
        assert repr(pool) == "RolloutPool(1 workers x 2 environments, 0 under way)"
