"""A run that begins where another one stands: what it takes along, what is its own, and what does not fit."""

import json
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
import torch
from debug import DEBUG, debug_config
from numpy.typing import NDArray

from vhs import GoalStore, TaskSpec
from vhs.acting.policy import load_agent
from vhs.cli import main
from vhs.config import load_config
from vhs.errors import CheckpointError
from vhs.learning.learner import Learner
from vhs.runs.checkpoint import load_checkpoint, save_checkpoint
from vhs.runs.rows import read_log
from vhs.train import train
from vhs.train.build import make_learner
from vhs.train.export import export_agent
from vhs.train.start import start

SPEC = TaskSpec((16, 16, 3), num_actions=3, max_episode_steps=6)
MOVES = {0: (0.5, 0.0, 0.0), 1: (0.0, 0.0, 0.8), 2: (0.0, 0.0, -0.8)}


def learner(classes: int, *overrides: str, seed: int = 0) -> Learner:
    """One at its beginning, of a task with `classes` goals."""
    settings = ["model.channels=[4, 4]", "model.feature_dim=8", "method.goal_capacity=120", f"seed={seed}"]
    spec = replace(SPEC, num_goals=classes, moves=MOVES)
    return make_learner(load_config([], [*settings, *overrides]), spec)


def saved(run: Path, of: Learner, images: int = 6) -> Path:
    """The directory of a run in which a learner stands at episode 12, with pictures and prototypes."""
    rng = np.random.default_rng(0)
    for label in range(of.goals.store.num_classes):
        for _ in range(images):
            of.goals.store.push(rng.integers(0, 256, of.goals.store.observation_shape, np.uint8), label)
    state = of.goals.state_dict()
    state["table"][:] = torch.from_numpy(rng.standard_normal(state["table"].shape, dtype=np.float32))
    state["seen"][:] = True
    of.goals.load_state_dict(state)
    save_checkpoint(
        run, 12, {"learner": of.state_dict(), "progress": {"episodes": 12}}, of.goals.store, keep=1
    )
    return run


def pictures(store: GoalStore, label: int) -> set[bytes]:
    """The different ones of a class, in all likelihood all."""
    return {image.tobytes() for image in store.sample_class(label, 400)}


def test_weights_prototypes_and_images_are_taken_and_all_else_is_new(tmp_path: Path) -> None:
    old, new, fresh = learner(3), learner(3, seed=1), learner(3, seed=1)
    begun = start(str(saved(tmp_path, old)), new)
    assert begun.as_dict() == {
        "run": str(tmp_path),
        "episodes": 12,
        "classes": 3,
        "new_classes": 0,
        "prototypes": 3,
        "images": 18,
        "new_heads": (),
    }
    for name, value in new.agent.state_dict().items():
        assert torch.equal(value, old.agent.state_dict()[name]), name
    for name in ("table", "seen"):
        assert torch.equal(new.goals.state_dict()[name], old.goals.state_dict()[name]), name
    assert new.updates == 0
    assert not new.optimiser.state
    for mine, own in zip(generators(new), generators(fresh), strict=True):
        np.testing.assert_array_equal(mine, own)
    assert pictures(new.goals.store, 1) == pictures(old.goals.store, 1)


def generators(of: Learner) -> list[NDArray[np.uint64]]:
    """Of relabelling, of goal images and of prototypes."""
    return [of.rng.state, of.goals.store.rng_state, of.goals.state_dict()["rng"].numpy()]


def test_another_run_begins_with_the_averaged_weights(tmp_path: Path) -> None:
    train(debug_config("train.episodes=12", "env.num_workers=0"), tmp_path / "run", StringIO())
    state, _ = load_checkpoint(tmp_path / "run")
    new = make_learner(debug_config(), load_agent(tmp_path / "run").spec)
    start(str(tmp_path / "run"), new)
    average, newest = state["learner"]["average"]["agent"], state["learner"]["agent"]
    for name, value in new.agent.state_dict().items():
        assert torch.equal(value, average[name]), name
    assert any(not torch.equal(average[name], newest[name]) for name in newest)


@pytest.mark.parametrize("name", ["vhs", "a3c", "gdan"])
def test_new_classes_come_behind_the_old_ones(name: str, tmp_path: Path) -> None:
    """Sight, words and discriminator get rows, prototypes and store a class that has nothing yet."""
    method = f"method.name={name}"
    old, new, fresh = learner(3, method), learner(5, method, seed=1), learner(5, method, seed=1)
    begun = start(str(saved(tmp_path, old)), new)
    assert (begun.classes, begun.new_classes) == (3, 2)
    assert "3 prototypes of 3 goal classes, 18 pictures of goals; new classes: 2" in str(begun)
    grown = set()
    for name, value in new.agent.state_dict().items():
        before, own = old.agent.state_dict()[name], fresh.agent.state_dict()[name]
        if value.shape != before.shape:
            grown.add(name)
            assert torch.equal(value[3:], own[3:]), name
            value = value[:3]
        assert torch.equal(value, before), name
    assert (
        grown
        == {
            "vhs": {"sight.2.weight", "sight.2.bias"},
            "a3c": {"words.weight"},
            "gdan": {"words.weight", "classify.weight", "classify.bias"},
        }[method.partition("=")[2]]
    )
    assert new.goals.state_dict()["seen"].tolist() == [True] * 3 + [False] * 2
    assert new.goals.counts.tolist() == [6, 6, 6, 0, 0]
    for label in range(3):
        assert pictures(new.goals.store, label) <= pictures(old.goals.store, label)


