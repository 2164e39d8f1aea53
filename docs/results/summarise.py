"""Keep what matters of runs as small JSON: `python docs/results/summarise.py OUT.json RUN...`.

For each run its command, commit and machine (`run.json`), its evaluations (`eval.json`), and its curve: of
every 1,000 episodes (`--every`) the mean success, failure and timeout rate, policy entropy in nats, minutes
so far and mean steps a second.
"""

import argparse
import json
from pathlib import Path

from vhs.eval import read_evaluations

COLUMNS = {
    "success": "rate/success",
    "failure": "rate/failure",
    "timeout": "rate/timeout",
    "entropy": "loss/entropy",
    "steps_per_s": "speed/steps_per_s",
}


def summarise(run: Path, every: int) -> dict[str, object]:
    """The short record of one run directory."""
    lines = (run / "log.jsonl").read_text(encoding="utf-8").splitlines()
    rows = [json.loads(line) for line in lines]
    curve, group = [], []
    for row in rows:
        group.append(row)
        if row["episodes"] // every > (curve[-1][0] // every if curve else 0):
            means = [sum(one.get(key) or 0.0 for one in group) / len(group) for key in COLUMNS.values()]
            curve.append(
                [row["episodes"], round(row["time/minutes"], 2), *(round(mean, 3) for mean in means)]
            )
            group = []
    made = json.loads((run / "run.json").read_text(encoding="utf-8"))
    evaluations = [
        {key: round(value, 4) if isinstance(value, float) else value for key, value in entry.items()}
        for entry in read_evaluations(run)
    ]
    columns = ["episodes", "minutes", *COLUMNS]
    return {**made, "evaluations": evaluations, "columns": columns, "curve": curve}


def main() -> None:
    """Write the records of all runs by name."""
    parser = argparse.ArgumentParser(description="Keep what matters of runs as small JSON.")
    parser.add_argument("out", type=Path)
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--every", type=int, default=1000)
    options = parser.parse_args()
    records = {run.name: summarise(run, options.every) for run in options.runs}
    # One line a run: a curve is read by programs, not by people.
    text = ",\n".join(f"{json.dumps(name)}: {json.dumps(record)}" for name, record in records.items())
    options.out.write_text("{\n" + text + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
