"""A run that was killed or stopped goes on as if nothing had happened: every bit of it is compared."""

import os
import shutil
import signal
import subprocess
import sys
import time
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
import torch
from debug import DEBUG, debug_config

from vhs.config import Config
from vhs.errors import CheckpointError
from vhs.runs.checkpoint import load_checkpoint, read_checkpoint, save_checkpoint
from vhs.runs.directory import open_run
from vhs.runs.rows import read_log
from vhs.train import train
from vhs.train.log import TrainingLog
from vhs.train.session import Session

pytestmark = pytest.mark.slow

EPISODES = 80
CLOCKS = {"time/minutes", "speed/steps_per_s"}
# After every update, so that saving is what a kill hits.
OFTEN = "train.checkpoint_every_s=1e-6"


def configured(*overrides: str) -> Config:
    return debug_config(f"train.episodes={EPISODES}", "env.num_workers=0", *overrides)


def test_a_checkpoint_that_another_process_made_since_is_not_gone_back_from(tmp_path: Path) -> None:
    run = tmp_path / "run"
    train(configured("train.episodes=4"), run, StringIO())
    config = configured("train.episodes=12")
    stale = Session(config, run)
    stale.close()
    train(configured("train.episodes=8"), run, StringIO())
    before = (run / "run.json").read_bytes(), (run / "config.yaml").read_bytes()
    with (
        pytest.raises(CheckpointError, match="another process has just trained here; start again"),
        open_run(config, run, precision="float32", episodes=stale.progress.episodes),
    ):
        pass
    assert before == ((run / "run.json").read_bytes(), (run / "config.yaml").read_bytes())


def checkpoint(run: Path, episode: int) -> Path:
    return run / "checkpoints" / f"episode-{episode:09d}"


def load_state(run: Path, episode: int = EPISODES) -> dict[str, Any]:
    return read_checkpoint(checkpoint(run, episode))[0]


def differences(a: Any, b: Any, where: str = "") -> list[str]:
    """Places where two states differ, all but the wall-clock."""
    if isinstance(a, dict) and isinstance(b, dict) and a.keys() == b.keys():
        return [found for key in a for found in differences(a[key], b[key], f"{where}/{key}")]
    if isinstance(a, list | tuple) and isinstance(b, list | tuple) and len(a) == len(b):
        return [
            found
            for i, pair in enumerate(zip(a, b, strict=True))
            for found in differences(*pair, f"{where}/{i}")
        ]
    if isinstance(a, torch.Tensor) and isinstance(b, torch.Tensor):
        is_same = a.dtype == b.dtype and torch.equal(a, b)
    else:
        is_same = type(a) is type(b) and a == b
    return [] if is_same or where == "/progress/seconds" else [where]


def without_clocks(run: Path) -> list[dict[str, Any]]:
    return [{key: value for key, value in row.items() if key not in CLOCKS} for row in read_log(run)]


def assert_same(run: Path, straight: Path) -> None:
    last = newest_episode(straight)
    assert differences(load_state(run, last), load_state(straight, last)) == []
    goals = [(checkpoint(path, last) / "goals.vhs").read_bytes() for path in (run, straight)]
    assert goals[0] == goals[1]
    assert without_clocks(run) == without_clocks(straight)


