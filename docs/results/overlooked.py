"""Which goals are missed, by whom, and what is special about them: `docs/results/overlooked.py AGENT...`.

An AGENT is a run or an exported agent; all are asked for the same goals in the same rooms. For each episode:
the outcome, the pixels of the goal in the best of the eight views from the start, and how far the nearest
other object stands from the straight line to the goal; of a timeout the pixels of the goal in each view and
the strides that went nowhere. Of each room that somebody missed: who did, and the shortest way. With
--picture, some rooms that most missed.
"""

import argparse
import json
import shlex
import sys
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from visible import Visible, played

from vhs import Outcome
from vhs.acting.policy import Policy, load_agent
from vhs.envs import OBJECT_NAMES, RoomEnv, plan
from vhs.runs.directory import describe

BINS_PX = (0, 25, 50, 75, 100, 150, 84 * 84)
BINS_M = (0.0, 0.2, 0.3, 0.4, 0.6, 10.0)
HEADINGS = 8
BLOCKED = 3
"""Strides that went nowhere of a timeout that counts as blocked, at least."""
FORWARD, TURN_LEFT = 0, 1


def watch(trained: Policy, episodes: int, seed: int, greedy: bool) -> list[dict[str, Any]]:
    """Play as `vhs eval` does, then look at each episode again."""
    room: RoomEnv = trained.task.new_env().unwrapped  # type: ignore[assignment]
    visible = Visible(room)
    return [
        _look(room, visible, ended.seed, actions, Outcome(ended.outcome))
        for ended, actions in played(trained, episodes, seed, greedy)
    ]


def _look(room: RoomEnv, visible: Visible, seed: int, actions: list[int], outcome: Outcome) -> dict[str, Any]:
    room.reset(seed=seed)
    best = visible()[room.goal]
    for _ in range(HEADINGS - 1):
        room.step(TURN_LEFT)
        best = max(best, visible()[room.goal])
    record = {"seed": seed, "goal": OBJECT_NAMES[room.goal], "outcome": outcome.name.lower()}
    record |= {"best_px": best, "aside_m": round(aside(room), 3)}
    if outcome != Outcome.TIMEOUT:
        return record
    room.reset(seed=seed)
    pixels, nowhere = [visible()[room.goal]], 0
    for action in actions:
        before = room.world.measured_pose
        room.step(action)
        nowhere += action == FORWARD and np.hypot(*np.subtract(room.world.measured_pose, before)[:2]) < 0.05
        pixels.append(visible()[room.goal])
    return {**record, "actions": actions, "pixels": pixels, "strides_nowhere": int(nowhere)}


def aside(room: RoomEnv) -> float:
    """Metres from the straight line between the start and the goal to the nearest other object's centre."""
    start, shapes = room.world.start_pose, room.world.footprints
    goal = complex(shapes[room.goal].x_m - start.x_m, shapes[room.goal].y_m - start.y_m)
    # Ahead along the line, and to its side.
    others = [
        complex(shape.x_m - start.x_m, shape.y_m - start.y_m) / goal * abs(goal)
        for label, shape in enumerate(shapes)
        if label != room.goal
    ]
    return min(
        (abs(place.imag) for place in others if 0 < place.real < abs(goal)), default=room.config.room_side_m
    )


def table(records: list[dict[str, Any]], key: str, bins: Sequence[float]) -> list[dict[str, Any]]:
    """Episodes, successes, failures and timeouts by a number of each."""
    rows = []
    for low, high in pairwise(bins):
        inside = [record["outcome"] for record in records if low <= record[key] < high]
        counts = {name: inside.count(name) for name in ("success", "failure", "timeout")}
        rows.append({"from": low, "to": high, "episodes": len(inside), **counts})
    return rows


def missed(agents: dict[str, dict[str, Any]], room: RoomEnv) -> list[dict[str, Any]]:
    """Rooms that somebody missed, those that most did first: who, and the shortest way."""
    by_seed: dict[int, dict[str, Any]] = {}
    for name, found in agents.items():
        for record in found["timeouts"]:
            one = {key: record[key] for key in ("seed", "goal", "best_px", "aside_m")} | {"agents": []}
            by_seed.setdefault(record["seed"], one)["agents"].append(name)
    for seed, one in by_seed.items():
        room.reset(seed=seed)
        one["shortest"] = plan(room)
    return sorted(by_seed.values(), key=lambda one: (-len(one["agents"]), one["seed"]))


