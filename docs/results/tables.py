"""The tables of the results, as Markdown, from the JSON files beside this script; `docs/generate.py` asks."""

import json
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from results import records
from results.records import (
    FINAL,
    METHODS,
    SHORT_METHODS,
    TASKS,
    VARIANTS,
    counted,
    curves,
    episodes_to,
    evaluations,
    load,
)
from vhs.eval.compare import WINDOW
from vhs.eval.paper import REFERENCE_RATE, SUCCESS

LONG, NEW_OBJECTS, OVERLOOKED = "long-2026-11.json", "new-objects-2026-11.json", "overlooked-task2.json"


def long_runs() -> str:
    """Success after 100,000 episodes beside the paper's."""
    return _beside_paper(evaluations(load(LONG)), METHODS)


def short_runs() -> str:
    """Success after 30,000 episodes beside the paper's."""
    return _beside_paper(evaluations(records.short_runs()), SHORT_METHODS)


def _beside_paper(found: dict[str, list[dict[str, float]]], methods: dict[str, str]) -> str:
    rows = []
    for method, shown in methods.items():
        cells = [shown]
        for task, paper in SUCCESS.items():
            runs = found.get(f"{task}-{method}")
            cells += [
                _seeds([run["success"] for run in runs]) if runs else "not run",
                _percent(paper[method]) if method in paper else "",
            ]
        rows.append(cells)
    return _table(["", *(f"Task {task[-1]} | paper" for task in TASKS)], rows)


def first_to_rate() -> str:
    """Episodes to the paper's criterion."""
    rows = []
    short, long = (records.short_runs(), SHORT_METHODS, "30,000"), (load(LONG), METHODS, "100,000")
    for runs, methods, length in (short, long):
        found = curves(runs)
        for method, shown in methods.items():
            reached = [_reached(REFERENCE_RATE, found.get(f"{task}-{method}", [])) for task in TASKS]
            rows.append([f"{shown}, runs of {length}", *reached])
    return _table(["", "Task 1", "Task 2", "Task 3"], rows)


def relabelling() -> str:
    """What is relabelled, on Task 2: episodes to two rates, and success in the end."""
    runs_of = load(FINAL)
    found, ends = curves(runs_of), evaluations(runs_of)
    rows = []
    for variant, shown in VARIANTS.items():
        runs = found[f"task2-{variant}"]
        success = _seeds([run["success"] for run in ends[f"task2-{variant}"]])
        rows.append([shown, _reached(REFERENCE_RATE, runs), _reached(0.9, runs), success])
    return _table(["relabelled", "74.3 % at", "90 % at", "success in the end"], rows)


def shipped() -> str:
    """The agents that come with the package."""
    rows = []
    for task in TASKS:
        entries = json.loads((_ROOT / "pretrained" / task / "eval.json").read_text(encoding="utf-8"))
        for greedy in (False, True):
            rooms = counted(entries, greedy=greedy)
            means = {key: float(np.mean([room[key] for room in rooms])) for key in _SHIPPED}
            each = " / ".join(f"{100 * room['success']:.1f}" for room in rooms)
            rows.append([
                f"Task {task[-1]}, {'`--greedy`' if greedy else 'sampled'}",
                f"{_percent(means['success'])} ({each})",
                _percent(means["failure"]), _percent(means["timeout"]), f"{means['spl']:.3f}",
                f"{means['steps']:.1f} ({means['optimal_steps']:.1f})",
            ])  # fmt: skip
    return _table(["", "success (rooms 0 / 1 / 2)", "failure", "timeout", "SPL", "steps (shortest)"], rows)


def overlooked() -> str:
    """Success by how much of the goal can be seen: of the shipped agent, and of all that were asked."""

    def shown(low: int, high: int) -> str:
        return (
            f"below {high}" if low == 0 else f"{low} and more" if high == 84 * 84 else f"{low} to {high - 1}"
        )

    return _by("pixels", "pixels of the goal in the best view", shown)


def aside() -> str:
    """Success by how far another object stands from the straight line to the goal."""
    return _by("aside", "metres", _metres)


def _metres(low: float, high: float) -> str:
    return f"below {high:g}" if low == 0 else f"{low:g} and more" if high == 10 else f"{low:g} to {high:g}"


def _by(key: str, title: str, shown: Callable[[Any, Any], str]) -> str:
    agents = [agent[key] for agent in load(OVERLOOKED)["agents"].values()]
    rows = []
    for places in zip(*agents, strict=True):
        first, rates = places[0], [row["success"] / row["episodes"] for row in places]
        each = [_percent(rates[0]), _percent(float(np.mean(rates)))]
        rows.append([shown(first["from"], first["to"]), str(first["episodes"]), *each])
    return _table([title, "episodes", "shipped", "all"], rows)


