"""Sweep files: what they ask for, by which names, and what they may not say."""

import re
import shlex
import textwrap
from pathlib import Path

import pytest

from vhs.cli import _parser, main
from vhs.config import load_config
from vhs.errors import ConfigError
from vhs.sweep.file import read_sweep
from vhs.sweep.plan import PlannedRun, plan_runs

SWEEPS = Path(__file__).parents[2] / "configs" / "sweeps"
METHODS = {"a3c", "gdan", "gcsl", "pg", "vhs"}


def plan(root: Path, text: str, cores_per_run: int = 1) -> list[PlannedRun]:
    (root / "base.yaml").write_text("task: task1\nenv: {num_envs: 4}\n")
    (root / "sweep.yaml").write_text(text)
    return plan_runs(root / "sweep.yaml", read_sweep(root / "sweep.yaml"), cores_per_run)


GRIDS = """
base: [base.yaml]
set: {train.episodes: 40}
seeds: [3, 5]
grids:
  - grid:
      method.relabel_probability: [0.4, 0.8]
      method.relabel_on: [null, [failure, timeout]]
  - set: {method.vhs_weight: 0.0}
    seeds: [3]
"""


def test_every_combination_runs_with_its_first_seed_first(tmp_path: Path) -> None:
    assert [run.name for run in plan(tmp_path, GRIDS)] == [
        "task1-vhs-relabel_probability=0.4-seed3",
        "task1-vhs-relabel_probability=0.4-relabel_on=failure+timeout-seed3",
        "task1-vhs-seed3",
        "task1-vhs-relabel_on=failure+timeout-seed3",
        "task1-vhs-vhs_weight=0.0-seed3",
        "task1-vhs-relabel_probability=0.4-seed5",
        "task1-vhs-relabel_probability=0.4-relabel_on=failure+timeout-seed5",
        "task1-vhs-seed5",
        "task1-vhs-relabel_on=failure+timeout-seed5",
    ]


def test_keys_of_the_command_line_go_over_those_of_the_file_and_under_those_of_a_grid(tmp_path: Path) -> None:
    plan(tmp_path, GRIDS)
    path = tmp_path / "sweep.yaml"
    changed = read_sweep(path, ["train.episodes=8", "method.vhs_weight=2", "train.gamma=0.9"])
    runs = {run.name: run.config for run in plan_runs(path, changed, 1)}
    assert {(config.train.episodes, config.train.gamma) for config in runs.values()} == {(8, 0.9)}
    assert runs["task1-vhs-seed3"].method.vhs_weight == 2
    assert runs["task1-vhs-vhs_weight=0.0-seed3"].method.vhs_weight == 0
    bare = tmp_path / "bare.yaml"
    bare.write_text("grids: [{}]")
    assert plan_runs(bare, read_sweep(bare, ["task=task3"]), 1)[0].config.task == "task3"


@pytest.mark.parametrize(
    ("assignment", "message"),
    [("seed=3", "seeds stand in `seeds`"), ("train.gamma", "--set: expected key=value"), ("=3", "--set")],
)
def test_keys_of_the_command_line_that_a_sweep_cannot_take(
    assignment: str, message: str, tmp_path: Path
) -> None:
    plan(tmp_path, GRIDS)
    with pytest.raises(ConfigError, match=message):
        read_sweep(tmp_path / "sweep.yaml", [assignment])


def test_the_command_of_a_run_makes_its_configuration(tmp_path: Path) -> None:
    for run in plan(tmp_path, GRIDS + "  - grid: {env.room: [{stride_m: 1.0e-05}], task: [task3]}\n"):
        options = _parser().parse_args(["train", *run.arguments])
        assert load_config(options.config, options.set) == run.config
    assert run.config.env.room == {"stride_m": 1e-05}
    assert run.config.task == "task3"


def test_what_a_grid_sets_inside_the_room_stays_in_its_runs(tmp_path: Path) -> None:
    (tmp_path / "rooms.yaml").write_text("env: {room: {horizon_steps: 40}}\n")
    runs = plan(
        tmp_path,
        """base: [rooms.yaml]
grids: [{grid: {env.room.horizon_steps: [30]}}, {grid: {method.name: [pg]}}]""",
    )
    assert [run.config.env.room for run in runs] == [{"horizon_steps": 30}, {"horizon_steps": 40}]


def test_a_configuration_that_two_grids_ask_for_is_one_run(tmp_path: Path) -> None:
    text = "grids: [{grid: {method.relabel_probability: [0.4, 0.8]}}, {grid: {method.vhs_weight: [0.5, 1]}}]"
    assert [run.name for run in plan(tmp_path, text)] == [
        "task2-vhs-relabel_probability=0.4-seed0",
        "task2-vhs-seed0",
        "task2-vhs-vhs_weight=0.5-seed0",
    ]


def test_a_run_is_named_by_what_its_grid_changes_and_not_by_the_defaults_of_its_method(
    tmp_path: Path,
) -> None:
    text = """
        set: {method.relabel_probability: 0}
        grids:
          - grid: {method.name: [vhs, gdan]}
          - set: {method.relabel_probability: 0.8}
            grid: {method.name: [gcsl]}
          - set: {train.learning_rate: 0.0005}
            grid: {method.name: [vhs, gdan]}
    """
    assert [run.name for run in plan(tmp_path, textwrap.dedent(text))] == [
        "task2-vhs-seed0",
        "task2-gdan-seed0",
        "task2-gcsl-relabel_probability=0.8-seed0",
        "task2-gdan-learning_rate=0.0005-seed0",
    ]


