"""How often a goal is found, by how much of it can be seen: `python docs/results/overlooked.py AGENT`.

AGENT is a run or an exported agent. For each evaluation episode: the pixels of the goal in the best of the
eight views from the start, the outcome, and of a timeout the pixels of the goal in each view and the strides
that went nowhere.
"""

import argparse
import json
import shlex
import sys
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from visible import Visible

from vhs import Outcome
from vhs.acting.episodes import Episodes
from vhs.acting.policy import Policy, load_agent
from vhs.acting.seeds import episode_seeds
from vhs.acting.setup import make_buffer, make_env
from vhs.acting.stepping import LocalStepping
from vhs.envs import OBJECT_NAMES, RoomEnv
from vhs.runs.directory import describe

BINS_PX = (0, 25, 50, 75, 100, 150, 84 * 84)
HEADINGS = 8
BLOCKED = 3
"""Strides that went nowhere of a timeout that counts as blocked, at least."""
FORWARD, TURN_LEFT = 0, 1


def watch(trained: Policy, episodes: int, seed: int, greedy: bool) -> list[dict[str, Any]]:
    """Play as `vhs eval` does, then look at each episode again."""
    envs = [make_env(trained.task, trained.spec) for _ in range(16)]
    buffer = make_buffer(trained.config, trained.spec, len(envs), len(envs))
    seeds = islice(episode_seeds(seed, purpose=1), episodes)
    played = Episodes(LocalStepping(envs), trained.player(buffer, seed, greedy), buffer, seeds)
    played.start()
    room: RoomEnv = trained.task.new_env().unwrapped  # type: ignore[assignment]
    visible = Visible(room)
    records = []
    while not played.is_done:
        for ended in played.step():
            actions = buffer.gather(np.array([ended.id], dtype=np.int64)).actions[0].tolist()
            records.append(_look(room, visible, ended.seed, actions, Outcome(ended.outcome)))
    return records


def _look(room: RoomEnv, visible: Visible, seed: int, actions: list[int], outcome: Outcome) -> dict[str, Any]:
    room.reset(seed=seed)
    best = visible()[room.goal]
    for _ in range(HEADINGS - 1):
        room.step(TURN_LEFT)
        best = max(best, visible()[room.goal])
    record = {"seed": seed, "goal": OBJECT_NAMES[room.goal], "outcome": outcome.name.lower(), "best_px": best}
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


def table(records: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Episodes, successes and timeouts by the goal's pixels in the best view from the start."""
    rows = []
    for low, high in pairwise(BINS_PX):
        inside = [record["outcome"] for record in records if low <= record["best_px"] < high]
        counts = {name: inside.count(name) for name in ("success", "failure", "timeout")}
        rows.append({"pixels": [low, high], "episodes": len(inside), **counts})
    return rows


def main() -> None:
    """Print the table; with --out write it, and every timeout, as JSON."""
    parser = argparse.ArgumentParser(description="How much of a goal can be seen, and how often it is found.")
    parser.add_argument("agent", type=Path)
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--greedy", action="store_true")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    trained = load_agent(options.agent)
    records = watch(trained, options.episodes, options.seed, options.greedy)
    rows = table(records)
    for row in rows:
        low, high = row["pixels"]
        rate = row["success"] / max(row["episodes"], 1)
        print(f"{low:5}..{high - 1:<5} px {row['episodes']:5} episodes  success {rate:6.1%}")
    timeouts = [record for record in records if record["outcome"] == "timeout"]
    blocked = sum(record["strides_nowhere"] >= BLOCKED for record in timeouts)
    print(f"{len(timeouts)} timeouts, {blocked} with {BLOCKED} strides or more that went nowhere")
    if options.out:
        command = shlex.join(["python", *sys.argv])
        meta = {**describe(), "command": command, "trained_episodes": trained.trained_episodes, "table": rows}
        options.out.write_text(json.dumps({**meta, "timeouts": timeouts}) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
