"""Files that earlier versions wrote: read to the values that they had, or refused by name."""

import hashlib
import shutil
from io import StringIO
from pathlib import Path

import pytest
import torch

from vhs.acting.policy import Policy, load_agent
from vhs.config import load_config
from vhs.runs.checkpoint import newest_checkpoint
from vhs.runs.reader import read_run
from vhs.train import train

HERE = Path(__file__).parent


def digest(trained: Policy) -> str:
    """Of the weights as float16, which an exported agent keeps."""
    content = hashlib.sha256()
    for name, value in sorted(trained.agent.state_dict().items()):
        content.update(name.encode() + value.half().numpy().tobytes())
    return content.hexdigest()[:16]


def test_a_run_is_read() -> None:
    run = read_run(HERE / "run-1")
    assert (run.name, run.config.task, run.config.model.channels) == ("run-1", "task2", (2, 2, 2, 2))
    assert [(row["episodes"], row["env_steps"]) for row in run.rows] == [(12, 159), (24, 315)]
    assert [(entry["success"], entry["spl"]) for entry in run.evaluations] == [(0.125, 0.09375)]
    assert run.made_by["commit"] == "6ec4a1689e8e"


@pytest.mark.parametrize("name", ["run-1", "agent-1"])
def test_an_agent_is_loaded_from_a_run_and_from_an_export(name: str) -> None:
    trained = load_agent(HERE / name)
    assert trained.trained_episodes == 24
    assert digest(trained) == "d62b527027abcb84"
    assert trained.goals.prototypes.seen.tolist() == [True, False, False, False, False]
    assert trained.goals.prototypes.table[0, :3] == pytest.approx([-1.238749, 1.254369, 0.775483], abs=1e-6)


def test_a_run_goes_on(tmp_path: Path) -> None:
    run = shutil.copytree(HERE / "run-1", tmp_path / "run")
    config = load_config([run / "config.yaml"], ["train.episodes=32"])
    torch.set_num_threads(1)
    assert train(config, run, StringIO())
    assert newest_checkpoint(run) == 32
