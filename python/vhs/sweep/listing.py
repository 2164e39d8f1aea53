"""The runs of a sweep as lines for a shell, for whatever else starts them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from vhs.sweep.file import read_sweep
from vhs.sweep.plan import plan_runs


def list_commands(path: Path, out: Path, overrides: Iterable[str] = ()) -> tuple[list[str], str]:
    """The runs of a sweep file, on a core each.

    Args:
        path: the sweep file.
        out: directory of the runs.
        overrides: as for `read_sweep`.

    Returns:
        A line a run, which trains or resumes it and then evaluates it, always in the same order; and what is
        not among them, if anything.

    Raises:
        ConfigError: the sweep file or `overrides` cannot be used.
        CheckpointError: `out` holds another search.
    """
    content, left_out = read_sweep(path, overrides), ""
    if content.search is None:
        runs = plan_runs(path, content, 1)
    else:
        from vhs.sweep.search import Search

        trials, runs = Search(path, content, content.search, out, 1).runs_so_far()
        left_out = (
            f"{path}: a search: {trials} of its {content.search.trials} trials are listed, those in {out}; "
            "what the others try follows from the results of these, so `vhs sweep` alone starts them"
        )
    return [run.as_line(out, content.eval) for run in runs], left_out
