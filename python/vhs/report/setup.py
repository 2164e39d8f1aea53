"""The section about what made the runs: commands, commits, seeds, settings, and what is missing."""

from __future__ import annotations

from collections.abc import Sequence
from xml.sax.saxutils import escape

from vhs.config import Config, dump_config
from vhs.config.variants import describe_value, flat_config
from vhs.report.page import Section, missing, table
from vhs.runs.reader import Run


def setup_section(runs: Sequence[Run], shown: Run) -> Section:
    """What made the runs."""
    parts = [_provenance(runs), _notes(runs)]
    if shown.found_config is not None:
        parts.append(_departures(shown.config))
        text = escape(dump_config(shown.config))
        head = f"<summary>Resolved configuration of {escape(shown.name)}</summary>"
        parts.append(f'<div class="card setup"><details>{head}<pre>{text}</pre></details></div>')
    else:
        parts.append(missing(f"{shown.name} has no readable configuration"))
    return Section("setup", "What made this", "".join(parts))


def _provenance(runs: Sequence[Run]) -> str:
    keys = ("command", "commit", "version", "time", "machine", "precision")
    rows = []
    for run in runs:
        seed = "?" if run.found_config is None else str(run.found_config.seed)
        # A run that went on elsewhere says so; its command and its first time are enough.
        told = {key: dict.fromkeys(str(start.get(key) or "?") for start in run.starts) for key in keys}
        once = {key: next(iter(told[key])) for key in ("command", "time")}
        rows.append((run.name, *(once.get(key) or ", ".join(told[key]) for key in keys), seed))
    shown = ["started (UTC)" if key == "time" else key for key in keys]
    return table(("run", *shown, "seed"), rows, numbers_from=1 + len(keys))


def _notes(runs: Sequence[Run]) -> str:
    items = "".join(f"<li>{escape(run.name)}: {escape(note)}</li>" for run in runs for note in run.notes)
    return f"<h3>Missing or damaged</h3><ul>{items}</ul>" if items else ""


def _departures(config: Config) -> str:
    """Settings that are not the defaults."""
    mine, plain = flat_config(config), flat_config(Config())
    rows = [
        (key, describe_value(value), describe_value(plain.get(key)))
        for key, value in mine.items()
        if value != plain.get(key)
    ]
    if not rows:
        return '<p class="note">Every setting is the default.</p>'
    return "<h3>Settings that are not the default</h3>" + table(
        ("key", "value", "default"), rows, numbers_from=3
    )
