"""The comparison of runs: success over seeds, and how many episodes and minutes a success rate takes.

Defined in docs/guides/comparing.md; the formulas are in `vhs.eval.metrics`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vhs.config.variants import Label
from vhs.errors import ComparisonError
from vhs.eval.metrics import (
    first_row_at_rate,
    interquartile_mean,
    mean_and_deviation,
    sample_efficiency_improvement,
    sample_requirement_ratio,
)
from vhs.eval.paper import REFERENCE_RATE
from vhs.runs.evaluations import EVALUATIONS_NAME
from vhs.runs.reader import Group, Run, find_runs, group_runs, read_run

WINDOW = 2_000
"""Training episodes over which success is averaged to say that a rate is reached."""


@dataclass(frozen=True, slots=True)
class Protocol:
    """Evaluations that all compared runs share: (seed of the rooms, episodes) of each."""

    greedy: bool
    sets: tuple[tuple[int, int], ...]

    def describe(self) -> str:
        """For a person: ``300 episodes in the rooms of each of the seeds 0, 1, actions sampled``."""
        seeds_by_episodes: dict[int, list[str]] = {}
        for seed, episodes in self.sets:
            seeds_by_episodes.setdefault(episodes, []).append(str(seed))
        rooms = " and ".join(
            f"{episodes} episodes in the rooms of "
            + (f"seed {seeds[0]}" if len(seeds) == 1 else f"each of the seeds {', '.join(seeds)}")
            for episodes, seeds in seeds_by_episodes.items()
        )
        return f"{rooms}, {'likeliest actions' if self.greedy else 'actions sampled'}"


@dataclass(frozen=True, slots=True)
class RunResult:
    """What one run adds to its group."""

    run: Run
    success: float
    spl: float | None
    """None where the task says no shortest way."""
    episodes_to_rate: int | None
    """Episodes of training until the rate was reached; None where it was not."""
    minutes_to_rate: float | None


@dataclass(frozen=True, slots=True)
class GroupResult:
    """A row of the table: one configuration over its seeds."""

    label: Label
    runs: Sequence[RunResult]
    success_iqm: float
    success_interval: tuple[float, float] | None
    """95 % bootstrap interval of the interquartile mean; None for one seed."""
    srr: float | None
    sei: float | None
    """None where this group or the reference did not reach the rate with every seed."""

    @property
    def success(self) -> tuple[float, float | None]:
        """Mean and standard deviation over seeds."""
        return mean_and_deviation([result.success for result in self.runs])

    @property
    def spl(self) -> tuple[float, float | None] | None:
        """Mean and standard deviation over seeds; None where the task says no shortest way."""
        return _over_seeds([result.spl for result in self.runs])

    @property
    def seeds_reached(self) -> int:
        """How many seeds reached the rate."""
        return sum(result.episodes_to_rate is not None for result in self.runs)

    @property
    def episodes_to_rate(self) -> tuple[float, float | None] | None:
        """Mean and standard deviation over seeds; None unless every seed reached the rate."""
        return _over_seeds([result.episodes_to_rate for result in self.runs])

    @property
    def minutes_to_rate(self) -> tuple[float, float | None] | None:
        """Mean and standard deviation over seeds; None unless every seed reached the rate."""
        return _over_seeds([result.minutes_to_rate for result in self.runs])


@dataclass(frozen=True, slots=True)
class Comparison:
    """Everything that the table shows."""

    task: str
    rate: float
    reference: Label
    """Of the group that SRR and SEI refer to."""
    protocol: Protocol
    groups: Sequence[GroupResult]
    notes: Sequence[str]
    """What a reader must know to judge the numbers."""


def compare(
    paths: Sequence[Path], *, rate: float = REFERENCE_RATE, reference: str | None = None
) -> Comparison:
    """Compare runs of one task.

    Args:
        paths: directories of runs, or directories that hold some.
        rate: success rate, a share, whose cost in episodes and minutes is compared.
        reference: a group by its label, or by one of its runs; None takes the first group.

    Raises:
        CheckpointError: a run is missing or damaged.
        ComparisonError: the runs cannot be compared, or the reference is not among them.
    """
    runs = [read_run(path, name) for path, name in find_runs(paths).items()]
    _check_comparable(runs)
    protocol = shared_protocol(runs)
    groups = group_runs(runs)
    reference_label = groups[0].label if reference is None else _find_reference(groups, reference)
    results = {group.label: [_measure(run, protocol, rate) for run in group.runs] for group in groups}
    needed = _over_seeds([result.episodes_to_rate for result in results[reference_label]])
    return Comparison(
        task=runs[0].config.task_name,
        rate=rate,
        reference=reference_label,
        protocol=protocol,
        groups=[_summarise(label, members, needed) for label, members in results.items()],
        notes=[*_notes(groups), *_reference_note(reference_label, needed is not None)],
    )


def _check_comparable(runs: Sequence[Run]) -> None:
    """Check that runs are of one task, each with an evaluation; those that are not are all named."""
    by_task: dict[str, list[Path]] = {}
    for run in runs:
        by_task.setdefault(run.config.task_name, []).append(run.path)
    if len(by_task) > 1:
        listed = "\n".join(f"  {task}: {', '.join(map(str, by_task[task]))}" for task in sorted(by_task))
        raise ComparisonError(
            f"expected runs of one task, found {len(by_task)}; compare them apart:\n{listed}"
        )
    missing = [run.path for run in runs if not run.evaluations]
    if missing:
        commands = "\n".join(f"  vhs eval {path}" for path in missing)
        raise ComparisonError(
            f"expected {EVALUATIONS_NAME} in every run, found none in {len(missing)}; first run:\n{commands}"
        )


def _newest_evaluations(run: Run) -> list[Mapping[str, Any]]:
    """Those of the most trained checkpoint that was evaluated."""
    return [entry for entry in run.evaluations if entry["trained_episodes"] == trained_episodes(run)]


def trained_episodes(run: Run) -> int:
    """Episodes behind the most trained checkpoint that was evaluated."""
    return max(int(entry["trained_episodes"]) for entry in run.evaluations)


def shared_protocol(runs: Sequence[Run]) -> Protocol:
    """The evaluations that all runs have: with sampled actions if there are any, the longest of each seed.

    Raises:
        ComparisonError: they share none.
    """
    shared = set.intersection(*(_ways(run) for run in runs))
    if not shared:
        listed = "\n".join(f"  {run.path}: {', '.join(map(_shown_way, sorted(_ways(run))))}" for run in runs)
        raise ComparisonError(
            f"expected runs evaluated on the same episodes, found no common evaluation:\n{listed}"
        )
    greedy = min(way[0] for way in shared)
    longest: dict[int, int] = {}
    for _, seed, episodes in sorted(way for way in shared if way[0] == greedy):
        longest[seed] = episodes
    return Protocol(greedy, tuple(sorted(longest.items())))


def _ways(run: Run) -> set[tuple[bool, int, int]]:
    return {(entry["greedy"], entry["seed"], entry["episodes"]) for entry in _newest_evaluations(run)}


def _shown_way(way: tuple[bool, int, int]) -> str:
    greedy, seed, episodes = way
    return f"--episodes {episodes} --seed {seed}{' --greedy' if greedy else ''}"


def _measure(run: Run, protocol: Protocol, rate: float) -> RunResult:
    evaluations = _newest_evaluations(run)
    by_way = {(entry["greedy"], entry["seed"], entry["episodes"]): entry for entry in evaluations}
    entries = [by_way[protocol.greedy, seed, count] for seed, count in protocol.sets]
    episodes, minutes = run.column("episodes").astype(np.int64), run.column("time/minutes")
    row = first_row_at_rate(episodes, run.column("rate/success"), rate, WINDOW)
    return RunResult(
        run=run,
        success=_weighted(entries, "success"),
        spl=None if any(entry["spl"] is None for entry in entries) else _weighted(entries, "spl"),
        episodes_to_rate=None if row is None else int(episodes[row]),
        minutes_to_rate=None if row is None else float(minutes[row]),
    )


def _weighted(entries: Sequence[Mapping[str, Any]], name: str) -> float:
    """Mean over all episodes of several evaluations."""
    return float(np.average([e[name] for e in entries], weights=[e["episodes"] for e in entries]))


def _over_seeds(values: Sequence[float | None]) -> tuple[float, float | None] | None:
    known = [value for value in values if value is not None]
    return mean_and_deviation(known) if len(known) == len(values) else None


def _summarise(
    label: Label, members: Sequence[RunResult], needed: tuple[float, float | None] | None
) -> GroupResult:
    mean, interval = interquartile_mean([result.success for result in members])
    own = _over_seeds([result.episodes_to_rate for result in members])
    srr = sei = None
    if own is not None and needed is not None:
        srr = sample_requirement_ratio(own[0], needed[0])
        sei = sample_efficiency_improvement(own[0], needed[0])
    return GroupResult(
        label=label,
        runs=members,
        success_iqm=mean,
        success_interval=interval,
        srr=srr,
        sei=sei,
    )


def _find_reference(groups: Sequence[Group], reference: str) -> Label:
    for group in groups:
        if reference == str(group.label) or any(
            run.path.resolve() == Path(reference).resolve() for run in group.runs
        ):
            return group.label
    known = ", ".join(f"`{group.label}`" for group in groups)
    raise ComparisonError(
        f"--reference: expected one of the runs or of the groups {known}, found {reference!r}"
    )


def _reference_note(label: Label, is_reached: bool) -> Iterator[str]:
    if not is_reached:
        yield f"The reference `{label}` did not reach the rate with every seed: no SRR and no SEI."


def _notes(groups: Sequence[Group]) -> Iterator[str]:
    for group in groups:
        if len(group.runs) == 1:
            yield f"`{group.label}` has one seed: no deviation and no interval."
    if any(1 < len(group.runs) < 4 for group in groups):
        yield "Below four seeds the interquartile mean is the mean, and the interval rests on few values."
    runs = [run for group in groups for run in group.runs]
    for run in runs:
        asked, logged, trained = run.config.train.episodes, run.rows[-1]["episodes"], trained_episodes(run)
        if trained < asked:
            yield f"`{run.path}` was evaluated after {trained:,} of {asked:,} episodes."
        if trained < logged:
            yield f"`{run.path}` has gone on to {logged:,} episodes since its evaluation."
    makings = {
        (
            str(start.get("machine")),
            str(start.get("precision")),
            run.config.env.num_workers,
            run.config.train.threads,
        )
        for run in runs
        for start in run.starts
        if "machine" in start
    }
    if len(makings) > 1:
        yield "The runs differ in machine, precision, workers or threads: their minutes do not compare."
