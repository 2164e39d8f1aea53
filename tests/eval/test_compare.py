"""Comparisons of runs written by hand: groups, protocol, rate, reference, and what cannot be compared."""

import csv
import io
import json
from pathlib import Path

import pytest
from hand_made_runs import evaluation, make_run

from vhs.cli import main
from vhs.errors import CheckpointError, ComparisonError
from vhs.eval.compare import Comparison, compare
from vhs.eval.tables import as_csv, as_json, as_markdown

WEAK = "method.relabel_probability=0.4"


def two_groups(root: Path) -> Comparison:
    """Three seeds that reach 74.3 % at 2,000, 4,000 and 6,000 episodes; two of another group at 8,000."""
    for seed, successes in enumerate([(0.8, 0.9, 0.9, 0.9), (0.5, 0.8, 0.9, 0.9), (0.1, 0.5, 0.8, 0.9)]):
        done = [evaluation(success=0.8 + 0.1 * seed, spl=0.5, trained_episodes=8_000)]
        make_run(root / f"strong-{seed}", f"seed={seed}", successes=successes, evaluations=done)
    for seed in (0, 1):
        done = [evaluation(success=0.7, trained_episodes=8_000)]
        run = root / f"weak-{seed}"
        make_run(run, f"seed={seed}", WEAK, successes=(0.1, 0.2, 0.3, 0.8), evaluations=done)
    return compare([root], reference=str(root / "weak-1"))


@pytest.mark.slow
def test_runs_that_differ_by_seed_alone_are_one_group(tmp_path: Path) -> None:
    strong, weak = two_groups(tmp_path).groups
    assert (str(strong.label), str(weak.label)) == ("vhs", "vhs relabel_probability=0.4")
    assert [result.run.config.seed for result in strong.runs] == [0, 1, 2]
    assert strong.success == (pytest.approx(0.9), pytest.approx(0.1))
    assert strong.success_iqm == pytest.approx(0.9)
    assert strong.success_interval is not None
    assert strong.success_interval[0] < 0.9 < strong.success_interval[1]


def test_what_changes_no_learning_does_not_split_a_group(tmp_path: Path) -> None:
    make_run(tmp_path / "a", "seed=0", "env.num_workers=0")
    make_run(tmp_path / "b", "seed=1", "env.num_workers=1", "train.log_every=7")
    comparison = compare([tmp_path])
    assert [len(group.runs) for group in comparison.groups] == [2]
    assert any("their minutes do not compare" in note for note in comparison.notes)


def test_cost_of_the_rate_by_hand(tmp_path: Path) -> None:
    comparison = two_groups(tmp_path)
    strong, weak = comparison.groups
    assert comparison.reference == weak.label
    assert strong.episodes_to_rate == (4_000, 2_000)
    assert strong.minutes_to_rate == (20, 10)
    assert weak.episodes_to_rate == (8_000, 0)
    assert (strong.srr, strong.sei) == (0.5, 1.0)
    assert (weak.srr, weak.sei) == (1.0, 0.0)


def test_a_group_has_reached_the_rate_when_every_seed_has(tmp_path: Path) -> None:
    make_run(tmp_path / "a", "seed=0", successes=(0.5, 0.9))
    make_run(tmp_path / "b", "seed=1", successes=(0.5, 0.6))
    comparison = compare([tmp_path])
    (group,) = comparison.groups
    assert group.seeds_reached == 1
    assert group.episodes_to_rate is None
    assert (group.srr, group.sei) == (None, None)
    assert any("did not reach the rate with every seed" in note for note in comparison.notes)
    assert "not reached (1 of 2 seeds did)" in as_markdown(comparison)


def test_one_seed_has_no_interval_and_the_table_says_so(tmp_path: Path) -> None:
    comparison = compare([make_run(tmp_path / "a")])
    assert comparison.groups[0].success == (0.9, None)
    assert comparison.groups[0].success_interval is None
    text = as_markdown(comparison)
    assert "`vhs` has one seed: no deviation and no interval." in text
    assert "±" not in text.splitlines()[4]


