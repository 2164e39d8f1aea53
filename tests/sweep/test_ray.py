"""Sweeps on a real Ray cluster of this machine, whose runs are a stand-in for `vhs`."""

import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from stand_in import FOUR_RUNS, STAND_IN, Journal

import vhs
from vhs.errors import ConfigError
from vhs.sweep.cluster import RayPlace
from vhs.sweep.node import Site
from vhs.sweep.runner import sweep

pytest.importorskip("ray", reason="needs vhs-rl[ray]")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("default"),  # Ray's own
    pytest.mark.skipif(
        not sys.platform.startswith("linux"), reason="a lost worker's process ends on Linux alone"
    ),
]


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two cores on one node, whose processes find the stand-in in place of `vhs.cli`."""
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(STAND_IN))
        patch.setenv("STAND_IN_VERSION", vhs.__version__)
        patch.setenv("STAND_IN_REST", str(Path(vhs.__file__).parent))
        cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 2, "include_dashboard": False})
        yield cluster
        cluster.shutdown()


@pytest.fixture
def journal(tmp_path: Path) -> Journal:
    (tmp_path / "sweep.yaml").write_text(FOUR_RUNS)
    tell(tmp_path)
    return Journal(tmp_path / "journal")


def tell(root: Path, **settings: str) -> None:
    told = {"STAND_IN_JOURNAL": str(root / "journal"), "STAND_IN_S": "0.1"} | settings
    (root / "stand_in.json").write_text(json.dumps(told))


def run_sweep(root: Path, cluster: Any, **more: Any) -> tuple[int, list[str]]:
    told = StringIO()
    status = sweep(root / "sweep.yaml", root / "out", stream=told, ray=cluster.address, **more)
    return status, told.getvalue().splitlines()


@contextmanager
def when(journal: Journal, event: str, count: int, act: Callable[[], None]) -> Iterator[None]:
    """Do something as soon as stand-ins have written down so many events."""

    def wait() -> None:
        journal.wait_for(event, count)
        act()

    thread = threading.Thread(target=wait)
    thread.start()
    yield
    thread.join()


def test_a_sweep_runs_on_a_cluster_and_is_not_repeated(
    cluster: Any, tmp_path: Path, journal: Journal
) -> None:
    status, lines = run_sweep(tmp_path, cluster)
    assert status == 0, lines
    assert sorted(journal.of("train")) == sorted(journal.of("eval"))
    assert len(set(journal.of("train"))) == len(journal.of("train")) == 4
    assert all(line.endswith(": success 50.0%, SPL 0.250, 4 episodes") for line in lines[:4])
    assert os.getpid() not in {entry.get("parent") for entry in journal.entries}
    before = len(journal.entries)
    assert run_sweep(tmp_path, cluster)[0] == 0
    assert len(journal.entries) == before


def test_the_trials_of_a_search_run_on_a_cluster(cluster: Any, tmp_path: Path, journal: Journal) -> None:
    pytest.importorskip("optuna", reason="needs vhs-rl[optuna]")
    keys = "{method.relabel_probability: {low: 0, high: 1}}"
    (tmp_path / "sweep.yaml").write_text(f"set: {{train.episodes: 4}}\nsearch: {{trials: 3, keys: {keys}}}")
    status, lines = run_sweep(tmp_path, cluster)
    assert status == 0, lines
    assert len(set(journal.of("eval"))) == 3
    assert lines[3].startswith("best of 3 trials: success 50.0% in ")


def test_a_failed_run_is_told_and_the_others_go_on(cluster: Any, tmp_path: Path, journal: Journal) -> None:
    failing, dying = "relabel_probability=0.4-seed0", "relabel_probability=0.4-seed1"
    tell(tmp_path, STAND_IN_FAILS=failing, STAND_IN_DIES=dying)
    status, lines = run_sweep(tmp_path, cluster)
    assert status == 1
    failed = "\n".join(line for line in lines if "failed" in line)
    assert f"{failing}: failed: vhs: the roof fell in (see " in failed
    assert f"{dying}: failed: killed by signal 9 (Killed) (see " in failed
    assert len(journal.of("eval")) == 2


def test_a_signal_stops_every_run_once_and_cleanly(cluster: Any, tmp_path: Path, journal: Journal) -> None:
    tell(tmp_path, STAND_IN_S="60")
    with when(journal, "train", 2, lambda: os.kill(os.getpid(), signal.SIGINT)):
        status, lines = run_sweep(tmp_path, cluster, jobs=3)  # Ray lets the third wait
    assert status == 130
    assert len(journal.of("train")) == 2
    assert sorted(journal.of("stopped")) == sorted(journal.of("end")) == sorted(journal.of("train"))
    assert lines[0] == "SIGINT: 3 runs save and end; the same command resumes"
    tell(tmp_path)
    assert run_sweep(tmp_path, cluster)[0] == 0


def test_a_task_that_dies_is_a_failed_run_whose_process_ends(
    cluster: Any, tmp_path: Path, journal: Journal
) -> None:
    tell(tmp_path, STAND_IN_S="60")

    def kill() -> None:
        for entry in journal.entries:
            os.kill(entry["parent"], signal.SIGKILL)

    (tmp_path / "sweep.yaml").write_text("set: {train.episodes: 4}\ngrids: [{}]")
    with when(journal, "train", 1, kill):
        status, lines = run_sweep(tmp_path, cluster)
    assert status == 1
    assert "task2-vhs-seed0: failed: its Ray task died: The worker died unexpectedly" in lines[0]
    journal.wait_for("end")
    tell(tmp_path)
    assert run_sweep(tmp_path, cluster)[0] == 0


def test_a_node_that_does_not_see_the_sweep_is_named(
    cluster: Any, tmp_path: Path, journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = Site(tmp_path, tmp_path / "out" / ".lock", "another")
    monkeypatch.setattr("vhs.sweep.cluster._mark", lambda directory, lock: elsewhere)
    with pytest.raises(
        ConfigError, match=r"--ray .*: node .*: expected to see .*/out, on a file system that"
    ):
        run_sweep(tmp_path, cluster)
    assert journal.entries == []


def test_runs_share_the_cores_of_the_cluster(cluster: Any) -> None:
    for jobs, cores in ((None, 1), (1, 2), (2, 1), (5, 1)):
        place = RayPlace(cluster.address, jobs)
        assert place.cores_per_run == cores
        place.leave()


def test_a_lost_node_fails_its_run(cluster: Any, tmp_path: Path, journal: Journal) -> None:
    tell(tmp_path, STAND_IN_S="60")
    (tmp_path / "sweep.yaml").write_text("set: {train.episodes: 4}\ngrids: [{}]")
    node = cluster.add_node(num_cpus=3)
    cluster.wait_for_nodes()
    with when(journal, "train", 1, lambda: cluster.remove_node(node, allow_graceful=False)):
        status, lines = run_sweep(tmp_path, cluster, jobs=1)  # three cores: on that node alone
    assert status == 1
    assert "task2-vhs-seed0: failed: its Ray task died: " in lines[0]
