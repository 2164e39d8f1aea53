"""Configurations: overlays, overrides, and answers to every kind of mistake."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vhs import VhsError
from vhs.config import Config, dump_config, known_keys, load_config
from vhs.errors import ConfigError

CONFIGS = Path(__file__).parents[2] / "configs"


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


SWEEPS = set((CONFIGS / "sweeps").iterdir())  # files of another kind: tests/sweep


@pytest.mark.parametrize("path", sorted(set(CONFIGS.rglob("*.yaml")) - SWEEPS), ids=lambda path: path.name)
def test_every_shipped_file_is_valid(path: Path) -> None:
    load_config([path])


def test_later_overlays_win_and_set_comes_last(tmp_path: Path) -> None:
    first = write(tmp_path / "a.yaml", "task: task1\ntrain: {gamma: 0.9, episodes: 7}\n")
    second = write(tmp_path / "b.yaml", "train: {gamma: 0.8}\n")
    config = load_config(
        [first, second], ["train.learning_rate=1e-4", "method.relabel_on=[failure, timeout]"]
    )
    assert (config.task, config.train.gamma, config.train.episodes) == ("task1", 0.8, 7)
    assert config.train.learning_rate == 1e-4
    assert config.method.relabel_on == ("failure", "timeout")


def test_dump_and_load_are_inverse(tmp_path: Path) -> None:
    config = load_config([], ["seed=3", "env.room={stride_m: 0.3}", "model.channels=[1,2,3,4]"])
    assert load_config([write(tmp_path / "c.yaml", dump_config(config))]) == config


def test_the_paper_overlay_holds_the_papers_table() -> None:
    config = load_config([CONFIGS / "paper.yaml"])
    assert config.method.relabel_probability == 0.8
    assert config.method.prototype_samples == config.method.supcon_batch == 64
    assert (config.method.supcon_temperature, config.method.warmup, config.method.supcon_weight) == (
        0.07,
        150,
        0.5,
    )
    assert (config.train.gamma, config.train.learning_rate, config.train.max_grad_norm) == (0.99, 1e-4, 10.0)
    assert (config.train.entropy_weight, config.train.episodes_per_update, config.env.num_envs) == (
        0.01,
        1,
        5,
    )


def test_the_paper_overlay_switches_departures_of_the_method_off() -> None:
    method, train = load_config([CONFIGS / "paper.yaml"]).method, load_config([CONFIGS / "paper.yaml"]).train
    assert (method.hindsight_goal, method.hindsight_discount, method.value_target) == (
        "feature",
        1.0,
        "behaviour",
    )
    assert (train.return_lambda, train.value_weight) == (1.0, 0.5)
    assert train.learning_rate_end is train.entropy_weight_end is None
    assert load_config([CONFIGS / "paper.yaml"]).env.horizon_factor == 1


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("train.lerning_rate=1", r"unknown key `train.lerning_rate`; did you mean `train.learning_rate`\?"),
        ("learning_rate=1", r"unknown key `learning_rate`; did you mean `train.learning_rate`\?"),
        ("methd.warmup=1", r"unknown key `methd`; did you mean `method`\?"),
        ("zzzz=1", r"unknown key `zzzz`$"),
        ("train.gamma=high", r"train.gamma: expected number, found 'high'"),
        ("train.gamma=1.5", r"train.gamma: expected less than or equal to 1, found 1.5"),
        ("train.learning_rate=.nan", r"train.learning_rate: expected"),
        ("train.episodes=-1", r"train.episodes: expected greater than or equal to 1, found -1"),
        ("train.episodes=2.5", r"train.episodes: expected integer"),
        (
            "task=task4",
            r"task: expected 'task1', 'task2', 'task3', a file such as mine.py, or package.* found 'task4'",
        ),
        ("model.channels=[]", r"model.channels: .*at least 1"),
        ("method.warmup=100000", r"method.warmup: expected at most method.goal_capacity = 500, found 100000"),
        ("method.name=dqn", r"method.name: expected 'a3c', 'gdan', 'gcsl', 'pg' or 'vhs', found 'dqn'"),
        (
            "method.embedding=word",
            r"method.relabel_probability: expected 0 with method.embedding = word, .* found 0.8",
        ),
        ("method.prototype_momentum=1", r"method.prototype_momentum: expected less than 1, found 1"),
        ("train=3", r"train: .*found 3"),
        (
            "env.room={stride_m: 1, stride_m: 2}",
            r"--set env.room: expected a YAML value, found '{stride_m: 1",
        ),
        ("train.gamma", r"--set: expected key=value, found 'train.gamma'"),
        ("train.gamma=[", r"--set train.gamma: expected a YAML value"),
    ],
)
def test_a_wrong_assignment_says_what_was_expected_and_found(assignment: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_config([], [assignment])


def test_a_schedule_does_not_rise_unless_it_is_asked_to() -> None:
    train = load_config([], ["train.entropy_weight=0", "train.learning_rate=1e-5"]).train
    assert (train.entropy_weight_end, train.learning_rate_end) == (0, 1e-5)
    train = load_config([], ["train.entropy_weight=0", "train.entropy_weight_end=0.1"]).train
    assert (train.entropy_weight_end, train.learning_rate_end) == (0.1, 1.5e-4)
    assert load_config([], ["train.entropy_weight=0.5"]).train.entropy_weight_end == 0.001


def test_every_mistake_is_told_at_once() -> None:
    with pytest.raises(ConfigError) as caught:
        load_config([], ["train.gama=1", "seed=-4"])
    assert "train.gama" in str(caught.value)
    assert "seed" in str(caught.value)


def test_files_that_are_no_configuration(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot read the configuration"):
        load_config([tmp_path / "missing.yaml"])
    with pytest.raises(ConfigError, match="expected YAML"):
        load_config([write(tmp_path / "a.yaml", "a: [")])
    with pytest.raises(ConfigError, match="expected a mapping of sections, found list"):
        load_config([write(tmp_path / "b.yaml", "- 1")])
    assert load_config([write(tmp_path / "c.yaml", "# nothing yet\n")]) == Config()
    twice = "train: {gamma: 0.5}\ntask: task1\ntrain: {episodes: 8}\n"
    with pytest.raises(
        ConfigError, match=r"d\.yaml: expected YAML, found a second `train`\n.*line 3, column 1"
    ):
        load_config([write(tmp_path / "d.yaml", twice)])


def test_configuration_errors_are_vhs_errors_and_value_errors() -> None:
    assert issubclass(ConfigError, VhsError)
    assert issubclass(ConfigError, ValueError)


@given(st.sampled_from(sorted(key for key in known_keys() if "." in key)), st.data())
def test_a_key_with_one_letter_dropped_is_named(key: str, data: st.DataObject) -> None:
    section, _, name = key.rpartition(".")
    position = data.draw(st.integers(0, len(name) - 1))
    typo = f"{section}.{name[:position]}{name[position + 1 :]}"
    if typo in set(known_keys()) or typo.endswith("."):
        return
    with pytest.raises(ConfigError, match="did you mean"):
        load_config([], [f"{typo}=1"])
