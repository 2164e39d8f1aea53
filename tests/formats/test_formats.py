"""Files that earlier versions wrote: read to the values that they had, or refused by name."""

import hashlib
import shutil
from io import StringIO
from pathlib import Path

import pytest

from vhs.acting.policy import Policy, load_agent
from vhs.config import load_config
from vhs.errors import CheckpointError
from vhs.runs.checkpoint import newest_checkpoint, read_checkpoint
from vhs.runs.reader import read_run
from vhs.train import train

HERE = Path(__file__).parent


def digest(trained: Policy) -> str:
    """Of the weights as float16, which an exported agent keeps."""
    content = hashlib.sha256()
    for name, value in sorted(trained.agent.state_dict().items()):
        content.update(name.encode() + value.half().numpy().tobytes())
    return content.hexdigest()[:16]


@pytest.mark.parametrize("name", ["run-1", "run-2"])
def test_a_run_is_read(name: str) -> None:
    run = read_run(HERE / name)
    assert (run.name, run.config.task, run.config.model.channels) == (name, "task2", (2, 2, 2, 2))
    assert [(row["episodes"], row["env_steps"]) for row in run.rows] == [(12, 159), (24, 315)]
    assert [(entry["success"], entry["spl"]) for entry in run.evaluations] == [(0.125, 0.09375)]
    assert run.made_by["version"] == "0.1.0"
    assert run.has_checkpoint


@pytest.mark.parametrize("name", ["run-2", "agent-1"])
def test_an_agent_is_loaded(name: str) -> None:
    trained = load_agent(HERE / name)
    assert trained.trained_episodes == 24
    assert digest(trained) == "d62b527027abcb84"
    assert trained.goals.prototypes.seen.tolist() == [True, False, False, False, False]
    assert trained.goals.prototypes.table[0, :3] == pytest.approx([-1.238749, 1.254369, 0.775483], abs=1e-6)


def test_a_checkpoint_is_gone_on_from(tmp_path: Path) -> None:
    run = shutil.copytree(HERE / "run-2", tmp_path / "run")
    assert train(load_config([run / "config.yaml"], ["train.episodes=28"]), run, StringIO())
    assert newest_checkpoint(run) == 28
    # The goal store of the file is part of it.
    assert len(read_checkpoint(HERE / "run-2" / "checkpoints" / "episode-000000024")[1]) == 2


def test_a_checkpoint_with_a_pickle_is_refused_by_name(tmp_path: Path) -> None:
    run = shutil.copytree(HERE / "run-1", tmp_path / "run")
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    told = "expected a checkpoint of format vhs-checkpoint-2, found state.pt, which vhs up to 0.1.0 wrote"
    with pytest.raises(CheckpointError, match=told):
        load_agent(run)
    with pytest.raises(CheckpointError, match=told):
        train(load_config([run / "config.yaml"], ["train.episodes=32"]), run, StringIO())
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before
