"""What `vhs report` does: read runs, look at one agent, write one page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from vhs import VhsError, __version__
from vhs.acting.policy import Policy, load_agent
from vhs.report.curves import cost_section, curve_section, loss_section
from vhs.report.evaluation import confusion_section, episode_section
from vhs.report.goals import feature_section, look_at_goals, prototype_section, store_section
from vhs.report.names import group_title, task_title
from vhs.report.page import Section, page
from vhs.report.setup import setup_section
from vhs.report.tracks import Track, play_tracks, success_and_spl, wilson_interval
from vhs.runs.files import check_writable, write_files
from vhs.runs.reader import Group, Run, find_runs, group_runs, read_run
from vhs.task import Task


@dataclass(frozen=True, slots=True)
class _Subject:
    """The run whose agent is looked at."""

    run: Run
    agent: Policy | None
    why: str
    """Why there is no agent."""
    tracks: Sequence[Track]


def report(
    path: Path,
    out: Path | None = None,
    *,
    episodes: int = 100,
    seed: int = 0,
    task: Task | None = None,
) -> Path:
    """Write a page about a run, or about every run below a directory.

    The agent of one run is looked at closely: the one with a checkpoint and the best success.

    Args:
        path: a run, or a directory that holds some.
        out: HTML file; `report.html` in `path` when None.
        episodes: evaluation episodes that are played for the page.
        seed: which ones.
        task: of the agent that is looked at; None: the task that its configuration names.

    Returns:
        Where the page is.

    Raises:
        CheckpointError: there is no run.
        OutputError: the page cannot be written; nothing was.
    """
    out = path / "report.html" if out is None else out
    runs = [read_run(run, name, strict=False) for run, name in find_runs([path]).items()]
    check_writable(out)
    groups = sorted(group_runs(runs, strict=False), key=lambda group: (group.task or "", group.label))
    subject = _subject(runs, episodes, seed, task)
    text = page(
        _title(groups),
        _subtitle(runs, subject),
        _tiles(subject),
        _sections(runs, groups, subject),
        _foot(),
    )
    write_files(out.parent, {out.name: text})
    return out


def _subject(runs: Sequence[Run], episodes: int, seed: int, task: Task | None) -> _Subject:
    candidates = sorted((run for run in runs if run.has_checkpoint), key=lambda run: -run.final_success)
    if not candidates:
        best = max(runs, key=lambda run: run.final_success)
        return _Subject(best, None, "no run has a checkpoint", ())
    run = candidates[0]
    try:
        agent = load_agent(run.path, task)
        return _Subject(run, agent, "", play_tracks(agent, episodes, seed))
    except VhsError as error:
        return _Subject(run, None, str(error), ())


def _sections(runs: Sequence[Run], groups: Sequence[Group], subject: _Subject) -> list[Section]:
    agent = subject.agent
    goals = None if agent is None else look_at_goals(agent)
    names = [] if agent is None else [agent.task.goal_name(label) for label in range(agent.spec.num_goals)]
    why = subject.why or "the goal store is empty: no episode of this run has succeeded yet"
    return [
        curve_section(groups),
        confusion_section(subject.tracks, names, subject.why),
        episode_section(subject.tracks, names, subject.why),
        store_section(goals, why),
        prototype_section(goals, why),
        feature_section(goals, why),
        loss_section(groups),
        cost_section(groups),
        setup_section(runs, subject.run),
    ]


def _title(groups: Sequence[Group]) -> str:
    if len(groups) == 1:
        return f"{task_title(groups[0].task)}: {group_title(groups[0])}"
    tasks = list(dict.fromkeys(task_title(group.task) for group in groups))
    labels = {group.label for group in groups}
    methods = f"{len(labels)} methods" if len(labels) > 1 else group_title(groups[0])
    return f"{methods} on {', '.join(tasks)}"


def _subtitle(runs: Sequence[Run], subject: _Subject) -> str:
    text = f"{len(runs)} run{'s' if len(runs) > 1 else ''}"
    if len(runs) == 1:
        text += ", one seed: curves have no band"
    if subject.agent is not None:
        text += f". Numbers, episodes, goals and features: {subject.run.name}"
        text += f" after {subject.agent.trained_episodes:,} episodes of training"
        text += ", the run with the best success that has a checkpoint" if len(runs) > 1 else ""
    else:
        text += f". Numbers: {subject.run.name}, the best" if len(runs) > 1 else ""
        text += f". No agent to look at: {subject.why}"
    return f"{text}."


def _tiles(subject: _Subject) -> list[tuple[str, str]]:
    """The numbers that somebody wants first."""
    tiles = []
    if subject.tracks:
        success, spl = success_and_spl(subject.tracks)
        low, high = wilson_interval(success, len(subject.tracks))
        interval = f"95 %: {100 * low:.0f} to {100 * high:.0f} %"
        text = f"success in {len(subject.tracks)} evaluation episodes ({interval})"
        tiles.append((f"{success:.1%}", text))
        if spl is not None:
            tiles.append((f"{spl:.2f}", "SPL: success weighted by shortest / taken steps"))
    rows = subject.run.rows
    if rows:
        tiles.append((f"{subject.run.final_success:.1%}", "success over the last tenth of training"))
        tiles.append((f"{rows[-1]['episodes']:,}", "episodes of training"))
    if rows and "time/minutes" in rows[-1]:
        tiles.append((f"{rows[-1]['time/minutes']:.0f} min", "of training"))
    if rows and "env_steps" in rows[-1]:
        speed = rows[-1]["env_steps"] / max(60 * rows[-1].get("time/minutes", 0.0), 1e-9)
        tiles.append((f"{speed:.0f}", "environment steps per second"))
    return tiles


def _foot() -> str:
    now = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    return f"Written by vhs {__version__}, {now}. One file, nothing loaded from elsewhere."
