"""How short a way can be that has to look for its goal: `docs/results/limit.py TASK...`.

An oracle that knows where everything stands, but has to see its goal first: it turns to one side until so
many pixels of the goal are in view, and goes the shortest way from there.
"""

import argparse
import json
import math
import shlex
import sys
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from visible import Visible

from vhs.acting.seeds import episode_seeds
from vhs.envs import RoomEnv, plan
from vhs.envs.config import HEADINGS, TURN_LEFT, TURN_RIGHT
from vhs.envs.oracle import NoPlanError
from vhs.envs.task import load_room
from vhs.runs.directory import describe

PIXELS = (1, 10, 25, 50)
"""Of the goal in the view that ends the search, at least."""


def limits(task: str, episodes: int, seeds: list[int]) -> list[dict[str, Any]]:
    """SPL over the rooms that `vhs eval` has, and the share that is seen; a row for each number of pixels."""
    room: RoomEnv = load_room(task).new_env().unwrapped  # type: ignore[assignment]
    visible = Visible(room)
    turns = TURN_LEFT, TURN_RIGHT
    found: dict[tuple[int, int], list[float]] = {(px, turn): [] for px in PIXELS for turn in turns}
    for seed in seeds:
        for of_room in islice(episode_seeds(seed, purpose=1), episodes):
            for turn in turns:
                for pixels, spl in _spl(room, visible, of_room, turn).items():
                    found[pixels, turn].append(spl)
    room.close()
    return [
        {
            "pixels": px,
            "seen": round(float(np.mean([spl > 0 for spl in found[px, TURN_LEFT]])), 4),
            "spl_turning_left": round(float(np.mean(found[px, TURN_LEFT])), 4),
            "spl_turning_right": round(float(np.mean(found[px, TURN_RIGHT])), 4),
        }
        for px in PIXELS
    ]


def _spl(room: RoomEnv, visible: Visible, seed: int, turn: int) -> dict[int, float]:
    """By pixels: of an oracle that turns to one side until it sees so many; 0 of what it never sees."""
    room.reset(seed=seed)
    shortest, found = len(plan(room)), dict.fromkeys(PIXELS, 0.0)
    for turned in range(HEADINGS):
        seen = visible()[room.goal]
        for pixels in PIXELS:
            if seen >= pixels and not found[pixels]:
                found[pixels] = shortest / max(shortest, turned + _steps_from_here(room))
        room.step(turn)
    return found


def _steps_from_here(room: RoomEnv) -> float:
    try:
        return len(plan(room))
    except NoPlanError:  # of the steps that are left
        return math.inf


def main() -> None:
    """Measure every task, and write what was found."""
    parser = argparse.ArgumentParser(description="How short a way can be that has to look for its goal.")
    parser.add_argument("tasks", nargs="+", help="task1 to task3")
    parser.add_argument("--episodes", type=int, default=300)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    tasks = {}
    for task in options.tasks:
        tasks[task] = limits(task, options.episodes, options.seeds)
        for row in tasks[task]:
            print(task, row)
    if options.out:
        meta = {**describe(), "command": shlex.join(["python", *sys.argv])}
        options.out.write_text(json.dumps({**meta, "tasks": tasks}) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
