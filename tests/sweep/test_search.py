"""Searches: what is tried, resuming, failures, and what a file may not say; runs are a stand-in for `vhs`."""

import json
import re
import sys
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from stand_in import STAND_IN, Journal

from vhs.cli import main
from vhs.config import dump_config
from vhs.distribution import find_sweep
from vhs.errors import CheckpointError, ConfigError, OutputError
from vhs.runs.files import write_files
from vhs.sweep.file import read_sweep
from vhs.sweep.plan import PlannedRun
from vhs.sweep.runner import sweep
from vhs.sweep.search import Search
from vhs.sweep.study import STUDY_NAME

optuna = pytest.importorskip("optuna", reason="needs vhs-rl[optuna]")

SEARCH = """
set: {train.episodes: 4}
eval: {episodes: 7, seed: 9}
search:
  trials: 14
  seed: 3
  keys:
    method.relabel_probability: {low: 0, high: 1}
    train.learning_rate: {low: 1.0e-4, high: 1.0e-2, log: true}
"""
needs_linux = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="cores are pinned on Linux alone"
)


def write(root: Path, text: str = SEARCH) -> Path:
    (root / "sweep.yaml").write_text(text)
    return root / "sweep.yaml"


def search_of(root: Path, text: str = SEARCH, out: str = "out") -> Search:
    path = write(root, text)
    content = read_sweep(path)
    assert content.search is not None
    (root / out).mkdir(exist_ok=True)
    return Search(path, content, content.search, root / out, 1)


def play(search: Search, trials: int) -> list[str]:
    """Begin, or go on, and succeed most with the half of a key's range; one run at a time."""
    search.begin()
    names = []
    for _ in range(trials):
        run = search.next()
        if run is None:
            break
        names.append(run.name)
        search.finish(run, {"success": 1 - abs(0.5 - run.config.method.relabel_probability), "spl": None})
    return names


def test_a_seed_suggests_the_same_and_a_search_that_was_stopped_goes_on_as_if_it_had_not_been(
    tmp_path: Path,
) -> None:
    whole = play(search_of(tmp_path, out="a"), 99)
    assert len(set(whole)) == 14
    first = play(search_of(tmp_path, out="b"), 5)
    open_trial = search_of(tmp_path, out="b")
    open_trial.begin()
    begun = open_trial.next()  # and is killed
    assert begun is not None
    rest = play(search_of(tmp_path, out="b"), 99)
    assert begun.name == rest[0]
    assert first + rest == whole
    assert play(search_of(tmp_path, SEARCH.replace("seed: 3", "seed: 4"), out="c"), 1) != whole[:1]
    assert play(search_of(tmp_path, out="b"), 1) == []
    assert len(play(search_of(tmp_path, SEARCH.replace("14", "16"), out="b"), 99)) == 2


def test_a_search_finds_the_better_half(tmp_path: Path) -> None:
    text = SEARCH.replace("14", "30")
    names = play(search_of(tmp_path, text), 99)
    tried = [float(re.findall(r"relabel_probability=([\d.]+)", name)[0]) for name in names]
    off = [abs(0.5 - value) for value in tried]
    assert sum(off[15:]) < sum(off[:15])


def test_a_whole_range_of_a_key_that_takes_fractions_has_fractions_and_others_have_none(
    tmp_path: Path,
) -> None:
    text = """
set: {train.episodes: 4}
search:
  trials: 6
  sampler: random
  keys:
    method.relabel_probability: {low: 0, high: 1}
    train.episodes_per_update: {low: 2, high: 5}
    method.relabel_on: {choices: [null, [timeout], [failure, timeout]]}
"""
    search = search_of(tmp_path, text)
    search.begin()
    runs = [search.next() for _ in range(6)]
    configs = [run.config for run in runs if run is not None]
    assert len({config.method.relabel_probability for config in configs}) == 6
    assert {config.train.episodes_per_update for config in configs} <= {2, 3, 4, 5}
    assert {config.method.relabel_on for config in configs} <= {None, ("timeout",), ("failure", "timeout")}
    assert len({config.method.relabel_on for config in configs}) > 1


