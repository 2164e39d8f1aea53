"""Training, resuming and showing on goals and actions of every kind, and with networks of one's own."""

import sys
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from reach import reach_task
from torch import Tensor, nn
from toy import Toy, toy_config, toy_task

import vhs
from vhs import ArgumentError, Outcome, Task
from vhs.acting.policy import load_agent
from vhs.acting.setup import make_env
from vhs.acting.trial import try_task
from vhs.config import Config
from vhs.errors import ConfigError
from vhs.eval import evaluate
from vhs.runs.directory import read_config
from vhs.runs.rows import read_log
from vhs.show.moments import play_moments
from vhs.task import Instruction
from vhs.train import train
from vhs.train.export import export_agent

pytestmark = pytest.mark.slow

SETTINGS = (
    "train.log_every=24",
    "env.num_envs=4",
    "env.num_workers=0",
    "method.warmup=2",
    "method.relabel_probability=1",
)
ACTIONS = {
    "numbered": spaces.Discrete(4),
    "choices": spaces.MultiDiscrete([3, 3], start=[1, -1]),
    "continuous": spaces.Box(np.array([-2.0, 0.0], np.float32), np.array([2.0, 1.0], np.float32)),
}


def configured(*overrides: str, method: str = "vhs") -> Config:
    return toy_config(method, *SETTINGS, *overrides)


def weights(run: Path, task: Task) -> dict[str, Tensor]:
    return load_agent(run, task).agent.state_dict()


def assert_same(ours: dict[str, Tensor], theirs: dict[str, Tensor]) -> None:
    assert ours.keys() == theirs.keys()
    for name, value in ours.items():
        assert torch.equal(value, theirs[name]), name


@pytest.mark.parametrize("actions", ACTIONS)
@pytest.mark.parametrize("goals", ["picture", "vector", "state"])
def test_a_stopped_run_goes_on_as_if_nothing_had_happened(goals: str, actions: str, tmp_path: Path) -> None:
    task = reach_task(goals, ACTIONS[actions])
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    train(configured("train.episodes=48"), whole, StringIO(), task=task)
    for episodes in (20, 48):
        train(configured(f"train.episodes={episodes}"), parts, StringIO(), task=task)
    assert_same(weights(whole, task), weights(parts, task))
    last = read_log(whole)[-1]
    assert "loss/supcon" not in last, "without classes there is nothing to tell apart"
    assert last["loss/relabelled"] == pytest.approx(1 - last["rate/success"], abs=0.2), (
        "timeouts are relabelled"
    )
    assert read_config(whole).method.relabel_on == ("failure", "timeout")
    result = evaluate(whole, episodes=8, task=task)
    assert result.success + result.failure + result.timeout == pytest.approx(1)
    policy = load_agent(whole, task)
    shown = list(play_moments(policy, make_env(task, policy.spec), [0], 0, greedy=True))
    assert 2 <= len(shown) <= 9


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="worker processes need Linux")
@pytest.mark.parametrize(("goals", "actions"), [("picture", "choices"), ("vector", "continuous")])
def test_workers_play_the_same_episodes(goals: str, actions: str, tmp_path: Path) -> None:
    task = reach_task(goals, ACTIONS[actions])
    for workers in (0, 1):
        config = configured("train.episodes=24", f"env.num_workers={workers}")
        train(config, tmp_path / str(workers), StringIO(), task=task)
    assert_same(weights(tmp_path / "0", task), weights(tmp_path / "1", task))


@pytest.mark.parametrize("method", ["a3c", "pg", "gcsl"])
def test_other_methods_take_pictures_and_vectors(method: str, tmp_path: Path) -> None:
    for goals in ("picture", "vector"):
        task = reach_task(goals, ACTIONS["continuous"])
        run = tmp_path / goals
        overrides = [text for text in SETTINGS if method == "gcsl" or not text.startswith("method.")]
        assert train(toy_config(method, *overrides, "train.episodes=24"), run, StringIO(), task=task)


