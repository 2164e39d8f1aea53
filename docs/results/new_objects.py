"""An object that an agent was never asked for: `python docs/results/new_objects.py milk --out FILE`.

An agent is trained on Task 2 without being asked for one object, which stands in the room all the same
(`env.room.goals`). Shown pictures of it, it is asked for that object alone, without a gradient step; the
pictures are what an oracle sees last that walks to it, each in a room of its own that is no room of the
evaluation. Then two runs are asked for all: one begins where the agent stands (`--from`), one from scratch.
"""

import argparse
import json
import shlex
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vhs import Task
from vhs.acting.episodes import Episodes
from vhs.acting.policy import Policy, load_agent
from vhs.acting.seeds import episode_seeds
from vhs.acting.setup import make_buffer, make_env
from vhs.acting.stepping import LocalStepping
from vhs.envs import OBJECT_NAMES, plan
from vhs.envs.task import load_room
from vhs.runs.directory import describe, read_meta

TASK, PICTURES = "task2", (1, 5, 20)
MARKS = (250, 500, 1000, 1500, 2000, 3000, 4000)
"""Episodes after which the two runs that are asked for all are evaluated."""
ROOMS, ROOMS_OF_PICTURES = 9, 1000
"""Seeds of the rooms of the evaluation, and of the first draw of pictures; each further draw has the next."""


def asking_for(*names: str) -> Task:
    """The task, of which instructions ask for these objects alone."""
    return load_room(TASK, room={"goals": names})


def pictures_of(name: str, count: int, seed: int) -> NDArray[np.uint8]:
    """What is seen last in `count` episodes that reach an object, uint8 [count, 84, 84, 3]."""
    env, found = asking_for(name).new_env(), []
    for room_seed in islice(episode_seeds(seed, purpose=1), count):
        env.reset(seed=room_seed)
        for action in plan(env):
            observation, *_ = env.step(action)
        found.append(observation["image"])
    return np.stack(found)


def asked(policy: Policy, task: Task, episodes: int) -> dict[str, Any]:
    """Rates of an agent on a task that asks for some of its goals, and how often it reached which object."""
    policy = replace(policy, task=task)
    envs = [make_env(task, policy.spec) for _ in range(16)]
    buffer = make_buffer(policy.config, policy.spec, len(envs), len(envs))
    seeds = islice(episode_seeds(ROOMS, purpose=1), episodes)
    played = Episodes(LocalStepping(envs), policy.player(buffer, ROOMS, greedy=False), buffer, seeds)
    played.start()
    ended = []
    while not played.is_done:
        ended += played.step()
    outcomes = Counter(episode.outcome.name.lower() for episode in ended)
    reached = Counter(episode.reached for episode in ended)
    return {
        **{name: round(outcomes[name] / episodes, 4) for name in ("success", "failure", "timeout")},
        "reached": {name: reached[label] for label, name in enumerate(OBJECT_NAMES)},
    }


def shown(run: Path, left: str, draws: int, episodes: int) -> list[dict[str, Any]]:
    """How an agent does when it is asked for an object that it was shown."""
    found = []
    for count in PICTURES:
        for draw in range(draws):
            policy = load_agent(run)
            policy.show(left, pictures_of(left, count, ROOMS_OF_PICTURES + draw))
            rates = asked(policy, asking_for(left), episodes)
            found.append({"pictures": count, "draw": draw, **rates})
            print(left, found[-1], flush=True)
    return found


def train(run: Path, episodes: int, schedule: int, options: list[str]) -> None:
    """Train a run so far, or go on with it."""
    numbers = {"train.episodes": episodes, "train.schedule_episodes": schedule, "env.num_workers": 0}
    words = [word for key, value in numbers.items() for word in ("--set", f"{key}={value}")]
    command = [sys.executable, "-m", "vhs", "train", "--config", TASK, "--out", str(run), *words, *options]
    subprocess.run(command, check=True)


def learned(run: Path, left: str, options: list[str], episodes: int) -> list[dict[str, Any]]:
    """How a run that is asked for all objects comes to know one of them."""
    others = [name for name in OBJECT_NAMES if name != left]
    found = []
    for mark in MARKS:
        train(run, mark, MARKS[-1], options)
        new, known = (asked(load_agent(run), asking_for(*names), episodes) for names in ((left,), others))
        found.append({"episodes": mark, "new": new, "known": known})
        print(run, found[-1], flush=True)
    return found


def main() -> None:
    """Train what is not trained yet, measure, and add a record to a file."""
    parser = argparse.ArgumentParser(description="An object that an agent was never asked for.")
    parser.add_argument("left", choices=OBJECT_NAMES, help="the object that is left out")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="of all trainings")
    parser.add_argument("--name", default="", help="of this variant, in the names of runs and of the record")
    parser.add_argument("--trained", type=int, default=12_000, help="episodes before anything is shown")
    parser.add_argument("--draws", type=int, default=5, help="of pictures, for each number of them")
    parser.add_argument("--shown-only", action="store_true")
    parser.add_argument("--episodes", type=int, default=300)
    parser.add_argument("--runs", type=Path, default=Path("runs/new-objects"))
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    name = "-".join(filter(None, (options.left, options.name, f"seed{options.seed}")))
    set_ = [word for text in (f"seed={options.seed}", *options.set) for word in ("--set", text)]
    others = [other for other in OBJECT_NAMES if other != options.left]
    run = options.runs / f"without-{name}"
    train(run, options.trained, options.trained, [*set_, "--set", f"env.room.goals=[{', '.join(others)}]"])
    record = {
        **describe(),
        "command": shlex.join(["python", *sys.argv]),
        "trained": read_meta(run),
        "left_out": options.left,
        "known": asked(load_agent(run), asking_for(*others), options.episodes),
        "not_shown": asked(load_agent(run), asking_for(options.left), options.episodes),
        "shown": shown(run, options.left, options.draws, options.episodes),
    }
    if not options.shown_only:
        starts = {"from": ["--from", str(run)], "scratch": []}
        record["learned"] = {
            kind: learned(options.runs / f"{kind}-{name}", options.left, [*set_, *start], options.episodes)
            for kind, start in starts.items()
        }
    records = json.loads(options.out.read_text(encoding="utf-8")) if options.out.exists() else {}
    records[name] = record
    text = ",\n".join(f"{json.dumps(key)}: {json.dumps(value)}" for key, value in sorted(records.items()))
    options.out.write_text("{\n" + text + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