def test_trials_that_try_the_same_share_their_run_and_seeds_their_mean(tmp_path: Path) -> None:
    text = """
set: {train.episodes: 4}
seeds: [0, 1]
search:
  trials: 9
  sampler: random
  keys:
    method.relabel_on: {choices: [[failure], [timeout]]}
"""
    search = search_of(tmp_path, text)
    search.begin()
    runs = []
    while (run := search.next()) is not None:
        runs.append(run)
    assert len(runs) == len({run.name for run in runs}) == 4
    for number, run in enumerate(runs):
        assert search.conclude() == [] or number >= 2
        search.finish(run, {"success": number / 4, "spl": 0.5})
    study = search._study
    assert {trial.value for trial in study.trials} == {0.125, 0.625}
    assert search.conclude()[0].startswith("best of 9 trials: success 62.5% in ")


PRUNED = """
set: {train.episodes: 8, train.log_every: 2}
search:
  trials: 8
  pruner: median
  keys:
    method.relabel_probability: {low: 0, high: 1}
"""


def test_a_training_that_is_below_the_median_of_five_is_hopeless(tmp_path: Path) -> None:
    search = search_of(tmp_path, PRUNED)
    search.begin()

    def log(success: list[float]) -> PlannedRun:
        run = search.next()
        assert run is not None
        rows = ({"episodes": 2 * (row + 1), "rate/success": rate} for row, rate in enumerate(success))
        text = "".join(json.dumps(row) + "\n" for row in rows)
        files = {"config.yaml": dump_config(run.config), "run.json": "{}", "log.jsonl": text}
        write_files(tmp_path / "out" / run.name, files)
        return run

    for rate in (0.1, 0.2, 0.3, 0.4, 0.5):
        run = log([rate, rate, rate, rate])
        assert not search.is_hopeless(run)
        search.finish(run, {"success": rate})
    better, worse = log([0.35, 0.1]), log([0.25, 0.9])
    assert not search.is_hopeless(better)
    assert search.is_hopeless(worse), "by its first row, whatever the second says"
    again = search_of(tmp_path, PRUNED)
    again.begin()
    assert [again.next(), again.next()] == [better, worse]
    assert again.is_hopeless(worse)
    again.abandon(worse)
    again.finish(better, {"success": 0.35})
    states = [trial.state.name for trial in again._study.trials]
    assert states == [*["COMPLETE"] * 6, "PRUNED"]
    assert again.conclude()[0].startswith("best of 7 trials: success 50.0% in ")
    assert len(again.runs_so_far()[1]) == 6
    with pytest.raises(ConfigError, match=r"search\.pruner: expected one seed, found 2"):
        search_of(tmp_path, "seeds: [0, 1]" + PRUNED)


def test_a_trial_that_tries_what_was_pruned_is_judged_anew_and_not_left_open(tmp_path: Path) -> None:
    keys = "method.relabel_on: {choices: [[failure], [timeout]]}"
    search = search_of(tmp_path, PRUNED.replace("method.relabel_probability: {low: 0, high: 1}", keys))
    search.begin()
    names = []
    while (run := search.next()) is not None:
        names.append(run.name)
        search.abandon(run)
    assert len(names) == 8
    assert len(set(names)) == 2
    assert {trial.state.name for trial in search._study.trials} == {"PRUNED"}


@pytest.mark.slow
@needs_linux
def test_a_hopeless_run_saves_and_is_not_evaluated_nor_run_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(STAND_IN))
    monkeypatch.setenv("STAND_IN_JOURNAL", str(tmp_path / "journal"))
    monkeypatch.setenv("STAND_IN_S", "60")
    journal = Journal(tmp_path / "journal")
    monkeypatch.setattr(Search, "is_hopeless", lambda search, run: journal.of("train") == [run.name])
    path, told = write(tmp_path, PRUNED.replace("trials: 8", "trials: 1")), StringIO()
    assert sweep(path, tmp_path / "out", 1, told) == 0
    assert told.getvalue().splitlines()[0].endswith("-seed0: ended early, at episode 0")
    assert [entry["event"] for entry in journal.entries] == ["train", "stopped", "end"]
    assert sweep(path, tmp_path / "out", 1, told) == 0
    assert len(journal.of("train")) == 1


