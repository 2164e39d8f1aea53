"""The one reader of runs: which directories it takes, strict or lenient, and how runs are grouped."""

from pathlib import Path

import pytest

from vhs.config import load_config
from vhs.errors import CheckpointError, ComparisonError
from vhs.report.names import group_title
from vhs.runs.reader import Run, find_runs, group_runs, read_run


def make_run(path: Path) -> None:
    path.mkdir(parents=True)
    (path / "log.jsonl").write_text('{"episodes": 500, "rate/success": 0.5}\n')


def test_runs_at_any_depth_are_found_in_order(tmp_path: Path) -> None:
    for name in ("sweep/b", "sweep/a", "single"):
        make_run(tmp_path / name)
    (tmp_path / "sweep" / "logs").mkdir()
    assert list(find_runs([tmp_path]).values()) == ["single", "sweep/a", "sweep/b"]


def test_links_are_followed_and_a_run_counts_once(tmp_path: Path) -> None:
    make_run(tmp_path / "disk" / "long")
    runs = tmp_path / "runs"
    make_run(runs / "here")
    (runs / "again").symlink_to(runs / "here")
    (runs / "there").symlink_to(tmp_path / "disk")
    (runs / "there" / "back").symlink_to(runs)
    assert list(find_runs([runs]).values()) == ["again", "there/long"]


def test_a_group_has_each_seed_once_and_runs_of_one_length() -> None:
    def run(name: str, *assignments: str) -> Run:
        return Run(Path(), name, load_config([], assignments))

    runs = [run("a"), run("a-copy", "env.num_workers=0"), run("b", "seed=1"), run("long", "train.episodes=9")]
    groups = group_runs(runs, strict=False)
    assert [(str(group.label), [run.name for run in group.runs]) for group in groups] == [
        ("vhs (a)", ["a", "b"]),
        ("vhs (a-copy)", ["a-copy"]),
        ("vhs episodes=9", ["long"]),
    ]
    with pytest.raises(ComparisonError, match="expected one run a seed, found two of seed 0"):
        group_runs(runs)


def test_a_variant_is_called_so_on_a_task_where_it_is_alone() -> None:
    def run(*assignments: str) -> Run:
        return Run(Path(), " ".join(assignments), load_config([], assignments))

    slow, fast = "method.name=gdan", "train.learning_rate=5e-4"
    groups = group_runs([run(slow), run(slow, fast), run(slow, fast, "task=task3"), run("task=task3")])
    assert [(group.task, str(group.label)) for group in groups] == [
        ("task2", "gdan"),
        ("task2", "gdan learning_rate=0.0005"),
        ("task3", "gdan learning_rate=0.0005"),
        ("task3", "vhs"),
    ]
    assert group_title(groups[1]) == "GDAN, learning_rate=0.0005"


def damage(run: Path) -> None:
    run.mkdir()
    (run / "config.yaml").write_text("seed: 3\n")
    rows = ['{"episodes": 4, "rate/success": 0.5}', "{", '{"episodes": 2, "rate/success": 0.5}']
    (run / "log.jsonl").write_text("\n".join([*rows, '{"episodes": 8, "rate/success": 1.0}']) + "\n")
    (run / "eval.json").write_text("{}")


def test_the_lenient_reader_notes_what_is_damaged_and_keeps_the_rest(tmp_path: Path) -> None:
    damage(tmp_path / "run")
    run = read_run(tmp_path / "run", strict=False)
    assert (run.name, run.config.seed, run.evaluations) == ("run", 3, [])
    assert [row["episodes"] for row in run.rows] == [4, 8]
    told = "\n".join(run.notes)
    for part in (
        "log.jsonl:2: damaged",
        "log.jsonl:3: damaged line: expected more than 4",
        "no run.json",
        "eval.json",
        "no checkpoint",
    ):
        assert part in told


def test_the_strict_reader_raises_the_first_damage(tmp_path: Path) -> None:
    damage(tmp_path / "run")
    with pytest.raises(CheckpointError, match=r"log\.jsonl:2: damaged line"):
        read_run(tmp_path / "run")


def test_a_run_without_configuration_is_a_note_or_an_error(tmp_path: Path) -> None:
    make_run(tmp_path / "run")
    with pytest.raises(CheckpointError, match=r"found no config\.yaml"):
        read_run(tmp_path / "run")
    run = read_run(tmp_path / "run", strict=False)
    with pytest.raises(CheckpointError, match=r"expected a readable config\.yaml"):
        run.config  # noqa: B018
    (group,) = group_runs([run], strict=False)
    assert (str(group.label), group.task, group_title(group)) == ("run", None, "run")