def test_pictures_with_classes_beside_them_have_supcon(tmp_path: Path) -> None:
    def told_by_picture(observation: dict[str, Any]) -> Any:
        seen = Instruction(interaction="interaction")(observation)
        picture = np.full_like(seen.frame, 40)
        picture[5:11, 7:10, seen.label] = 255
        return Instruction("image", lambda _: picture)(observation | {"goal": 0}).__class__(
            seen.frame, seen.label, seen.interaction, desired_goal=picture
        )

    task = Task(
        name="toy", make=Toy, max_steps=6, read=told_by_picture, interactions={3: 0, 4: 1}, limit_ends=True
    )
    assert (task.spec().goals, task.spec().num_goals) == ("observations", 3)
    assert train(configured("train.episodes=96"), tmp_path, StringIO(), task=task)
    last = read_log(tmp_path)[-1]
    assert last["loss/supcon"] > 0
    assert last["goals/0"] + last["goals/1"] + last["goals/2"] > 0


def test_a_limit_that_ends_the_task_is_no_cut(tmp_path: Path) -> None:
    ends = []
    for limit_ends in (False, True):
        task = Task(name="toy", make=Toy, max_steps=6, interactions={3: 0, 4: 1}, limit_ends=limit_ends)
        env = make_env(task, task.spec())
        env.reset(seed=0)
        *_, terminated, truncated, info = [env.step(0) for _ in range(6)][-1]
        assert info["outcome"] == Outcome.TIMEOUT
        ends.append((terminated, truncated))
        train(configured("train.episodes=24"), tmp_path / str(limit_ends), StringIO(), task=task)
    assert ends == [(False, True), (True, False)]
    ours, theirs = (weights(tmp_path / str(one), task) for one in (False, True))
    assert not torch.equal(ours["value.2.weight"], theirs["value.2.weight"]), "the critic is asked at a cut"


def flat(observation_shape: tuple[int, ...], feature_dim: int) -> nn.Module:
    """The simplest extractor of one's own."""

    class Flat(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.layer = nn.Linear(int(np.prod(observation_shape)), feature_dim)

        def forward(self, observations: Tensor) -> Tensor:
            return self.layer(observations.flatten(1).float() / 255)

    return Flat()


def three_numbers(observation_shape: tuple[int, ...], feature_dim: int) -> nn.Module:
    return flat(observation_shape, 3)


def no_module(observation_shape: tuple[int, ...], feature_dim: int) -> Any:
    return 3


def test_an_extractor_of_ones_own_by_name_and_as_an_object(tmp_path: Path) -> None:
    task = toy_task()
    named = configured("train.episodes=24", f"model.extractor={__name__}:flat")
    train(named, tmp_path / "named", StringIO(), task=task)
    vhs.train(
        task, configured("train.episodes=24"), out=tmp_path / "given", stream=StringIO(), extractor=flat
    )
    ours = weights(tmp_path / "named", task)
    assert_same(ours, load_agent(tmp_path / "given", task, flat).agent.state_dict())
    assert ours["extractor.network.layer.weight"].shape == (16, 16 * 16 * 6)


def test_an_exported_agent_runs_no_code_that_it_names_itself(tmp_path: Path) -> None:
    """It may be a stranger's; whoever loads it says which code it may run."""
    task, name = toy_task(), f"{__name__}:flat"
    train(configured("train.episodes=24", f"model.extractor={name}"), tmp_path / "run", StringIO(), task=task)
    trained = export_agent(tmp_path / "run", tmp_path / "agent", task)
    with pytest.raises(ConfigError, match=f"expected no code of its own, found model.extractor = {name}"):
        load_agent(tmp_path / "agent", task)
    again = load_agent(tmp_path / "agent", task, flat).agent.state_dict()
    for key, value in trained.agent.state_dict().items():
        expected = value.half().float() if value.is_floating_point() else value
        assert torch.equal(again[key], expected), key


def test_an_extractor_of_ones_own_takes_frames_that_no_other_takes(tmp_path: Path) -> None:
    task = with_frames(lambda frame: frame.astype(np.float32) / 255)
    config = toy_config("a3c", "train.episodes=24")
    assert train(config, tmp_path, StringIO(), task=task, extractor=flat)
    assert load_agent(tmp_path, task, flat).trained_episodes == 24


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nowhere_to_be_found:flat", "expected module:factory, found 'nowhere_to_be_found:flat': No module"),
        (f"{__name__}:round", "expected module:factory, found .* has no attribute 'round'"),
        ("flat", "expected module:factory, found 'flat'"),
        (f"{__name__}:SETTINGS", "expected a factory, found"),
        (f"{__name__}:three_numbers", r"module of features \[N, 16\] from uint8 \[N, 16, 16, 6\], found "),
        (f"{__name__}:no_module", "expected a torch.nn.Module, found int"),
    ],
)
def test_an_extractor_that_does_not_fit_is_refused_before_anything_is_written(
    name: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=f"model.extractor: .*{message}"):
        train(configured(f"model.extractor={name}"), tmp_path / "run", StringIO(), task=toy_task())
    assert not (tmp_path / "run").exists()