def missed() -> str:
    """How many rooms were missed by how many agents."""
    found = load(OVERLOOKED)
    counts = Counter(len(room["agents"]) for room in found["missed"])
    each = range(len(found["agents"]), 0, -1)
    return _table(["missed by", *map(str, each)], [["rooms", *(str(counts[count]) for count in each)]])


def localisation() -> str:
    """With and without hindsight localisation: success on the way, and in rooms that training never saw."""
    return _on_the_way(load("localisation-2026-11.json"), {"base": "without", "m1": "with"}, *_OF_12000)


def replay() -> str:
    """With and without episodes that are imitated again, likewise."""
    found = load("localisation-2026-11.json") | load("replay-2026-11.json")
    return _on_the_way(found, {"m1": "once", "replay": "again"}, *_OF_12000)


def memory() -> str:
    """Before and after still steps were left out and the memory was asked, likewise."""
    names = {"before": "before", "after": "after"}
    marks, title = (3_000, 4_000, 5_000), "after 30,000, rooms of seeds 0 to 2"
    return _on_the_way(records.memory_runs(), names, marks, records.ROOMS, title)


def again() -> str:
    """Before and after episodes could last longer and missed seeds began again, likewise."""
    names = {"before": "before", "after": "after"}
    marks, title = (2_000, 3_000, 4_000), "after 30,000, rooms of seeds 0 to 2"
    return _on_the_way(records.again_runs(), names, marks, records.ROOMS, title)


def aside_again() -> str:
    """Success by how far another object stands from the straight line to the goal, before and after."""
    agents = load("overlooked-again.json")["agents"]
    found = {
        shown: [agent["aside"] for name, agent in agents.items() if name.startswith(shown)]
        for shown in ("before", "after")
    }
    rows = []
    for number, place in enumerate(found["after"][0]):
        each = [
            _percent(float(np.mean([run[number]["success"] / run[number]["episodes"] for run in runs])))
            for runs in found.values()
        ]
        rows.append([_metres(place["from"], place["to"]), str(place["episodes"]), *each])
    return _table(["metres", "episodes", *found], rows)


def ways() -> str:
    """Where the steps of successes go, before and after."""
    rows = []
    for name, agent in sorted(load("ways-2026-11.json")["agents"].items(), key=lambda item: item[0][::-1]):
        steps = (f"{agent[key]:.2f}" for key in ("search", "after", "idle", "plan"))
        rows.append([name.replace("-seed", ", seed "), *steps, f"{agent['spl_of_successes']:.3f}"])
    head = ["until the goal is seen", "after that", "of these change nothing", "a plan from there", "SPL"]
    return _table(["steps of a success", *head], rows)


_OF_12000: tuple[Any, ...] = ((3_000, 5_000, 7_000), (9,), "after 12,000, rooms of seed 9")


def _on_the_way(
    found: dict[str, Any], names: dict[str, str], marks: Sequence[int], rooms: Sequence[int], title: str
) -> str:
    """Up to three seeds of each name: success before some marks, and in the end in some rooms."""
    rows = []
    for name, shown in (
        (f"{name}-seed{seed}", f"{shown}, seed {seed}") for seed in range(3) for name, shown in names.items()
    ):
        run = found.get(name)
        if run is None:
            continue
        curve = curves({name: run})[name.rpartition("-seed")[0]]
        at = [_window(curve[0], mark) for mark in marks]
        ends = counted(run["evaluations"], greedy=False, rooms=rooms)
        success, spl = (np.mean([entry[key] for entry in ends]) if ends else 0 for key in ("success", "spl"))
        end = f"{_percent(float(success))}, SPL {spl:.2f}" if ends else ""
        rows.append([shown, *at, _reached(REFERENCE_RATE, curve, 500), end])
    head = ["", *(f"at {mark:,}" for mark in marks), "74.3 % at", title]
    return _table(head, rows)


