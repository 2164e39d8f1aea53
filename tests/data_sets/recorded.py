"""Buffers of every kind with a few episodes, and what must be equal of two."""

from __future__ import annotations

from typing import Any

import numpy as np

import vhs

KINDS: dict[str, dict[str, Any]] = {
    "labels": {"num_goals": 3, "interactions": {1: 0, 2: 1}, "num_actions": 4},
    "observations": {"goals": "observations", "num_goals": 2, "first_action": 5},
    "channels": {"stacking": "channels", "num_goals": 3},
    "vectors": {
        "goals": "vectors",
        "goal_shape": (2,),
        "goal_dtype": "float64",
        "action_dim": 3,
        "fields": {
            "compass": vhs.Field((2,)),
            "joints": vhs.Field((3,), "float64", stacked=True),
            "skill": vhs.Field((), "int64", per="step"),
        },
    },
}


def recorded(kind: str, frame_shape: tuple[int, ...] = (32, 36, 3), seed: int = 0) -> vhs.EpisodeBuffer:
    """Three episodes of 1 to 4 random steps."""
    shared: dict[str, Any] = {
        "num_streams": 1,
        "max_episode_steps": 4,
        "capacity_steps": 40,
        "frame_stack": 2,
    }
    buffer = vhs.EpisodeBuffer(frame_shape, **shared, **KINDS[kind])
    rng = np.random.default_rng(seed)

    def picture() -> Any:
        return rng.integers(0, 256, frame_shape).astype(np.uint8)

    def shown() -> dict[str, Any]:
        given: dict[str, Any] = {}
        if buffer.goals == "vectors":
            given["achieved_goal"] = rng.normal(size=2)
            given["fields"] = {"compass": rng.normal(size=2).astype(np.float32), "joints": rng.normal(size=3)}
        return given

    for number, (length, outcome) in enumerate([(1, "success"), (4, "timeout"), (3, "failure")]):
        first = shown()
        if buffer.goals == "vectors":
            first["desired_goal"] = rng.normal(size=2)
        if buffer.goals == "observations":
            first["desired_goal"] = rng.integers(0, 256, buffer.goal_shape).astype(np.uint8)
        interaction = number % max(buffer.num_interactions, 1)
        buffer.begin(
            0,
            rng.integers(0, 256, frame_shape).astype(np.uint8),
            number % buffer.num_goals,
            interaction,
            **first,
        )
        for t in range(length):
            action = (
                rng.normal(size=3).astype(np.float32) if buffer.action_dim else buffer.first_action + t % 3
            )
            after = shown()
            if buffer.goals == "vectors":
                after["fields"]["skill"] = t + 7
            buffer.append(0, action, float(rng.normal()), float(rng.normal()), picture(), **after)
        buffer.finish(0, outcome)
    return buffer


def assert_equal(one: vhs.EpisodeBuffer, other: vhs.EpisodeBuffer) -> None:
    """Both give the same whole episodes, to the byte."""
    assert len(one) == len(other)
    mine, theirs = one.gather(one.ids), other.gather(other.ids)
    for name in dir(mine):
        if name.startswith("_") or name in ("ids", "hindsight"):
            continue
        wanted, found = getattr(mine, name), getattr(theirs, name)
        parts = [(wanted, found)] if name != "fields" else [(wanted[key], found[key]) for key in wanted]
        for left, right in parts:
            assert (left is None) == (right is None), name
            if left is not None:
                assert left.dtype == right.dtype, name
                np.testing.assert_array_equal(left, right, err_msg=name)