def with_frames(change: Any) -> Task:
    """The toy, its pictures changed."""
    plain = Instruction(interaction="interaction")

    def read(observation: dict[str, Any]) -> Any:
        seen = plain(observation)
        return type(seen)(change(seen.frame), seen.label, seen.interaction)

    return Task(name="toy", make=Toy, max_steps=6, read=read, interactions={3: 0, 4: 1})


@pytest.mark.parametrize(
    ("task", "method", "message"),
    [
        (
            with_frames(lambda frame: frame.astype(np.float32)),
            "vhs",
            r"frames uint8 \[height, width, channels\] or vectors \[numbers\], found float32 \[16, 16, 3\]",
        ),
        (
            with_frames(lambda frame: frame.reshape(-1)[:9].astype(np.float32)),
            "vhs",
            "frames uint8, of which images of reached goals are kept for supcon, prototype, found float",
        ),
        (
            reach_task("vector"),
            "gdan",
            "method.name: expected one without a goal-discriminator, as task reach",
        ),
    ],
)
def test_what_no_network_takes_is_refused_before_anything_is_written(
    task: Task, method: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=message):
        train(toy_config(method), tmp_path / "run", StringIO(), task=task)
    assert not (tmp_path / "run").exists()


def test_words_name_classes_to_who_sees_a_vector(tmp_path: Path) -> None:
    task = with_frames(lambda frame: frame[8, :, :].reshape(-1).astype(np.float32))
    assert train(toy_config("a3c", "train.episodes=24"), tmp_path, StringIO(), task=task)
    assert evaluate(tmp_path, episodes=4, task=task).steps > 0