def test_the_longest_sampled_evaluation_that_all_share_counts(tmp_path: Path) -> None:
    shared = [
        evaluation(seed=0, success=0.6),
        evaluation(seed=1, success=0.9, episodes=600),
        evaluation(seed=0, success=0.1, episodes=10),
        evaluation(seed=0, success=0.1, greedy=True),
        evaluation(seed=0, success=0.1, trained_episodes=3_000),
    ]
    make_run(tmp_path / "a", "seed=0", evaluations=shared)
    make_run(tmp_path / "b", "seed=1", evaluations=[*shared, evaluation(seed=2, success=0.1)])
    comparison = compare([tmp_path])
    # (300 * 0.6 + 600 * 0.9) / 900
    assert [result.success for result in comparison.groups[0].runs] == pytest.approx([0.8, 0.8])
    assert comparison.protocol.sets == ((0, 300), (1, 600))
    assert not comparison.protocol.greedy


def test_an_old_evaluation_and_a_stopped_run_are_pointed_out(tmp_path: Path) -> None:
    run = make_run(tmp_path / "a", "train.episodes=9000", evaluations=[evaluation(trained_episodes=2_000)])
    assert [note for note in compare([run]).notes if str(run) in note] == [
        f"`{run}` was evaluated after 2,000 of 9,000 episodes.",
        f"`{run}` has gone on to 4,000 episodes since its evaluation.",
    ]


def test_runs_of_different_tasks_are_refused(tmp_path: Path) -> None:
    make_run(tmp_path / "a", "task=task1")
    make_run(tmp_path / "b", "task=task2")
    with pytest.raises(
        ComparisonError, match=r"expected runs of one task, found 2(.|\n)*task1: .*a\n *task2: .*b"
    ):
        compare([tmp_path])


def test_every_run_without_an_evaluation_is_named(tmp_path: Path) -> None:
    make_run(tmp_path / "a", "seed=0", evaluations=[])
    make_run(tmp_path / "b", "seed=1")
    (make_run(tmp_path / "c", "seed=2") / "eval.json").unlink()
    with pytest.raises(ComparisonError, match=r"none in 2; first run:\n  vhs eval .*a\n  vhs eval .*c$"):
        compare([tmp_path])


def test_runs_evaluated_on_other_episodes_are_refused(tmp_path: Path) -> None:
    make_run(tmp_path / "a", "seed=0")
    make_run(tmp_path / "b", "seed=1", evaluations=[evaluation(seed=5, greedy=True)])
    with pytest.raises(
        ComparisonError, match=r"no common evaluation:\n.*a: .*seed 0\n.*b: .*seed 5 --greedy"
    ):
        compare([tmp_path])


def test_the_same_seed_twice_is_refused(tmp_path: Path) -> None:
    make_run(tmp_path / "a")
    make_run(tmp_path / "b")
    with pytest.raises(ComparisonError, match=r"two of seed 0 and one configuration: .*a and .*b"):
        compare([tmp_path])


def test_a_run_given_twice_counts_once(tmp_path: Path) -> None:
    run = make_run(tmp_path / "a")
    assert len(compare([run, tmp_path, run / ".." / "a"]).groups[0].runs) == 1


def test_a_directory_without_runs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"expected config\.yaml or log\.jsonl in it or below, found"):
        compare([tmp_path])


