"""Ours and others on environments that nobody here wrote: success after the same minutes of one core.

Every run is a process that is stopped when it and its children have used so many seconds of a processor, so
that other work on the machine slows a run down and does not shorten it. Success is that of the last episodes
of training, actions sampled, each begun with a seed of its own.

    python benchmarks/elsewhere.py examples/tasks/grid --seconds 240 --seeds 3 --out elsewhere.json

A run that is in the file already is not run again.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from vhs.runs.directory import describe

HERE = Path(__file__).parent
METHODS = ("vhs", "pg", "a3c", "recurrent_ppo")
TICK_S = 1 / os.sysconf("SC_CLK_TCK")


def command(task: Path, method: str, seed: int, folder: Path) -> list[str]:
    """What trains a method on a task, and where it writes rows."""
    given = ["--config", str(task.with_suffix(".yaml"))]
    if task.with_suffix(".py").exists():
        given += ["--task", str(task.with_suffix(".py"))]
    if method == "recurrent_ppo":
        rows = ["--seed", str(seed), "--out", str(folder / "log.jsonl")]
        return [sys.executable, str(HERE / "recurrent_ppo.py"), *given, *rows]
    settings = [f"seed={seed}", "env.num_workers=0", "train.episodes=10000000", f"method.name={method}"]
    sets = [word for setting in settings for word in ("--set", setting)]
    return [sys.executable, "-m", "vhs", "train", *given, "--out", str(folder), *sets]


def processor_seconds(pid: int) -> float:
    """What a process, its threads and its children have used so far; 0 of one that is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        children = [
            int(child)
            for thread in Path(f"/proc/{pid}/task").iterdir()
            for child in (thread / "children").read_text().split()
        ]
    except OSError:
        return 0.0
    own = sum(map(int, fields[11:15])) * TICK_S  # its own and those of children that have ended
    return own + sum(map(processor_seconds, children))


def run(task: Path, method: str, seed: int, seconds: float) -> dict[str, Any]:
    """Train until the seconds are used up."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "run"
        if method == "recurrent_ppo":
            folder.mkdir()
        words = command(task, method, seed, folder)
        environment = os.environ | {"OMP_NUM_THREADS": "1"}
        with (Path(scratch) / "output").open("w") as output:
            process = subprocess.Popen(words, stdout=output, stderr=subprocess.STDOUT, env=environment)
        start, used, marks = time.monotonic(), 0.0, [(0.0, 0.0)]
        while used < seconds and process.poll() is None:
            time.sleep(0.5)
            used = max(used, processor_seconds(process.pid))
            marks.append(((time.monotonic() - start) / 60, used))
        process.send_signal(signal.SIGTERM)
        process.wait(120)
        log = folder / "log.jsonl"
        rows = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
        if used < seconds or not rows:
            raise RuntimeError(f"{words}: ended after {used:.0f} s\n{(Path(scratch) / 'output').read_text()}")
    begun = marks[-1][0] - rows[-1]["time/minutes"]  # imports and the trial of the task come first
    curve = [
        {
            "episodes": row["episodes"],
            "env_steps": row["env_steps"],
            "processor_s": round(_at(marks, row["time/minutes"] + max(begun, 0.0)), 1),
            "success": row["rate/success"],
            "failure": row["rate/failure"],
        }
        for row in rows
    ]
    return {"task": task.name, "method": method, "seed": seed, "seconds": seconds, "curve": curve}


def _at(marks: Sequence[tuple[float, float]], minutes: float) -> float:
    """Processor seconds at a time of the clock."""
    return next((used for clock, used in marks if clock >= minutes), marks[-1][1])


def main() -> None:
    """Run what is not in the file yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("tasks", nargs="+", type=Path, help="examples/tasks/NAME, without the ending")
    parser.add_argument("--methods", nargs="+", default=METHODS, choices=METHODS)
    parser.add_argument("--seconds", type=float, default=240.0, help="of a processor, of each run")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    found = json.loads(arguments.out.read_text()) if arguments.out.exists() else {"runs": []}
    found |= describe() | {"command": shlex.join(["python", *sys.argv])}
    done = {(one["task"], one["method"], one["seed"]) for one in found["runs"]}
    for seed in range(arguments.seeds):
        for task in arguments.tasks:
            for method in arguments.methods:
                if (task.name, method, seed) in done:
                    continue
                one = run(task, method, seed, arguments.seconds)
                last = one["curve"][-1]
                print(task.name, method, seed, last, flush=True)
                found["runs"].append(one)
                arguments.out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
