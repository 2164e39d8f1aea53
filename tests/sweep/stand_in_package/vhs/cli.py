"""A `vhs` for the runs of a sweep that does nothing in no time, and keeps a journal of what it was asked for.

`STAND_IN_S` is how long a training takes, `STAND_IN_FAILS` a piece of the name of a run whose training fails,
`STAND_IN_DIES` one of a run that is killed, `STAND_IN_BEST` a dotted key and the value that succeeds best.
A file `stand_in.json` beside the directory of the sweep says so to those whose environment is another's.
"""

import itertools
import json
import os
import signal
import sys
import time
from pathlib import Path


def note(event: str, **more: object) -> None:
    entry = {"event": event, "time": time.monotonic(), "pid": os.getpid(), "run": RUN.name, **more}
    with Path(SETTINGS["STAND_IN_JOURNAL"]).open("a") as file:
        file.write(json.dumps(entry) + "\n")


def save(episodes: int) -> None:
    (RUN / "checkpoints" / f"episode-{episodes:09d}").mkdir(parents=True, exist_ok=True)


def stop(number: int, frame: object) -> None:
    note("stopped")
    time.sleep(0.2)
    save(1)
    note("end")
    sys.exit(130)


def configure(settings: dict[str, str]) -> None:
    """Write `config.yaml`, JSON being YAML; a value that is no JSON is a text."""
    config: dict[str, object] = {}
    for key, text in settings.items():
        *sections, leaf = key.split(".")
        place = config
        for section in sections:
            place = place.setdefault(section, {})
        try:
            place[leaf] = json.loads(text)
        except ValueError:
            place[leaf] = text.strip("[]").split(", ") if text.startswith("[") else text
    RUN.mkdir(parents=True, exist_ok=True)
    (RUN / "config.yaml").write_text(json.dumps(config))
    (RUN / "run.json").write_text("{}")


def train() -> None:
    signal.signal(signal.SIGTERM, stop)
    given = [value for flag, value in itertools.pairwise(sys.argv) if flag == "--set"]
    settings = dict(value.split("=", 1) for value in given)
    configure(settings)
    cores = sorted(os.sched_getaffinity(0))
    note("train", cores=cores, omp=os.environ["OMP_NUM_THREADS"], parent=os.getppid())
    if SETTINGS.get("STAND_IN_FAILS", "nothing") in RUN.name:
        print("training\nvhs: the roof fell in\n")
        note("end")
        sys.exit(1)
    if SETTINGS.get("STAND_IN_DIES", "nothing") in RUN.name:
        print("12.3 min  500 episodes", flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(float(SETTINGS["STAND_IN_S"]))
    save(int(settings["train.episodes"]))
    note("end")


def success() -> float:
    key, _, best = SETTINGS.get("STAND_IN_BEST", "").partition("=")
    if not key:
        return 0.5
    section, leaf = key.split(".")
    return 1 - abs(float(best) - json.loads((RUN / "config.yaml").read_text())[section][leaf])


def evaluate() -> None:
    note("eval", cores=sorted(os.sched_getaffinity(0)), omp=os.environ["OMP_NUM_THREADS"])
    trained = max(int(path.name.removeprefix("episode-")) for path in (RUN / "checkpoints").iterdir())
    rates = {"success": success(), "failure": 0.25, "timeout": 0.25, "spl": 0.25}
    asked = {
        "trained_episodes": trained,
        "seed": int(sys.argv[sys.argv.index("--seed") + 1]),
        "greedy": "--greedy" in sys.argv,
        "episodes": int(sys.argv[sys.argv.index("--episodes") + 1]),
    }
    (RUN / "eval.json").write_text(json.dumps([rates | asked]))
    note("end")


RUN = Path(sys.argv[sys.argv.index("--out") + 1] if sys.argv[1] == "train" else sys.argv[2])
TOLD = RUN.parents[1] / "stand_in.json"
SETTINGS = os.environ | (json.loads(TOLD.read_text()) if TOLD.exists() else {})
train() if sys.argv[1] == "train" else evaluate()
