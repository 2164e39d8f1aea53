"""Where a minute of training goes: the share of every part of the learner's process, and of the rooms.

    python benchmarks/profile_training.py --config configs/task2.yaml --seconds 30

Parts are timed by wrapping the functions that do them; a part that holds another is charged only for what is
left. What no part claims is Python glue. The rooms are stepped in this process (`env.num_workers = 0`), so
that one number adds up to all the work there is.
"""

from __future__ import annotations

import argparse
import io
import json
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

import vhs.learning.terms
from vhs import RasterRenderer
from vhs.acting.actor import Actor
from vhs.acting.stepping import LocalStepping
from vhs.config import load_config
from vhs.envs import RoomEnv
from vhs.learning.goals import ClassGoals
from vhs.learning.learner import Learner
from vhs.models import FeatureExtractor
from vhs.train import loop
from vhs.train.log import TrainingLog
from vhs.train.memory import keep_freed_memory


class Stopwatch:
    """Seconds of each part, without the parts inside it."""

    def __init__(self) -> None:
        """Start at zero."""
        self.seconds: dict[str, float] = defaultdict(float)
        self._stack: list[tuple[str, float]] = []

    def wrap(self, owner: Any, name: str, part: str) -> None:
        """Time every call of `owner.name` as `part`."""
        inner: Callable[..., Any] = getattr(owner, name)

        def timed(*args: Any, **kwargs: Any) -> Any:
            self._switch()
            self._stack.append((part, time.perf_counter()))
            try:
                return inner(*args, **kwargs)
            finally:
                self._switch()
                self._stack.pop()
                if self._stack:
                    self._stack[-1] = (self._stack[-1][0], time.perf_counter())

        setattr(owner, name, timed)

    def _switch(self) -> None:
        if self._stack:
            part, since = self._stack[-1]
            self.seconds[part] += time.perf_counter() - since


def main() -> None:
    """Train for a while and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--config", type=Path, action="append", default=[])
    parser.add_argument("--set", action="append", default=[])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--warm", type=float, default=10.0, help="seconds before the clock starts")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    config = load_config(options.config, ["env.num_workers=0", *options.set])
    config = config.model_copy(update={"method": config.method.model_copy(update={"warmup": 16})})
    watch = Stopwatch()
    _instrument(watch)
    torch.set_num_threads(config.train.threads)
    keep_freed_memory()
    with tempfile.TemporaryDirectory() as run:
        session = loop.Session(config, Path(run))
        log = TrainingLog(Path(run), config.train.episodes, 0, io.StringIO())
        _advance(session, log, options.warm)
        watch.seconds.clear()
        steps, episodes = session.progress.env_steps, session.progress.episodes
        taken = _advance(session, log, options.seconds)
        steps, episodes = session.progress.env_steps - steps, session.progress.episodes - episodes
        session.close()
    assert episodes > 0, "nothing was learned from: raise --seconds"
    rows = dict(sorted(watch.seconds.items(), key=lambda row: -row[1]))
    rows["python glue"] = taken - sum(rows.values())
    print(f"{steps / taken:.0f} steps/s, {steps / episodes:.1f} steps an episode")
    print(f"{'part':28} {'share':>6} {'us/step':>8}")
    for part, seconds in rows.items():
        print(f"{part:28} {seconds / taken:6.1%} {seconds / steps * 1e6:8.1f}")
    if options.json:
        result = {"steps_per_s": steps / taken, "us_per_step": {k: v / steps * 1e6 for k, v in rows.items()}}
        options.json.write_text(json.dumps(result, indent=2) + "\n")


def _advance(session: Any, log: TrainingLog, seconds: float) -> float:
    begin = time.perf_counter()
    while time.perf_counter() - begin < seconds:
        session.advance(log)
    return time.perf_counter() - begin


def _instrument(watch: Stopwatch) -> None:
    watch.wrap(LocalStepping, "recv", "rooms: physics, rest")
    watch.wrap(RoomEnv, "reset", "rooms: reset")
    watch.wrap(RasterRenderer, "render", "rooms: drawing")
    watch.wrap(Actor, "act", "acting: the rest")
    watch.wrap(Learner, "_step", "optimiser, clip")
    watch.wrap(Learner, "_forward", "LSTM, heads")
    watch.wrap(Learner, "_evaluate", "RL and VHS loss")
    watch.wrap(ClassGoals, "batch", "goal images")
    watch.wrap(Learner, "update", "update: the rest")
    watch.wrap(vhs.learning.terms, "supcon_loss", "SupCon loss")
    watch.wrap(torch.Tensor, "backward", "backward")
    watch.wrap(FeatureExtractor, "forward", "extractor forward")


if __name__ == "__main__":
    main()
