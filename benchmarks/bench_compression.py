"""What compressing frames one by one saves in memory, and costs when they are stored and drawn.

Frames of rooms (84 x 84 RGB, textured walls) and, where minigrid and ale-py are installed, of BabyAI (its
full picture at about 84 x 84) and of Breakout (210 x 160 RGB, every fourth): episodes of chance in each, in a
buffer of memory and one with `backing="lz4"`.

    python benchmarks/bench_compression.py                  # a table
    python benchmarks/bench_compression.py --json out.json  # and the numbers as JSON
    python benchmarks/bench_compression.py --quick          # a smoke test: few frames and repeats
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

import vhs
import vhs.envs  # registers the rooms

LONGEST, BATCH = 50, 64
Frames = list[NDArray[np.uint8]]


def episodes(env: gymnasium.Env[Any, Any], picture: Callable[[Any], NDArray[np.uint8]]) -> Iterator[Frames]:
    """Episodes of chance, of at least one step."""
    env.action_space.seed(0)
    for seed in range(1_000_000):
        frames = [picture(env.reset(seed=seed)[0])]
        while len(frames) <= LONGEST:
            seen, _, terminated, truncated, _ = env.step(env.action_space.sample())
            frames.append(picture(seen))
            if terminated or truncated:
                break
        yield frames


def kinds() -> dict[str, Iterator[Frames]]:
    """Environments that are there."""
    rooms = gymnasium.make("vhs/InteractiveObjectNav-v0")
    found = {"rooms": episodes(rooms, lambda seen: seen["image"])}
    with suppress(ImportError):
        import minigrid  # noqa: F401 - registers BabyAI
        from minigrid.wrappers import RGBImgObsWrapper

        grid = RGBImgObsWrapper(gymnasium.make("BabyAI-GoToObj-v0"), tile_size=12)
        found["BabyAI"] = episodes(grid, lambda seen: seen["image"])
    with suppress(ImportError):
        import ale_py

        gymnasium.register_envs(ale_py)
        found["Breakout"] = episodes(gymnasium.make("ALE/Breakout-v5"), lambda seen: seen)
    return found


def measure(recorded: list[Frames], backing: str, repeats: int) -> dict[str, float]:
    """Bytes a frame, and the best microseconds of appending a step and of drawing a batch."""
    steps = sum(len(frames) - 1 for frames in recorded)
    buffer = vhs.EpisodeBuffer(
        recorded[0][0].shape,
        num_streams=1,
        max_episode_steps=LONGEST,
        capacity_steps=2 * steps,
        backing=backing,
    )
    append = draw = float("inf")
    for _ in range(3):
        start = time.perf_counter()
        for frames in recorded:
            buffer.begin(0, frames[0])
            for frame in frames[1:]:
                buffer.append(0, 0, 0.0, None, frame)
            buffer.finish(0, "failure")
        append = min(append, (time.perf_counter() - start) / steps)
    for place, id in enumerate(buffer.ids[-len(recorded) :].tolist()):
        np.testing.assert_array_equal(buffer.gather([id]).observations[:, 1], recorded[place])
    for _ in range(repeats):
        start = time.perf_counter()
        buffer.sample_transitions(BATCH, "future", ratio=4)
        draw = min(draw, time.perf_counter() - start)
    stored = buffer.num_steps + len(buffer)
    return {"bytes_a_frame": buffer.nbytes / stored, "append_us": append * 1e6, "draw_us": draw * 1e6}


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    count, repeats = (3, 3) if options.quick else (100, 200)
    results = {}
    for name, source in kinds().items():
        recorded = [next(source) for _ in range(count)]
        results[name] = {backing: measure(recorded, backing, repeats) for backing in ("memory", "lz4")}
        for backing, found in results[name].items():
            print(
                f"{name:8} {backing:8} {found['bytes_a_frame']:9.0f} bytes a frame, "
                f"append {found['append_us']:7.1f} us a step, {BATCH} transitions {found['draw_us']:8.0f} us"
            )
    if options.json:
        options.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