@pytest.fixture(scope="module")
def straight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that nothing interrupted."""
    run = tmp_path_factory.mktemp("straight") / "run"
    train(configured(), run, StringIO())
    return run


def newest_episode(run: Path) -> int:
    saved = sorted((run / "checkpoints").glob("episode-*"))
    return int(saved[-1].name.removeprefix("episode-")) if saved else -1


def kill_after(episode: int, run: Path, *overrides: str) -> None:
    """Train in a process of its own until a checkpoint of `episode` or later is there, then SIGKILL."""
    sets = [part for override in overrides for part in ("--set", override)]
    command = [sys.executable, "-m", "vhs.cli", "train", "--config", str(DEBUG), *sets, "--out", str(run)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 90
    while newest_episode(run) < episode and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.002)
    os.kill(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL, "the run ended before it was killed"


def test_a_run_killed_twice_equals_the_uninterrupted_one(straight: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    kill_after(12, run, f"train.episodes={EPISODES}", "env.num_workers=1", OFTEN)
    assert 12 <= newest_episode(run) < 40, "killed in the first window of the log"
    kill_after(newest_episode(run) + 12, run, f"train.episodes={EPISODES}", "env.num_workers=0", OFTEN)
    assert newest_episode(run) < EPISODES
    assert train(configured("env.num_workers=1"), run, StringIO())
    assert_same(run, straight)


def test_the_comparison_sees_a_single_bit(straight: Path) -> None:
    before, after = load_state(straight), load_state(straight)
    after["learner"]["agent"]["lstm.bias_hh_l0"].view(torch.int32)[3] ^= 1
    after["episodes"]["rollout"]["values"].view(torch.int32)[0] ^= 1
    assert differences(before, after) == ["/learner/agent/lstm.bias_hh_l0", "/episodes/rollout/values"]


@pytest.mark.parametrize(
    "overrides",
    [
        [],
        ["method.prototype=exact", "train.episodes_per_update=3", "env.num_envs=5"],
    ],
)
def test_a_run_stopped_by_ctrl_c_equals_the_uninterrupted_one(
    overrides: list[str], straight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, run, other = configured(*overrides), tmp_path / "run", straight
    if overrides:
        other = tmp_path / "straight"
        train(config, other, StringIO())
    advance = Session.advance

    def interrupted(self: Session, log: TrainingLog) -> None:
        advance(self, log)
        if self.progress.episodes > 44 and self.num_waiting and self.num_running:
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(Session, "advance", interrupted)
        assert not train(config, run, StringIO())
    stopped = newest_episode(run)
    assert 44 < stopped < EPISODES
    assert read_log(run)[-1]["episodes"] == stopped, "a stopped run logs its last episodes"
    assert train(config, run, StringIO())
    assert stopped not in [row["episodes"] for row in read_log(run)], "and makes their row again, whole"
    assert_same(run, other)


def test_a_finished_run_that_is_asked_for_more_equals_the_uninterrupted_one(
    straight: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    train(configured("train.episodes=52"), run, StringIO())
    rows = read_log(run)
    train(configured("train.episodes=52"), run, StringIO())
    assert read_log(run) == rows, "a finished run is left as it is"
    train(configured(), run, StringIO())
    assert_same(run, straight)


def test_a_run_that_waits_for_some_environments_only_resumes_too(tmp_path: Path) -> None:
    some = ("env.num_workers=1", "env.min_ready=2")
    train(configured(*some, "train.episodes=12"), tmp_path / "run", StringIO())
    assert train(configured(*some, "train.episodes=44"), tmp_path / "run", StringIO())
    assert [row["episodes"] for row in read_log(tmp_path / "run")] == [40, 44]


def test_what_a_kill_left_half_written_is_removed(tmp_path: Path) -> None:
    run = tmp_path / "run"
    train(configured("train.episodes=4"), run, StringIO())
    partial = run / "checkpoints" / ".partial-episode-000000008"
    partial.mkdir()
    (partial / "state.json").write_bytes(b"{")
    (run / ".partial-7-log.jsonl").write_text("{")
    (run / "thesis.tmp").write_text("mine")
    with (run / "log.jsonl").open("a") as log:
        log.write('{"episodes": 8, "env_st')
    train(configured("train.episodes=8"), run, StringIO())
    assert not partial.exists()
    assert not list(run.glob(".partial-*"))
    assert (run / "thesis.tmp").read_text() == "mine"
    assert [row["episodes"] for row in read_log(run)] == [8]
    assert (run / "log.jsonl").read_text().count("\n") == 1


def rename_a_seed(state: dict[str, Any]) -> None:
    next(iter(state["episodes"]["rollout"]["running"].values()))["seed"] = 1


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (rename_a_seed, "playing the episode of seed 1 again: expected"),
        (lambda state: state.pop("window"), "of this version of vhs, found one without 'window'"),
        (lambda state: state["learner"]["agent"].pop("value.0.bias"), "does not fit the configuration"),
    ],
)
def test_a_checkpoint_that_something_else_made_is_a_clear_error(
    damage: Any, message: str, straight: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    shutil.copytree(straight, run)
    state, goal_store = load_checkpoint(run)
    damage(state)
    shutil.rmtree(checkpoint(run, EPISODES))
    save_checkpoint(run, EPISODES, state, goal_store, keep=2)
    before = (run / "log.jsonl").read_bytes()
    with pytest.raises(CheckpointError, match=message):
        train(configured("train.episodes=120"), run, StringIO())
    assert (run / "log.jsonl").read_bytes() == before