def shown() -> str:
    """What an agent reaches that is asked for an object which it was only shown."""
    rows = []
    for record in load(NEW_OBJECTS).values():
        counts = sorted({one["pictures"] for one in record["shown"]})
        draws = [[one for one in record["shown"] if one["pictures"] == count] for count in counts]
        reached = {
            name: np.mean([one["reached"][name] for one in draws[-1]]) / _episodes(draws[-1][0])
            for name in record["known"]["reached"]
            if name != record["left_out"]
        }
        most = max(reached, key=lambda name: reached[name])
        rows.append([
            records.described(record),
            *(_percent(record[asked]["success"]) for asked in ("known", "not_shown")),
            *(_percent(float(np.mean([one["success"] for one in rates]))) for rates in draws),
            f"{most.replace('_', ' ')}, {_percent(reached[most])}",
        ])  # fmt: skip
    head = [
        "left out",
        "asked for the four",
        "for the fifth, not shown",
        "1 picture",
        "5",
        "20",
        "in its place",
    ]
    return _table(head, rows)


def learned() -> str:
    """How an object that was left out is learned, with the weights kept and from scratch."""
    marks, rows = (500, 1000, 2000, 3000, 4000), []
    for record in load(NEW_OBJECTS).values():
        for asked, name in (("new", record["left_out"]), ("known", "the other four")):
            for kind, said in records.BEGUN.items():
                at = {
                    one["episodes"]: one[asked]["success"] for one in record.get("learned", {}).get(kind, ())
                }
                if at:
                    rows.append([f"{name}, {said}", *(_percent(at[mark]) for mark in marks)])
    return _table(["", *(f"at {mark:,}" for mark in marks)], rows)


def _episodes(rates: dict[str, Any]) -> int:
    """How many were played."""
    return round(sum(rates["reached"].values()) / (rates["success"] + rates["failure"]))


def elsewhere() -> str:
    """Ours and others on environments that nobody here wrote, after the same minutes of one core."""
    found, rows = records.elsewhere(), []
    for task, shown in records.ELSEWHERE.items():
        cells = [shown]
        for method in records.RIVALS:
            runs = found.get((task, method), [])
            ends = [records.at_the_end(run) for run in runs]
            episodes = np.mean([run[-1, 2] for run in runs]) if runs else 0
            spread = f" ± {100 * np.std(ends, ddof=1):.1f}" if len(ends) > 1 else ""
            number = f"{100 * np.mean(ends):.1f}{spread} % ({len(ends)})" if ends else ""
            cells.append(f"{number}, {episodes:,.0f}" if ends else "")
        rows.append(cells)
    return _table(["", *(f"{shown}, episodes" for shown in records.RIVALS.values())], rows)


def profile() -> str:
    """Microseconds of a training step by part, with and without bfloat16."""
    machines = [load(name) for name in ("profile-bfloat16-2026-11.json", "profile-2026-11.json")]
    parts = sorted(machines[0]["us_per_step"], key=lambda part: -machines[0]["us_per_step"][part])
    rows = []
    for part in parts:
        cells = [part]
        for machine in machines:
            us = machine["us_per_step"]
            cells.append(f"{us[part]:.0f} ({us[part] / sum(us.values()):.0%})")
        rows.append(cells)
    rows.append(["steps per second", *(f"{machine['steps_per_s']:.0f}" for machine in machines)])
    return _table(["microseconds per step", "bfloat16", "float32"], rows)


_ROOT = Path(__file__).parents[2]
_SHIPPED = ("success", "failure", "timeout", "spl", "steps", "optimal_steps")


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    columns = " | ".join(head)
    lines = [f"| {columns} |", "|" + "---|" * (columns.count("|") + 1)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _whole(cell: str) -> str:
    """A number that no line breaks."""
    return cell.replace(" ", "\N{NO-BREAK SPACE}")


def _seeds(shares: Sequence[float]) -> str:
    """Mean and deviation over seeds, and how many there are."""
    deviation = f" ± {100 * np.std(shares, ddof=1):.1f}" if len(shares) > 1 else ""
    return _whole(f"{100 * np.mean(shares):.1f}{deviation} % ({len(shares)})")


def _reached(rate: float, runs: list[Any], window: int = WINDOW) -> str:
    """Episodes to a rate, mean and deviation over the seeds, or how many of them reached it."""
    if not runs:
        return "not run"
    reached = episodes_to(rate, runs, window)
    if len(reached) < len(runs):
        return f"{len(reached)} of {len(runs)} seeds" if len(reached) else "not reached"
    deviation = f" ± {reached.std(ddof=1):,.0f}" if len(reached) > 1 else ""
    return _whole(f"{reached.mean():,.0f}{deviation} ({len(reached)})")


def _window(curve: Any, end: int) -> str:
    """Success in the 500 episodes before `end`."""
    inside = (curve[:, 0] > end - 500) & (curve[:, 0] <= end)
    return f"{100 * curve[inside, 1].mean():.0f} %"
