"""The committed files of each format, written by the version that first had it, and what they must read as.

    python tests/formats/make.py    # adds the files of this version; an old one is never written again

`tests/core/test_formats.py` reads every file and compares its contents with the digest beside it.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np

import vhs

HERE = Path(__file__).parent
DIGESTS = HERE / "digests.json"
FRAME = (3, 2, 3)
LENGTHS = (1, 3, 2, 4, 2)
SETTINGS = ("num_streams", "max_episode_steps", "capacity_steps", "frame_stack", "frame_shape", "dtype")
GOALS = ("goals", "goal_shape", "goal_dtype", "num_goals", "num_interactions", "action_dim")
ARRAYS = (
    *("observations", "desired_goals", "achieved_goals", "ids", "offsets", "lengths", "actions", "rewards"),
    *("values", "mask", "terminated", "goals", "interactions", "outcomes"),
)


def digest(*parts: object) -> str:
    """SHA-256 of arrays (type, shape and bytes) and of whatever else has a faithful `str`."""
    found = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            found.update(f"{part.dtype.str} {part.shape} ".encode())
            found.update(np.ascontiguousarray(part).tobytes())
        else:
            found.update(f"{part} ".encode())
    return found.hexdigest()


def of_goals(path: Path) -> str:
    """What a goal store holds, and what it draws next."""
    store = vhs.GoalStore.load(path)
    kept = (store.num_classes, store.observation_shape, store.capacity_per_class, store.counts)
    drawn = [*store.sample(16), store.sample_class(0, 8), *store.sample(5, balanced=False)]
    for _ in range(4):  # over the oldest image of a full class
        store.push(np.full(store.observation_shape, 9, np.uint8), 0)
        drawn.append(store.sample_class(0, 8))
    return digest(*kept, *drawn)


def of_episodes(path: Path) -> str:
    """What an episode buffer holds, what its episodes did, and what it draws next."""
    buffer = vhs.EpisodeBuffer.load(path)
    kept = [getattr(buffer, name) for name in (*SETTINGS, *GOALS, "num_steps", "rng_state")]
    batch = buffer.gather(buffer.ids)
    hindsight = vhs.relabel(batch, rng=0, probability=1.0, on=tuple(vhs.Outcome))
    steps = buffer.sample_transitions(9, "future", ratio=4)
    return digest(
        *kept,
        *(getattr(batch, name) for name in ARRAYS),
        *(part for name, field in batch.fields.items() for part in (name, buffer.fields[name], field)),
        *(hindsight.goal_rows, hindsight.interactions, hindsight.selected),
        *(steps.ids, steps.steps, steps.goals, steps.goal_steps, steps.interactions, steps.rewards),
        buffer.sample_episodes(7).ids,
    )


def of_priorities(path: Path) -> str:
    """As `of_episodes`, and what priorities draw."""
    batch = vhs.EpisodeBuffer.load(path).sample_transitions(20, beta=1.0)
    return digest(of_episodes(path), batch.ids, batch.steps, batch.weights)


def make_goals(path: Path) -> None:
    """Three classes of stacked images: one full and wrapped, one half full, one empty."""
    store = vhs.GoalStore(3, (2, *FRAME), 4, seed=11)
    rng = np.random.default_rng(0)
    for label in (0, 0, 1, 0, 0, 1, 0):
        store.push(rng.integers(0, 256, (2, *FRAME), dtype=np.uint8), label)
    store.sample(3)
    store.save(path)


def make_labels(path: Path) -> None:
    """Numbered actions, goals by class, three interactions, not in the order of their actions."""
    record(path, {"num_goals": 4, "num_actions": 6, "interactions": {5: 0, 3: 2, 4: 1}})


def make_depths(path: Path) -> None:
    """Actions that begin below 0, goals that are truth values, frames of 16 bits."""
    goal = {"goals": "vectors", "goal_shape": (3,), "goal_dtype": "bool"}
    record(path, {**goal, "dtype": "uint16", "num_actions": 6, "first_action": -2})


def make_observations(path: Path) -> None:
    """Numbered actions, goals that are pictures, frames in a scratch file."""
    record(path, {"goals": "observations", "backing": path.with_suffix(".scratch")})


def make_channels(path: Path) -> None:
    """Frames stacked as the channels of one picture, any number of actions."""
    record(path, {"stacking": "channels"})


def make_vectors(path: Path) -> None:
    """Continuous actions, goals that are vectors, frames of another type."""
    goal = {"goals": "vectors", "goal_shape": (2,), "goal_dtype": "float64"}
    record(path, {**goal, "action_dim": 2, "dtype": "float32", "frame_stack": 1})


def make_fields(path: Path) -> None:
    """Further arrays: of observations, of their stacks, of steps, and single numbers."""
    fields = {
        "compass": vhs.Field((2,), "float64"),
        "depth": vhs.Field((2, 3), "uint8", stacked=True),
        "log_prob": vhs.Field(per="step"),
        "é": vhs.Field(dtype="int16", per="step"),
    }
    record(path, {"fields": fields})


def make_priorities(path: Path) -> None:
    """Steps with priorities, some of them given anew."""
    record(path, {"priority_exponent": 0.5})


def record(path: Path, kind: dict[str, object]) -> None:
    """Five short episodes, the first ones evicted, and one on another stream that is still open."""
    sizes = {"num_streams": 2, "max_episode_steps": 4, "capacity_steps": 10, "seed": 5}
    buffer = vhs.EpisodeBuffer(FRAME, **sizes, **kind)  # type: ignore[arg-type]
    rng = np.random.default_rng(1)

    def frame() -> np.ndarray:
        return rng.integers(0, 256, FRAME).astype(buffer.dtype)

    def further(*of: str) -> dict[str, object]:
        declared = {name: field for name, field in buffer.fields.items() if field.per in of}
        made = {name: rng.integers(0, 100, field.shape) for name, field in declared.items()}
        return (
            {"fields": {name: made[name].astype(declared[name].dtype) for name in made}} if declared else {}
        )

    def begin(stream: int, number: int) -> None:
        told = {} if buffer.goals == "labels" else {"desired_goal": goal()}
        goals, interactions = buffer.num_goals, max(1, buffer.num_interactions)
        beside = {**told, **reached(), **further("observation")}
        buffer.begin(stream, frame(), number % goals, number % interactions, **beside)

    def goal() -> np.ndarray:
        return rng.integers(0, 256, buffer.goal_shape).astype(buffer.goal_dtype)

    def reached() -> dict[str, np.ndarray]:
        return {"achieved_goal": goal()} if buffer.goals == "vectors" else {}

    def append(number: int, is_last: bool) -> None:
        # An episode ends with an interaction where there are any.
        numbered = 3 + number % 3 if is_last and buffer.num_interactions else int(rng.integers(3))
        action = rng.normal(size=buffer.action_dim) if buffer.action_dim else numbered
        beside = {**reached(), **further("observation", "step")}
        buffer.append(0, action, float(rng.normal()), float(rng.normal()), frame(), **beside)

    begin(1, 0)  # stays open
    for number, length in enumerate(LENGTHS):
        begin(0, number)
        for step in range(length):
            append(number, step == length - 1)
        buffer.finish(0, vhs.Outcome(number % 3), terminated=number % 2 == 0)
    steps = buffer.sample_transitions(3)
    if buffer.priority_exponent is not None:
        buffer.update_priorities(steps.ids, steps.steps, [4.0, 0.25, 9.0])
    buffer.save(path)


FILES = {
    "goals-1.vhs": (make_goals, of_goals),
    "episodes-4-labels.vhs": (make_labels, of_episodes),
    "episodes-4-observations.vhs": (make_observations, of_episodes),
    "episodes-4-vectors.vhs": (make_vectors, of_episodes),
    "episodes-4-channels.vhs": (make_channels, of_episodes),
    "episodes-4-depths.vhs": (make_depths, of_episodes),
    "episodes-4-fields.vhs": (make_fields, of_episodes),
    "episodes-4-priorities.vhs": (make_priorities, of_priorities),
}


def main() -> None:
    """Write the files that are missing, and their digests."""
    digests = json.loads(DIGESTS.read_text(encoding="utf-8")) if DIGESTS.exists() else {}
    for name, (make, read) in FILES.items():
        if not (HERE / name).exists():
            make(HERE / name)
            digests[name] = read(HERE / name)
    DIGESTS.write_text(json.dumps(digests, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
