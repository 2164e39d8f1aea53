"""Two real processes on gloo train one run: alike, resumed bit for bit, stopped, killed, started wrongly."""

import os
import shutil
import signal
import sys
from functools import partial
from io import StringIO
from pathlib import Path

import pytest
from debug import debug_config

import vhs
from vhs.runs.rows import read_log
from vhs.train import exchange, train
from vhs.world import ranks

from .ranks import (
    PATIENCE_S,
    TRAIN,
    Rank,
    children,
    differences,
    free_port,
    is_alive,
    launched,
    newest,
    nothing,
    start,
    state_of,
    together,
    torchrun,
    wait_for,
)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="processes are looked at by /proc"),
]


def command(run: Path, episodes: int, *settings: str) -> list[str]:
    sets = [part for one in (f"train.episodes={episodes}", *settings) for part in ("--set", one)]
    return [*TRAIN, *sets, "--out", str(run)]


@pytest.fixture(scope="module")
def straight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two processes that nothing interrupted."""
    run = tmp_path_factory.mktemp("straight") / "run"
    (first, out, _), (second, quiet, errors) = together(*[command(run, 48, "train.log_every=24")] * 2)
    assert (first, second, quiet, errors) == (0, 0, "", "")
    assert f"finished: {run} (48 episodes)" in out
    return run


def test_two_processes_log_and_save_as_one(straight: Path) -> None:
    rows = read_log(straight)
    assert [row["episodes"] for row in rows] == [24, 48]
    assert [row["updates"] for row in rows] == [6, 12], "an update is four episodes of both together"
    state = state_of(straight)
    (other,) = state["ranks"]
    assert sum(rows[-1][f"goals/{label}"] for label in range(5)) > 0
    assert differences(state["learner"]["prototypes"]["table"], other["learner"]["prototypes"]["table"]) == []
    assert differences(state["actions"], other["actions"]), "each draws for itself"
    assert (state["progress"]["begun"] % 2, other["begun"] % 2) == (0, 1), "no seed is anybody else's"


def test_a_run_of_two_processes_goes_on_bit_for_bit(straight: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    for episodes in (20, 48):
        both = [command(run, episodes, "train.log_every=24")] * 2
        assert [status for status, *_ in together(*both)] == [0, 0]
    assert differences(state_of(run), state_of(straight)) == []


def test_another_number_of_processes_goes_on_and_says_what_changed(straight: Path, tmp_path: Path) -> None:
    run, told = shutil.copytree(straight, tmp_path / "run"), StringIO()
    alone = debug_config("env.num_workers=0", "env.num_envs=3", "train.episodes=60", "train.log_every=24")
    assert train(alone, run, told)
    assert "1 process instead of 2: dropped " in told.getvalue()
    assert "; kept episodes are those of the first process\n" in told.getvalue()
    state = state_of(run)
    used = state_of(straight)
    assert "ranks" not in state
    assert state["progress"]["begun"] > max(used["progress"]["begun"], used["ranks"][0]["begun"])
    assert state["progress"]["episodes"] == 60


def test_vhs_train_starts_processes_itself_and_a_signal_saves_all(tmp_path: Path) -> None:
    run = tmp_path / "run"
    launcher = launched([*command(run, 100_000, "train.log_every=8"), "--processes", "2"])
    wait_for(lambda: read_log(run), launcher)
    started = children(launcher.pid)
    assert len(started) == 2
    launcher.send_signal(signal.SIGINT)
    out, errors = launcher.communicate(timeout=PATIENCE_S)
    assert launcher.returncode == 130, errors
    assert "the same command resumes" in out
    assert newest(run) == read_log(run)[-1]["episodes"]
    assert not any(map(is_alive, started))


def test_a_rank_that_is_killed_ends_the_other_one_with_a_sentence(tmp_path: Path) -> None:
    run = tmp_path / "run"
    first, second = start(*[command(run, 100_000, "train.log_every=8")] * 2)
    wait_for(lambda: read_log(run))
    second.process.kill()
    assert second.ended()[0] == -signal.SIGKILL
    status, _, errors = first.ended()
    assert status == 1
    assert errors.startswith("vhs: another process of this training is gone")
    assert len(errors.splitlines()) == 1


def test_a_signal_to_one_rank_saves_and_ends_all(tmp_path: Path) -> None:
    run = tmp_path / "run"
    first, second = start(*[command(run, 100_000, "train.log_every=8")] * 2)
    wait_for(lambda: read_log(run))
    second.process.terminate()
    (status, out, _), (other, *_) = first.ended(), second.ended()
    assert (status, other) == (130, 130)
    assert f"another process was stopped: saved {run} at episode {newest(run)}" in out


def test_torchrun_goes_on_from_the_newest_checkpoint_when_a_rank_is_killed(tmp_path: Path) -> None:
    run = tmp_path / "run"
    often = command(run, 100_000, "train.checkpoint_every_s=0.5", "train.log_every=8")
    launcher = torchrun(often, "--max-restarts=1")
    wait_for(lambda: newest(run) >= 0, launcher)
    victims = children(launcher.pid)
    os.kill(victims[1], signal.SIGKILL)
    wait_for(lambda: not any(map(is_alive, victims)))
    saved = newest(run)
    wait_for(lambda: newest(run) > saved, launcher)
    launcher.send_signal(signal.SIGTERM)
    out, _ = launcher.communicate(timeout=PATIENCE_S)
    assert f"resuming {run} at episode {saved}" in out
    assert "the same command resumes" in out
    episodes = [row["episodes"] for row in read_log(run)]
    assert episodes == sorted(set(episodes)), "no episode is logged twice"
    assert episodes[-1] == newest(run)


def test_a_launcher_that_is_killed_leaves_no_orphan(tmp_path: Path) -> None:
    run = tmp_path / "run"
    launcher = torchrun(command(run, 100_000, "train.log_every=8"))
    wait_for(lambda: read_log(run), launcher)
    started = children(launcher.pid)
    launcher.kill()
    said = launcher.communicate(timeout=PATIENCE_S)
    wait_for(lambda: not any(map(is_alive, started)))
    assert newest(run) == read_log(run)[-1]["episodes"], f"what they had learned is saved: {said}"


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (["--set", "train.gamma=0.5"], "train.gamma: expected 0.9 as rank 0 has it, found 0.5"),
        (["--set", "task=task1"], "task: expected task2 as rank 0 has it, found task1"),
        (["--set", "train.gama=0.5"], "unknown key `train.gama`; did you mean `train.gamma`?"),
    ],
)
def test_a_rank_with_another_configuration_is_named_by_rank_0(
    other: list[str], message: str, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    (first, _, errors), (second, _, quiet) = together(command(run, 8), [*command(run, 8), *other])
    assert (first, second, quiet) == (1, 1, "")
    assert errors.startswith("vhs: rank 1 (")
    assert message in errors
    assert not run.exists()


def test_a_rank_of_another_version_is_named_by_rank_0(tmp_path: Path) -> None:
    def grow_old() -> None:
        vhs.__version__ = "0.0.9"

    run = tmp_path / "run"
    (first, _, errors), (second, _, quiet) = together(*[command(run, 8)] * 2, prepare=[nothing, grow_old])
    assert (first, second, quiet) == (1, 1, "")
    assert f"version of vhs: expected {vhs.__version__} as rank 0 has it, found 0.0.9" in errors


def test_a_directory_that_a_rank_does_not_see_is_named_by_rank_0(tmp_path: Path) -> None:
    def go_to(name: str) -> None:
        exchange._SEEN_WITHIN_S = 0.1
        (tmp_path / name).mkdir()
        os.chdir(tmp_path / name)

    hosts = [partial(go_to, name) for name in ("here", "there")]
    (first, _, errors), (second, _, quiet) = together(*[command(Path("run"), 8)] * 2, prepare=hosts)
    assert (first, second, quiet) == (1, 1, "")
    assert errors.startswith("vhs: rank 1 (")
    assert "run, which all hosts must share: expected there as rank 0 has it, found another one" in errors


def test_what_is_wrong_everywhere_is_said_once(tmp_path: Path) -> None:
    run = tmp_path / "run"
    wrong = command(run, 8, "train.episodes_per_update=3")
    (first, _, errors), (second, _, quiet) = together(wrong, wrong)
    assert (first, second, quiet) == (1, 1, "")
    assert errors.startswith("vhs: train.episodes_per_update: expected a multiple of 2")
    assert not run.exists()


def test_a_rendezvous_that_nobody_joins_ends_with_a_sentence(tmp_path: Path) -> None:
    def be_impatient() -> None:
        ranks.JOIN_S = 1.0

    arguments = command(tmp_path / "run", 8)
    rank = Rank(0, 2, free_port(), arguments, be_impatient)
    status, _, errors = rank.ended()
    assert status == 1
    assert errors.splitlines()[-1].startswith("vhs: rank 0: expected 2 processes at 127.0.0.1:")