def draw(rooms: list[dict[str, Any]], room: RoomEnv, file: Path) -> None:
    """The best view from the start of some rooms, and below it each room from above with the shortest way."""
    size = 2.6 * len(rooms), 5.4
    figure, panels = plt.subplots(2, len(rooms), figsize=size, squeeze=False, layout="constrained")
    for one, (view, above) in zip(rooms, panels.T, strict=True):
        room.reset(seed=one["seed"])
        visible, views = Visible(room), []
        for _ in range(HEADINGS):
            views.append((visible()[room.goal], room.step(TURN_LEFT)[0]["image"]))
        _, frames = zip(*views, strict=True)
        best = max(range(HEADINGS), key=lambda heading: views[heading][0])
        view.imshow(frames[best - 1], interpolation="nearest")  # what was seen before the turn
        view.set_title(f"{one['goal'].replace('_', ' ')}, {one['best_px']} pixels", fontsize=9)
        view.axis("off")
        _from_above(above, room, one["seed"])
    figure.savefig(file, dpi=110)


def _from_above(axes: Axes, room: RoomEnv, seed: int) -> None:
    room.reset(seed=seed)
    for label, shape in enumerate(room.world.footprints):
        colour = "#093dbe" if label == room.goal else "#8b939e"
        size = 2 * shape.half_length_m, 2 * shape.half_width_m
        corner = shape.x_m - shape.half_length_m, shape.y_m - shape.half_width_m
        turn = np.degrees(shape.yaw_rad)
        axes.add_patch(Rectangle(corner, *size, angle=turn, rotation_point="center", color=colour))
    way = [room.world.measured_pose]
    for action in plan(room):
        room.step(action)
        way.append(room.world.measured_pose)
    axes.plot([pose.x_m for pose in way], [pose.y_m for pose in way], color="#e47711")
    axes.plot(way[0].x_m, way[0].y_m, "o", color="#e47711")
    half = room.config.half_side_m
    axes.set(xlim=(-half, half), ylim=(-half, half), aspect="equal", xticks=[], yticks=[])


def show(name: str, found: dict[str, Any]) -> None:
    """Print what an agent missed."""
    print(f"{name}, {found['trained_episodes']} episodes")
    for key, unit in (("pixels", "px"), ("aside", "m")):
        for row in found[key]:
            rate = row["success"] / max(row["episodes"], 1)
            print(f"from {row['from']:4} {unit:2} {row['episodes']:5} episodes  success {rate:6.1%}")
    blocked = sum(record["strides_nowhere"] >= BLOCKED for record in found["timeouts"])
    print(f"{len(found['timeouts'])} timeouts, {blocked} with {BLOCKED} strides or more that went nowhere")


def main() -> None:
    """Print what each agent missed, and how many missed the same; with --out write it all as JSON."""
    parser = argparse.ArgumentParser(
        description="Which goals are missed, by whom, and how much is seen of them."
    )
    parser.add_argument("agents", type=Path, nargs="+")
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--greedy", action="store_true")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--picture", type=Path, help="PNG of four rooms that most missed")
    options = parser.parse_args()
    agents: dict[str, dict[str, Any]] = {}
    for path in options.agents:
        trained = load_agent(path)
        records = watch(trained, options.episodes, options.seed, options.greedy)
        timeouts = [record for record in records if record["outcome"] == "timeout"]
        agents[path.name] = {
            "trained_episodes": trained.trained_episodes,
            "pixels": table(records, "best_px", BINS_PX),
            "aside": table(records, "aside_m", BINS_M),
            "timeouts": timeouts,
        }
        show(path.name, agents[path.name])
    room: RoomEnv = trained.task.new_env().unwrapped  # type: ignore[assignment]
    rooms = missed(agents, room)
    by_count = Counter(len(one["agents"]) for one in rooms)
    for count, number in sorted(by_count.items(), reverse=True):
        print(f"{number:5} rooms missed by {count} of {len(agents)}")
    if options.picture and rooms:
        draw(rooms[:4], room, options.picture)
    if options.out:
        meta = {**describe(), "command": shlex.join(["python", *sys.argv])}
        options.out.write_text(
            json.dumps({**meta, "agents": agents, "missed": rooms}) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main()