def test_an_unknown_reference_lists_the_groups(tmp_path: Path) -> None:
    run = make_run(tmp_path / "a")
    with pytest.raises(ComparisonError, match=r"the groups `vhs`, found 'gdan'"):
        compare([run], reference="gdan")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('{"episodes": 4000, "rate/succ', "expected a JSON object"),
        ('{"episodes": 4000, "time/minutes": 1.0}', "expected a share as `rate/success`, found None"),
        (
            '{"episodes": 1, "rate/success": 0.5, "time/minutes": 1.0}',
            "expected more than 2000 episodes, found 1",
        ),
        ('{"episodes": 4000, "rate/success": 0.5}', "expected a number as `time/minutes`, found None"),
    ],
)
def test_a_damaged_line_of_a_log_is_named(line: str, message: str, tmp_path: Path) -> None:
    run = make_run(tmp_path / "a")
    first = (run / "log.jsonl").read_text().splitlines()[0]
    (run / "log.jsonl").write_text(f"{first}\n{line}\n")
    with pytest.raises(CheckpointError, match=rf"a/log\.jsonl:2: damaged line: {message}"):
        compare([run])


def test_a_run_without_a_log_is_named(tmp_path: Path) -> None:
    run = make_run(tmp_path / "a")
    (run / "log.jsonl").unlink()
    with pytest.raises(CheckpointError, match=r"a/log\.jsonl: expected a row"):
        compare([run])


def test_the_three_files_say_the_same(tmp_path: Path) -> None:
    comparison = two_groups(tmp_path)
    written = json.loads(json.dumps(as_json(comparison)))
    rows = list(csv.DictReader(io.StringIO(as_csv(comparison))))
    assert [row["group"] for row in rows] == [group["group"] for group in written["groups"]]
    assert [float(row["srr"]) for row in rows] == [group["srr"] for group in written["groups"]] == [0.5, 1.0]
    assert written["groups"][0]["runs"][1]["episodes_to_rate"] == 4_000
    assert written["groups"][0]["runs"][1]["made_by"]["commit"] == "abc"
    row = next(line for line in as_markdown(comparison).splitlines() if line.startswith("| vhs  "))
    for cell in ("90.0% ± 10.0%", "0.500 ± 0.000", "4,000 ± 2,000", "20.0 ± 10.0", "50.0%", "100.0%"):
        assert cell in row


def test_the_command_prints_and_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, out = make_run(tmp_path / "a"), tmp_path / "out"
    assert main(["compare", str(run), "--rate", "0.6", "--out", str(out)]) == 0
    assert capsys.readouterr().out == (out / "compare.md").read_text() + "\n"
    assert sorted(path.name for path in out.iterdir()) == ["compare.csv", "compare.json", "compare.md"]
    assert json.loads((out / "compare.json").read_text())["rate"] == 0.6


def test_an_output_that_cannot_be_written_is_a_clear_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "a")
    (tmp_path / "file").write_text("kept")
    assert main(["compare", str(run), "--out", str(tmp_path / "file")]) == 1
    told = capsys.readouterr()
    assert f"{tmp_path / 'file'}: cannot write: File exists" in told.err
    assert told.out.startswith("# task2")
    assert (tmp_path / "file").read_text() == "kept"


def test_files_that_cannot_all_be_written_leave_the_old_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run, out = make_run(tmp_path / "a"), tmp_path / "out"
    assert main(["compare", str(run), "--out", str(out)]) == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    write = Path.write_bytes

    def full_disk(path: Path, content: bytes) -> int:
        if "compare.json" in path.name:
            raise OSError(28, "No space left on device", str(path))
        return write(path, content)

    monkeypatch.setattr(Path, "write_bytes", full_disk)
    assert main(["compare", str(run), "--rate", "0.1", "--out", str(out)]) == 1
    assert "No space left on device" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_the_files_are_written_when_nobody_reads_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Unread(io.StringIO):
        def write(self, text: str) -> int:
            raise BrokenPipeError(32, "Broken pipe")

    run, out = make_run(tmp_path / "a"), tmp_path / "out"
    monkeypatch.setattr("sys.stdout", Unread())
    assert main(["compare", str(run), "--out", str(out)]) == 0
    assert len(list(out.iterdir())) == 3


@pytest.mark.parametrize("rate", ["0", "74.3", "-1"])
def test_a_rate_that_is_no_share_is_refused(rate: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["compare", "runs", "--rate", rate])
    assert f"expected a share above 0 and up to 1, found {rate}" in capsys.readouterr().err