class Compassed(gymnasium.Env[Any, Any]):
    """The right one of two presses is told by a number beside a grey picture, and by nothing else."""

    observation_space = spaces.Dict(
        {
            "image": spaces.Box(0, 255, (16, 16, 3), np.uint8),
            "goal": spaces.Discrete(1),
            "compass": spaces.Box(-1, 1, (2,), np.float32),
            "level": spaces.Discrete(3),
        }
    )
    action_space = spaces.Discrete(2)

    def reset(self, *, seed: int | None = None, options: object = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.side = int(self.np_random.integers(2))
        return self.seen(), {}

    def seen(self) -> dict[str, Any]:
        compass = np.array([2 * self.side - 1, 0], np.float32)
        return {
            "image": np.full((16, 16, 3), 90, np.uint8),
            "goal": 0,
            "compass": compass,
            "level": np.int64(1),
        }

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        is_right = action == self.side
        return self.seen(), 10.0 if is_right else -1.0, True, False, {}


def compass_task(**fields: Any) -> Task:
    read = Instruction(fields=("compass", "level"))
    return Task(name="compassed", make=Compassed, max_steps=2, **({"read": read} | fields))


def test_a_vector_beside_the_picture_is_learned_from(tmp_path: Path) -> None:
    task = compass_task()
    # Without hindsight: what the wrong press reached is the same goal.
    overrides = [text for text in SETTINGS if not text.startswith("method.")]
    overrides += ["train.episodes=2000", "train.entropy_weight=0.001", "train.learning_rate=2e-3"]
    train(toy_config("a3c", *overrides), tmp_path, StringIO(), task=task)
    assert evaluate(tmp_path, episodes=50, task=task, greedy=True).success == 1


def test_workers_send_a_vector_beside_the_picture(tmp_path: Path) -> None:
    task = compass_task()
    for workers in (0, 1):
        config = configured("train.episodes=24", f"env.num_workers={workers}")
        train(config, tmp_path / str(workers), StringIO(), task=task)
    assert_same(weights(tmp_path / "0", task), weights(tmp_path / "1", task))


def test_a_run_with_a_vector_beside_the_picture_goes_on_and_is_exported(tmp_path: Path) -> None:
    task = compass_task()
    for name, stops in (("whole", (48,)), ("parts", (20, 48))):
        for episodes in stops:
            train(configured(f"train.episodes={episodes}"), tmp_path / name, StringIO(), task=task)
    assert_same(weights(tmp_path / "whole", task), weights(tmp_path / "parts", task))
    export_agent(tmp_path / "whole", tmp_path / "agent", task)
    assert evaluate(tmp_path / "agent", episodes=4, task=task).episodes == 4
    policy = load_agent(tmp_path / "agent", task)
    assert policy.spec.fields.keys() == {"compass", "level"}
    assert len(list(play_moments(policy, make_env(task, policy.spec), [0], 0, greedy=True))) == 2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda fields: fields | {"compass": np.zeros(3, np.float32)},
            r"field `compass` \[2\] as the first, got \[3\]",
        ),
        (
            lambda fields: {"compass": fields["compass"]},
            "the fields compass, level as the first time, got compass",
        ),
        (
            lambda fields: fields | {"compass": np.array([0, np.nan], np.float32)},
            r"finite numbers in field `compass`, got nan at \[1\]",
        ),
    ],
)
def test_a_vector_that_cannot_be_read_is_named(change: Any, words: str) -> None:
    first = []

    def read(observation: dict[str, Any]) -> vhs.Seen:
        seen = Instruction(fields=("compass", "level"))(observation)
        first.append(1)
        return seen if len(first) <= 2 else replace(seen, fields=change(seen.fields))

    with pytest.raises(ArgumentError, match=f"`read`: expected .*{words}"):
        try_task(compass_task(read=read))


@pytest.mark.parametrize(("goals", "entry"), [("state", "frame"), ("vector", "desired_goal")])
def test_what_is_no_number_is_named(goals: str, entry: str) -> None:
    task, first = reach_task(goals, ACTIONS["numbered"]), []
    assert task.read is not None

    def read(observation: dict[str, Any]) -> vhs.Seen:
        seen = task.read(observation)
        first.append(1)
        array = np.full_like(getattr(seen, entry), np.inf)
        return seen if len(first) <= 2 else replace(seen, **{entry: array})

    with pytest.raises(ArgumentError, match=r"`read`: expected finite numbers in .*, got inf at"):
        try_task(replace(task, read=read))


def test_a_reward_that_is_no_number_is_named() -> None:
    task = toy_task()

    class Unpaid(gymnasium.RewardWrapper[Any, Any]):
        def reward(self, reward: Any) -> float:
            return float("nan")

    with pytest.raises(ArgumentError, match=f"{task.name}: expected a finite reward, got nan"):
        try_task(replace(task, make=lambda: Unpaid(task.make())))
