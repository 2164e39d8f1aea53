"""A sweep whose runs are a stand-in for `vhs`, and what the stand-ins wrote down."""

import json
import time
from pathlib import Path
from typing import Any

STAND_IN = Path(__file__).parents[1] / "sweep" / "stand_in_package"

FOUR_RUNS = """
set: {train.episodes: 4}
seeds: [0, 1]
eval: {episodes: 7, seed: 9}
grids:
  - grid: {method.relabel_probability: [0.4, 0.8]}
"""


class Journal:
    """What the stand-ins wrote down."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def entries(self) -> list[dict[str, Any]]:
        if not self.path.exists():
            return []
        return [json.loads(line) for line in self.path.read_text().splitlines()]

    def of(self, event: str) -> list[str]:
        return [entry["run"] for entry in self.entries if entry["event"] == event]

    def wait_for(self, event: str, count: int = 1) -> None:
        end = time.monotonic() + 90  # a machine that is busy elsewhere is not a bug
        while time.monotonic() < end:
            if len(self.of(event)) >= count:
                return
            time.sleep(0.05)
        raise AssertionError(f"no {event} within 90 s: {self.entries}")