def test_what_a_sweep_sets_for_all_runs_reaches_the_methods_that_read_it(tmp_path: Path) -> None:
    text = "set: {method.relabel_probability: 0.4}\ngrids: [{grid: {method.name: [vhs, a3c]}}]"
    vhs, a3c = plan(tmp_path, text)
    assert vhs.config.method.relabel_probability == 0.4
    for run, is_set in ((vhs, True), (a3c, False)):
        assert ("method.relabel_probability=0.4" in run.arguments) == is_set
        assert load_config([], run.arguments[1::2]) == run.config
    with pytest.raises(ConfigError, match=r"grids\.0: method\.vhs_weight: expected none for .* a3c"):
        plan(tmp_path, "grids: [{grid: {method.name: [vhs, a3c], method.vhs_weight: [0.5]}}]")


@pytest.mark.parametrize(
    ("text", "names"),
    [
        (
            "set: {env.min_ready: 20}\ngrids: [{grid: {env.num_envs: [20, 24]}}]",
            ["task2-vhs-num_envs=20-seed0", "task2-vhs-num_envs=24-seed0"],
        ),
        (
            "set: {method.embedding: word}\ngrids: [{grid: {method.name: [pg]}}]",
            ["task2-pg-seed0"],
        ),
        (
            "set: {method.warmup: 600}\ngrids: [{grid: {method.goal_capacity: [1000, 2000]}}]",
            ["task2-vhs-goal_capacity=1000-seed0", "task2-vhs-goal_capacity=2000-seed0"],
        ),
        (
            "set: {env.min_ready: 20, train.gamma: 0.9}\ngrids: [{grid: {env.num_envs: [20]}},"
            " {grid: {env.num_envs: [20], train.gamma: [0.9]}}]",
            ["task2-vhs-num_envs=20-seed0"],
        ),
    ],
)
def test_keys_that_make_a_configuration_with_a_grid_alone_are_taken(
    text: str, names: list[str], tmp_path: Path
) -> None:
    assert [run.name for run in plan(tmp_path, text)] == names


@pytest.mark.parametrize(("cores", "workers"), [(1, 0), (2, 1), (3, 2), (4, 2), (5, 4), (9, 4)])
def test_a_run_has_no_more_processes_than_cores(cores: int, workers: int, tmp_path: Path) -> None:
    (run,) = plan(tmp_path, "base: [base.yaml]\ngrids: [{}]", cores)
    assert run.config.env.num_workers == workers
    assert 1 + workers <= cores
    assert run.config.train.threads == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("grid: []\ngrids: [{}]", r"unknown key `grid`; did you mean `grids`\?"),
        ("grids: [{gird: {}}]", r"unknown key `grids\.0\.gird`; did you mean `grids\.grid`\?"),
        ("seeds: [0]", "grids: expected .*, found"),
        ("seeds: []\ngrids: [{}]", "seeds: .* at least 1 item"),
        ("seeds: [1, 1]\ngrids: [{}]", r"expected each seed once, found \[1, 1\]"),
        ("grids: [{grid: {task: []}}]", r"grids\.0\.grid\.task: .* at least 1 item"),
        ("grids: [{grid: {task: task1}}]", r"grids\.0\.grid\.task: expected list, found 'task1'"),
        ("grids: [{grid: {seed: [1]}}]", "seed: expected another key, seeds stand in `seeds`"),
        ("set: {train.threads: 2}\ngrids: [{}]", "train.threads: expected another key"),
        (
            "grids: [{grid: {method.relabel_probabilty: [1]}}]",
            r"grids\.0: unknown key .* did you mean `method\.",
        ),
        ("grids: [{}, {set: {train.gamma: 2}}]", r"grids\.1: train\.gamma: expected .*, found 2"),
        ("base: [none.yaml]\ngrids: [{}]", r"none\.yaml: cannot read the configuration"),
        ("[]", "expected a mapping"),
        ("grids: [", "expected YAML"),
        ("seeds: [0]\ngrids: [{}]\nseeds: [1]", "expected YAML, found a second `seeds`"),
    ],
)
def test_a_wrong_sweep_file_is_explained(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        plan(tmp_path, text)
    assert re.match(rf"{re.escape(str(tmp_path))}/(sweep|none)\.yaml: ", str(caught.value))


@pytest.mark.parametrize(("name", "count"), [("paper", 63), ("quick", 9)])
def test_the_sweeps_that_we_ship_plan_their_runs(name: str, count: int) -> None:
    path = SWEEPS / f"{name}.yaml"
    runs = plan_runs(path, read_sweep(path), 1)
    assert len(runs) == count
    assert {run.config.method.name for run in runs} == METHODS


def test_a_sweep_is_listed_as_lines_for_a_shell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "sweep.yaml"
    path.write_text(
        "seeds: [0, 1]\neval: {episodes: 7, seed: 9, greedy: true}\n"
        "grids: [{grid: {method.relabel_on: [[timeout], [failure, timeout]]}}]"
    )
    assert main(["sweep", str(path), "--out", str(tmp_path / "a b"), "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert not (tmp_path / "a b").exists()
    for line, run in zip(lines, plan_runs(path, read_sweep(path), 1), strict=True):
        directory = str(tmp_path / "a b" / run.name)
        words = shlex.split(line)
        split = words.index("&&")
        assert words[:split] == ["vhs", "train", *run.arguments, "--out", directory]
        last = ["--episodes", "7", "--seed", "9", "--greedy"]
        assert words[split + 1 :] == ["vhs", "eval", directory, *last]
