"""Directories of runs without any training: configuration, log and evaluations by hand."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from vhs.config import dump_config, load_config


def make_run(
    path: Path,
    *overrides: str,
    successes: Sequence[float] = (0.5, 0.9),
    evaluations: Sequence[dict[str, Any]] | None = None,
    window: int = 2_000,
) -> Path:
    """A run whose log has a row of `window` episodes and 10 minutes for each of `successes`."""
    trained = window * len(successes)
    config = load_config([], [f"train.episodes={trained}", *overrides])
    path.mkdir(parents=True)
    (path / "config.yaml").write_text(dump_config(config))
    (path / "run.json").write_text(json.dumps({"command": "vhs train", "commit": "abc", "machine": "m"}))
    rows = [
        {"episodes": window * (index + 1), "rate/success": success, "time/minutes": 10.0 * (index + 1)}
        for index, success in enumerate(successes)
    ]
    (path / "log.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    entries = [evaluation(trained_episodes=trained)] if evaluations is None else evaluations
    (path / "eval.json").write_text(json.dumps(list(entries)))
    return path


def evaluation(**changes: Any) -> dict[str, Any]:
    fields = {
        "success": 0.9,
        "failure": 0.0,
        "timeout": 0.1,
        "spl": 0.6,
        "steps": 9.0,
        "optimal_steps": 5.0,
        "episodes": 300,
        "seed": 0,
        "greedy": False,
        "trained_episodes": 4_000,
    }
    return fields | changes