def test_a_combination_that_is_no_configuration_is_told_and_the_next_trial_follows(tmp_path: Path) -> None:
    text = """
set: {train.episodes: 4}
search:
  trials: 12
  sampler: random
  keys:
    env.num_envs: {choices: [8, 2]}
    env.min_ready: {choices: [1, 4]}
"""
    search = search_of(tmp_path, text)
    search.begin()
    planned, refused = [], []
    while len(search._study.trials) < 12:
        try:
            planned.append(search.next())
        except ConfigError as error:
            refused.append(str(error))
    tried = {(run.config.env.num_envs, run.config.env.min_ready) for run in planned if run is not None}
    assert tried == {(2, 1), (8, 1), (8, 4)}
    assert all("sweep.yaml: search: env.min_ready: expected" in error for error in refused)
    states = [trial.state for trial in search._study.trials]
    assert states.count(optuna.trial.TrialState.FAIL) == len(refused) > 0


def test_the_search_that_we_ship_can_begin(tmp_path: Path) -> None:
    path = find_sweep("search")
    content = read_sweep(path)
    assert content.search is not None
    assert Search(path, content, content.search, tmp_path, 1).total == 20


@pytest.mark.slow
@needs_linux
def test_the_runs_of_a_search_are_ordinary_runs_and_a_failed_one_is_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(STAND_IN))
    monkeypatch.setenv("STAND_IN_JOURNAL", str(tmp_path / "journal"))
    monkeypatch.setenv("STAND_IN_S", "0")
    monkeypatch.setenv("STAND_IN_BEST", "method.relabel_probability=0.5")
    text = SEARCH.replace("14", "3")
    monkeypatch.setenv("STAND_IN_FAILS", play(search_of(tmp_path, text, out="b"), 2)[1])
    path = write(tmp_path, text)

    def run() -> tuple[int, list[str]]:
        told = StringIO()
        status = sweep(path, tmp_path / "out", 1, told)
        return status, told.getvalue().splitlines()

    status, lines = run()
    assert status == 1
    assert sum(": failed: vhs: the roof fell in" in line for line in lines) == 1
    assert main(["sweep", str(path), "--out", str(tmp_path / "out"), "--list"]) == 0
    listed = capsys.readouterr()
    assert len(listed.out.splitlines()) == 3
    assert "a search: 3 of its 3 trials are listed" in listed.err
    monkeypatch.delenv("STAND_IN_FAILS")
    status, lines = run()
    assert status == 0
    journal = Journal(tmp_path / "journal")
    assert len(journal.of("train")) == 4
    assert len(set(journal.of("eval"))) == len(journal.of("eval")) == 3
    best = max(
        (tmp_path / "out").glob("task2-*"),
        key=lambda run: json.loads((run / "eval.json").read_text())[0]["success"],
    )
    assert lines[-2].startswith("best of 3 trials: success ")
    assert lines[-2].endswith(f" in {best}")
    assert run()[0] == 0
    assert len(journal.of("train")) == 4


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (("trials: 14", "trials: 0"), r"search\.trials: expected greater than or equal to 1, found 0"),
        (("trials: 14", "trails: 14"), r"unknown key `search\.trails`; did you mean `search\.trials`\?"),
        (
            ("low: 0, high: 1", "low: 1, high: 0"),
            r"search\.keys\.method\.relabel_probability: expected low < high, ",
        ),
        (("low: 1.0e-4", "low: 0"), r"search\.keys\.train\.learning_rate: expected low > 0 for log, found 0"),
        (("low: 0, high: 1", "low: 0"), r"expected `low` and `high`, or `choices`, found neither"),
        (("low: 0, high: 1", "low: 0, high: 1, choices: [0, 1]"), "or `choices`, found both"),
        (
            ("low: 0, high: 1", "choices: [0]"),
            r"keys\.method\.relabel_probability\.choices: .* at least 2 items",
        ),
        (("low: 0, high: 1", "low: 0, high: true"), r"high: expected a number, found true"),
        (
            ("low: 0, high: 1", "low: 0, high: 2"),
            r"search: method\.relabel_probability: expected .*, found 2",
        ),
        (
            ("method.relabel_probability: {low: 0, high: 1}", "env.renderer: {choices: [raster, mujoko]}"),
            "mujoko",
        ),
        (("relabel_probability", "relabel_probabilty"), r"search: unknown key .* did you mean `method\."),
        (("train.learning_rate", "seed"), "seed: expected another key, seeds stand in `seeds`"),
        (("seed: 3", "sampler: best"), r"search\.sampler: expected 'tpe' or 'random', found 'best'"),
        (("search:", "grids: [{}]\nsearch:"), "search: expected none beside `grids`, found both"),
        ((SEARCH, "set: {}"), "grids: expected at least one, or a `search` in their place, found nothing"),
    ],
)
def test_a_wrong_search_is_explained(changed: tuple[str, str], message: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        search_of(tmp_path, SEARCH.replace(*changed))
    assert str(caught.value).startswith(f"{tmp_path / 'sweep.yaml'}: ")


def test_another_search_is_refused_in_the_directory_of_one(tmp_path: Path) -> None:
    play(search_of(tmp_path), 1)
    for changed, key in (
        (("low: 0,", "low: 0.1,"), r"method\.relabel_probability, search\.keys"),
        (("episodes: 7", "episodes: 8"), r"eval\.episodes"),
        (("train.episodes: 4", "train.episodes: 5"), r"train\.episodes"),
    ):
        with pytest.raises(CheckpointError, match=f"{STUDY_NAME}: holds a search with other values of {key}"):
            search_of(tmp_path, SEARCH.replace(*changed)).begin()


def test_a_journal_that_a_kill_cut_short_goes_on(tmp_path: Path) -> None:
    whole = play(search_of(tmp_path, out="a"), 4)
    play(search_of(tmp_path), 2)
    journal = tmp_path / "out" / STUDY_NAME
    with journal.open("ab") as file:
        file.write(b'{"op_code":4,"wor')
    (tmp_path / "out" / f"{STUDY_NAME}.lock").symlink_to(journal)
    assert play(search_of(tmp_path), 2) == whole[2:]
    journal.write_bytes(b"{}\n{}\n")
    with pytest.raises(CheckpointError, match=f"{STUDY_NAME}: expected a study of Optuna, found"):
        search_of(tmp_path).begin()


@needs_linux
def test_a_full_disk_ends_a_search_with_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def append(backend: Any, logs: Any) -> None:
        raise OSError(28, "No space left on device")

    play(search_of(tmp_path), 0)
    monkeypatch.setattr("optuna.storages.journal.JournalFileBackend.append_logs", append)
    with pytest.raises(OutputError, match=f"{STUDY_NAME}: cannot write: No space left on device"):
        sweep(tmp_path / "sweep.yaml", tmp_path / "out", 1, StringIO())


def test_a_task_without_a_shortest_way_has_no_spl_to_maximise(tmp_path: Path) -> None:
    search = search_of(tmp_path, SEARCH.replace("trials: 14", "trials: 1\n  maximise: spl"))
    with pytest.raises(ConfigError, match=r"sweep\.yaml: search\.maximise: the task measures no spl"):
        play(search, 1)


def test_a_missing_optuna_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(ConfigError, match=r"search: optuna is not installed; pip install 'vhs-rl\[optuna\]'"):
        search_of(tmp_path)


def test_a_search_that_has_not_begun_lists_nothing_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path)
    assert main(["sweep", str(path), "--out", str(tmp_path / "none"), "--list"]) == 0
    said: Any = capsys.readouterr()
    assert said.out == ""
    assert "a search: 0 of its 14 trials are listed" in said.err
    assert not (tmp_path / "none").exists()
