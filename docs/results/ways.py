"""Where the steps go: `docs/results/ways.py AGENT...`.

An AGENT is a run or an exported agent; all are asked for the same goals in the same rooms. An episode is
divided at the first view that shows the goal. Of a success: the steps before it, which look for it, those
after it, how many of these changed nothing, and the shortest plan from there. Of all episodes whose first
view has the goal ahead: whether the agent walks on.
"""

import argparse
import json
import math
import shlex
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from visible import Visible, played

from vhs import Outcome
from vhs.acting.policy import Policy, load_agent
from vhs.envs import RoomEnv, plan
from vhs.runs.directory import describe

SEEN_PX = 10
"""Pixels of the goal in the first view that shows it, at least."""
AHEAD_DEG = 22.5
"""The goal's centre lies less far aside in a view that has it ahead: no turn brings it nearer."""
BINS_PX = (10, 25, 50, 75, 100, 150, 84 * 84)
FORWARD, TURN_LEFT, TURN_RIGHT = 0, 1, 2


class Way(NamedTuple):
    """One episode, from its first view of the goal on."""

    is_success: bool
    shortest: int
    """Steps of the shortest plan from the start."""
    search: int
    """Steps taken before that view."""
    after: int
    """Steps taken after it."""
    plan: int
    """Steps of the shortest plan from there; 0 of what was no success."""
    idle: int
    """Steps after it that changed nothing."""
    pixels: int
    """Of the goal in that view."""
    action: int | None
    """Taken there where the goal was ahead; None where it was aside."""


STEPS = ("shortest", "search", "after", "plan", "idle")
"""What is counted in steps."""


def ways(trained: Policy, episodes: int, seed: int, greedy: bool) -> list[Way]:
    """Those of the episodes of an agent in which the goal was seen before the last step."""
    room: RoomEnv = trained.task.new_env().unwrapped  # type: ignore[assignment]
    visible = Visible(room)
    found = [
        way
        for ended, actions in played(trained, episodes, seed, greedy)
        if (way := _way(room, visible, ended.seed, actions, ended.outcome == Outcome.SUCCESS)) is not None
    ]
    room.close()
    return found


def _way(room: RoomEnv, visible: Visible, seed: int, actions: list[int], is_success: bool) -> Way | None:
    room.reset(seed=seed)
    shortest = len(plan(room))
    for search, action in enumerate(actions):
        pixels = visible()[room.goal]
        if pixels >= SEEN_PX:
            from_here = len(plan(room)) if is_success else 0
            taken = action if abs(_bearing_deg(room)) < AHEAD_DEG else None
            idle = sum(_changes_nothing(room, step) for step in actions[search:-1])
            after = len(actions) - search
            return Way(is_success, shortest, search, after, from_here, idle, pixels, taken)
        room.step(action)
    return None


def _bearing_deg(room: RoomEnv) -> float:
    pose, goal = room.world.measured_pose, room.world.footprints[room.goal]
    bearing = math.atan2(goal.y_m - pose.y_m, goal.x_m - pose.x_m) - pose.yaw_rad
    return math.degrees(math.remainder(bearing, math.tau))


def _changes_nothing(room: RoomEnv, action: int) -> bool:
    """Take a step that does not end the episode; whether the robot stands where it stood."""
    before = room.world.commanded_pose
    room.step(action)
    return room.world.commanded_pose == before


def summary(found: list[Way], episodes: int) -> dict[str, Any]:
    """Means over the successes, and by the pixels of the first view how many walk on."""
    successes = [way for way in found if way.is_success]
    means = {name: round(float(np.mean([getattr(way, name) for way in successes])), 3) for name in STEPS}
    spl = [way.shortest / max(way.search + way.after, way.shortest) for way in successes]
    seeing = [way.shortest / max(way.search + way.plan, way.shortest) for way in successes]
    rows = []
    for low, high in pairwise(BINS_PX):
        taken = [way.action for way in found if low <= way.pixels < high and way.action is not None]
        rows.append({"from": low, "to": high, "views": len(taken), "walked_on": sum(
            action not in (TURN_LEFT, TURN_RIGHT) for action in taken
        )})  # fmt: skip
    return {
        "episodes": episodes,
        "successes": len(successes),
        **means,
        "spl_of_successes": round(float(np.mean(spl)), 4),
        "spl_with_plans_after": round(float(np.mean(seeing)), 4),
        "ahead": rows,
    }


def show(name: str, found: dict[str, Any]) -> None:
    """The same for reading."""
    print(f"{name}: {found['successes']} successes of {found['episodes']} episodes")
    for key in STEPS:
        print(f"  {key:10} {found[key]:.2f} steps")
    print(
        f"  SPL {found['spl_of_successes']:.3f}, with the shortest plan after the first view "
        f"{found['spl_with_plans_after']:.3f}"
    )
    for row in found["ahead"]:
        if row["views"]:
            share = row["walked_on"] / row["views"]
            print(f"  ahead, {row['from']:4} to {row['to'] - 1:4} px: {share:.2f} of {row['views']} walk on")


def main() -> None:
    """Ask every agent, and write what was found."""
    parser = argparse.ArgumentParser(description="Where the steps go.")
    parser.add_argument("agents", type=Path, nargs="+")
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--greedy", action="store_true")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    agents = {}
    for path in options.agents:
        trained = load_agent(path)
        found = ways(trained, options.episodes, options.seed, options.greedy)
        agents[path.name] = summary(found, options.episodes)
        show(path.name, agents[path.name])
    if options.out:
        meta = {**describe(), "command": shlex.join(["python", *sys.argv])}
        options.out.write_text(json.dumps({**meta, "agents": agents}) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
