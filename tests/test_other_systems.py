"""Where the system has no workers, as all but Linux, everything else works, and who asks for them is told."""

import subprocess
import sys
from pathlib import Path

import pytest

import vhs
from vhs.cli import main


def test_a_pool_says_what_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("vhs.rollout")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "platform", "darwin")
    with pytest.raises(ImportError, match="expected Linux, in whose memory its workers meet, found darwin"):
        vhs.RolloutPool  # noqa: B018


def test_asking_for_workers_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    arguments = ["--config", "debug", "--set", "env.num_workers=2", "--out", str(tmp_path / "run")]
    assert main(["train", *arguments]) == 1
    assert capsys.readouterr().err == "vhs: env.num_workers: expected 0 on darwin, found 2\n"


@pytest.mark.slow
def test_everything_else_works(tmp_path: Path) -> None:
    code = """
import os, sys
import torch, numpy, gymnasium, mujoco  # they look at the real system
sys.platform = "darwin"
sys.modules["fcntl"] = None
del os.sched_getaffinity
from vhs.cli import main
run = sys.argv[1]
assert main(["train", "--config", "debug", "--set", "train.episodes=8", "--out", run]) == 0
assert main(["eval", run, "--episodes", "2"]) == 0
assert main(["export", run, run + "-agent"]) == 0
assert main(["play", run, "--episodes", "1", "--out", run + ".gif"]) == 0
assert main(["report", run, "--episodes", "2"]) == 0
"""
    command = [sys.executable, "-c", code, str(tmp_path / "run")]
    told = subprocess.run(command, capture_output=True, text=True, check=False, timeout=100)
    assert told.returncode == 0, told.stdout + told.stderr
