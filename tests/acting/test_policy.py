"""A policy to act with: what it reads of a run, and what it does without."""

from io import StringIO
from pathlib import Path

import numpy as np
import pytest
import torch

from vhs import LabelError, ShapeError
from vhs.acting.policy import load_agent
from vhs.config import load_config
from vhs.errors import CheckpointError
from vhs.runs.checkpoint import load_checkpoint, save_checkpoint
from vhs.train import train

DEBUG = Path(__file__).parents[2] / "configs" / "debug.yaml"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = tmp_path_factory.mktemp("run") / "run"
    train(load_config([DEBUG], ["train.episodes=8", "env.num_workers=0"]), run, StringIO())
    return run


def test_a_run_is_loaded_to_act_without_an_optimiser(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object, **kwargs: object) -> None:
        raise AssertionError("an optimiser was built")

    monkeypatch.setattr(torch.optim, "Adam", refuse)
    policy = load_agent(run)
    saved = load_checkpoint(run)[0]["learner"]
    assert policy.trained_episodes == 8
    assert not policy.agent.training
    for name, value in policy.agent.state_dict().items():
        assert torch.equal(value, saved["average"]["agent"][name]), name
    for name, value in policy.goals.state_dict().items():
        assert torch.equal(value, saved["prototypes"][name]), name


def test_of_a_checkpoint_agent_and_goals_alone_are_read(run: Path, tmp_path: Path) -> None:
    state, store = load_checkpoint(run)
    (tmp_path / "config.yaml").write_bytes((run / "config.yaml").read_bytes())
    needed = {name: state["learner"][name] for name in ("agent", "prototypes")}  # without an average
    rest = {name: state[name] for name in ("progress", "settings")}
    save_checkpoint(tmp_path, 8, {"learner": needed, **rest}, store, keep=1)
    assert load_agent(tmp_path).trained_episodes == 8
    save_checkpoint(tmp_path, 9, {"learner": {"agent": needed["agent"]}, **rest}, store, keep=1)
    with pytest.raises(CheckpointError, match="of this version of vhs, found one without 'prototypes'"):
        load_agent(tmp_path)


def test_a_picture_is_asked_for_by_its_features(run: Path) -> None:
    policy = load_agent(run)
    pictures = np.random.default_rng(0).integers(0, 256, (2, 2, 84, 84, 3), dtype=np.uint8)
    features = policy.embed(pictures)
    assert (features.shape, features.dtype, features.requires_grad) == ((2, 32), torch.float32, False)
    assert torch.equal(features, policy.agent.extractor(torch.from_numpy(pictures)))


def test_a_goal_is_shown_by_name_in_frames_or_observations(run: Path) -> None:
    """A frame is seen twice, as what an agent sees that stands still."""
    policy, other = load_agent(run), load_agent(run)
    frames = np.random.default_rng(0).integers(0, 256, (3, 84, 84, 3), dtype=np.uint8)
    policy.show("milk", frames)
    other.show(4, np.concatenate([frames, frames], axis=-1))
    found = policy.goals.begin(4)
    stacks = torch.from_numpy(np.stack([frames, frames], axis=1))
    with torch.inference_mode():
        torch.testing.assert_close(found, policy.agent.extractor(stacks, policy.dtype).mean(dim=0))
    assert torch.equal(found, other.goals.begin(4))


def test_a_goal_that_is_none_and_pictures_of_another_size_are_sentences(run: Path) -> None:
    policy = load_agent(run)
    with pytest.raises(LabelError, match=r"show: expected a goal of task task2 \(mustard, .*\), found 'tea'"):
        policy.show("tea", np.zeros((1, 84, 84, 3), np.uint8))
    with pytest.raises(LabelError, match=r"show: expected a goal of task task2 \(mustard, .*\), found 1\.5"):
        policy.show(1.5, np.zeros((1, 84, 84, 3), np.uint8))  # type: ignore[arg-type]
    with pytest.raises(ShapeError, match=r"\[n, 84, 84, 6\], n at least 1, found \[1, 64, 64, 3\]"):
        policy.show("milk", np.zeros((1, 64, 64, 3), np.uint8))