def test_a_smaller_store_takes_as_many_images_as_it_holds(tmp_path: Path) -> None:
    new = learner(3, "method.goal_capacity=100")
    start(str(saved(tmp_path, learner(3), images=110)), new)
    assert new.goals.counts.tolist() == [100, 100, 100]
    assert new.goals.store.capacity_per_class == 100


@pytest.mark.parametrize(
    ("classes", "overrides", "message"),
    [
        (2, [], r"train\.start_from: expected at most 2 goal classes, as the task has, found 3 in "),
        (3, ["model.feature_dim=4"], r"train\.start_from: expected features of 4 numbers, found 8 in "),
        (
            3,
            ["model.hidden_dim=4"],
            r"here too: `bearing\.0\.weight` is of shape \[128, 4\], there \[128, 256\]",
        ),
    ],
)
def test_what_does_not_fit_is_a_sentence_and_changes_nothing(
    classes: int, overrides: list[str], message: str, tmp_path: Path
) -> None:
    run, new = saved(tmp_path, learner(3)), learner(classes, *overrides)
    before = new.digest()
    with pytest.raises(CheckpointError, match=message):
        start(str(run), new)
    assert new.digest() == before
    assert not new.goals.state_dict()["seen"].any()


@pytest.mark.parametrize("lacking", [("localisation",), ("memory",), ("localisation", "memory")])
@pytest.mark.parametrize("is_new", [False, True])
def test_a_head_that_acting_does_not_read_may_be_new_or_missing(
    is_new: bool, lacking: tuple[str, ...], tmp_path: Path
) -> None:
    blind = [f"method.{key}_weight=0" for key in ("localisation", "memory") if key in lacking]
    old, new = (learner(3, *blind), learner(3)) if is_new else (learner(3), learner(3, *blind))
    prefix = new.agent.aside
    fresh = {name: value.clone() for name, value in new.agent.state_dict().items() if name.startswith(prefix)}
    begun = start(str(saved(tmp_path, old)), new)
    heads = {"localisation": "sight", "memory": "bearing"}
    names = tuple(sorted(heads[key] for key in lacking)) if is_new else ()
    assert begun.new_heads == names
    assert (f"heads that are new: {', '.join(names)}" in str(begun)) == is_new
    theirs = old.agent.state_dict()
    for name, value in new.agent.state_dict().items():
        is_old = name in theirs
        assert torch.equal(value, theirs[name] if is_old else fresh[name])


def test_the_start_must_be_there(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"expected a checkpoint in .*, found none"):
        start(str(tmp_path / "nowhere"), learner(3))


@pytest.fixture(scope="module")
def four(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was asked for one object."""
    run = tmp_path_factory.mktemp("four") / "run"
    train(debug_config("train.episodes=8", "env.num_workers=0", "env.room.goals=[mustard]"), run, StringIO())
    return run


@pytest.mark.slow
def test_a_run_says_what_it_began_with_and_resumes_as_if_never_stopped(four: Path, tmp_path: Path) -> None:
    def go_on(run: Path, episodes: int) -> str:
        told = StringIO()
        overrides = [f"train.episodes={episodes}", "env.num_workers=0", f"train.start_from={four}"]
        assert train(debug_config(*overrides), run, told)
        return told.getvalue()

    assert f"starting from {four} at episode 8: its weights, " in go_on(tmp_path / "whole", 16)
    go_on(tmp_path / "stopped", 8)
    assert "starting" not in go_on(tmp_path / "stopped", 16)
    whole, stopped = (load_checkpoint(tmp_path / name)[0]["learner"] for name in ("whole", "stopped"))
    for name, value in whole["agent"].items():
        assert torch.equal(value, stopped["agent"][name]), name
    meta = json.loads((tmp_path / "stopped" / "run.json").read_text())
    assert (meta["start"]["run"], meta["start"]["episodes"]) == (str(four), 8)
    assert "start" not in meta["resumed"][0]
    assert read_log(tmp_path / "whole")[-1]["episodes"] == 16
    with pytest.raises(CheckpointError, match=r"other values of train\.start_from"):
        train(debug_config("train.episodes=24", "env.num_workers=0"), tmp_path / "whole", StringIO())


@pytest.mark.slow
def test_an_exported_agent_is_a_start_by_the_command_line(
    four: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its weights in half precision, and no pictures."""
    export_agent(four, tmp_path / "agent")
    options = ["--config", str(DEBUG), "--set", "train.episodes=4", "--set", "env.num_workers=0"]
    run = tmp_path / "run"
    assert main(["train", *options, "--from", str(tmp_path / "agent"), "--out", str(run)]) == 0
    assert ", 0 pictures of goals" in capsys.readouterr().out
    assert load_agent(run).trained_episodes == 4


@pytest.mark.slow
def test_a_start_that_does_not_fit_writes_nothing(
    four: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--config", str(DEBUG), "--set", "model.hidden_dim=7", "--from", str(four)]
    assert main(["train", *options, "--out", str(tmp_path / "run")]) == 1
    assert "vhs: train.start_from: expected the network of" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
