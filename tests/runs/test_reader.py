"""Which directories a report takes for runs, and what it calls them."""

from pathlib import Path

from vhs.config import load_config
from vhs.report.runs import Run, find_runs, group_runs


def make_run(path: Path) -> None:
    path.mkdir(parents=True)
    (path / "log.jsonl").write_text('{"episodes": 500, "rate/success": 0.5}\n')


def test_runs_at_any_depth_are_found_in_order(tmp_path: Path) -> None:
    for name in ("sweep/b", "sweep/a", "single"):
        make_run(tmp_path / name)
    (tmp_path / "sweep" / "logs").mkdir()
    assert [run.name for run in find_runs(tmp_path)] == ["single", "sweep/a", "sweep/b"]


def test_links_are_followed_and_a_run_counts_once(tmp_path: Path) -> None:
    make_run(tmp_path / "disk" / "long")
    runs = tmp_path / "runs"
    make_run(runs / "here")
    (runs / "again").symlink_to(runs / "here")
    (runs / "there").symlink_to(tmp_path / "disk")
    (runs / "there" / "back").symlink_to(runs)
    assert [run.name for run in find_runs(runs)] == ["again", "there/long"]


def test_a_group_has_each_seed_once_and_runs_of_one_length() -> None:
    def run(name: str, *assignments: str) -> Run:
        return Run(Path(), name, load_config([], assignments), (), {}, ())

    runs = [run("a"), run("a-copy", "env.num_workers=0"), run("b", "seed=1"), run("long", "train.episodes=9")]
    groups = group_runs(runs)
    assert [(group.label, [run.name for run in group.runs]) for group in groups] == [
        ("VHS (a)", ["a", "b"]),
        ("VHS (a-copy)", ["a-copy"]),
        ("VHS, episodes=9", ["long"]),
    ]


def test_a_variant_is_called_so_on_a_task_where_it_is_alone() -> None:
    def run(*assignments: str) -> Run:
        return Run(Path(), " ".join(assignments), load_config([], assignments), (), {}, ())

    slow, fast = "method.name=gdan", "train.learning_rate=5e-4"
    groups = group_runs([run(slow), run(slow, fast), run(slow, fast, "task=task3"), run("task=task3")])
    assert [(group.task, group.label) for group in groups] == [
        ("Task 2", "GDAN"),
        ("Task 2", "GDAN, learning_rate=0.0005"),
        ("Task 3", "GDAN, learning_rate=0.0005"),
        ("Task 3", "VHS"),
    ]
