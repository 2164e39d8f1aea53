"""Training by several processes of this machine: steps a second, bytes of an update, and a model of networks.

    python benchmarks/bench_processes.py [--config configs/task2.yaml] [--processes 1 2] [--updates 100]
                                         [--quick] [--json FILE]

Each process learns from four episodes an update and steps its environments itself, so that work grows with
the processes. Checks its subject first: the weights of all processes must be the same bits, and every update
must have had its episodes. Beside the wall clock, which other work on the machine spoils, stands the time of
the processor in each update: that of the slowest process is what it takes where each has a core.

The networks are a model, from that time and the bytes of the messages: a ring moves 2 (n - 1) / n of a sum
and n - 1 times what a process hands to all, in 2 (n - 1) and n - 1 hops.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import tempfile
import time
from pathlib import Path
from typing import Any

import torch
from torch.distributed.launcher.api import elastic_launch

from vhs.config import load_config
from vhs.train.log import Log
from vhs.train.session import Session
from vhs.world import joined
from vhs.world.launch import one_machine

SHARE = 4
"""Episodes that a process learns from in an update."""
HOP_S = 50e-6
"""Of a small message in a network."""


def measure(config_path: str, updates: int, overrides: list[str]) -> dict[str, Any]:
    """Train as one of the processes that the launcher has started; what was measured, alike on all."""
    with joined() as world, tempfile.TemporaryDirectory(prefix="vhs-bench-") as directory:
        fixed = [f"train.episodes_per_update={SHARE * world.size}", "env.num_workers=0", "method.warmup=1"]
        config = load_config([config_path], [*fixed, *overrides])
        torch.set_num_threads(config.train.threads)  # as `train` does
        session, log = Session(config, Path(directory) / "run", world=world), Log()

        def learn(count: int) -> list[float]:
            """Processor time of each of so many updates, with the steps before it."""
            spent, last = [], time.process_time()
            for end in range(session.updates + 1, session.updates + count + 1):
                while session.updates < end:
                    session.advance(log)
                now = time.process_time()
                spent.append(now - last)
                last = now
            return spent

        learn(max(2, updates // 4))
        steps, episodes, began = session.progress.env_steps, session.progress.episodes, time.perf_counter()
        spent = learn(updates)
        taken = time.perf_counter() - began
        steps, episodes = session.progress.env_steps - steps, session.progress.episodes - episodes
        session.expect_equal_weights()
        slowest = [
            max(each) for each in zip(*map(json.loads, world.share(json.dumps(spent).encode())), strict=True)
        ]
        assert episodes == updates * SHARE * world.size, "an update without its episodes"
        session.close()
        gradients = [parameter.grad for parameter in session.parameters if parameter.grad is not None]
        began = time.perf_counter()
        for _ in range(updates):
            world.average(gradients)
        message = (time.perf_counter() - began) / updates
    return {
        "steps_per_s": steps / taken,
        "update_ms": taken / updates * 1000,
        "processor_ms": sum(slowest) / updates * 1000,
        "steps_per_processor_s": steps / sum(slowest),
        "message_ms": message * 1000,
        "message_bytes": 4 * sum(gradient.numel() for gradient in gradients),
    }


def run(processes: int, *arguments: Any) -> dict[str, Any]:
    """`measure` in so many processes."""
    found: dict[str, Any] = elastic_launch(one_machine(processes), measure)(*arguments)[0]
    return found


def on_network(one: dict[str, Any], ranks: int, gbit_per_s: float, success: float = 0.9) -> dict[str, float]:
    """What the model says of many processes: time of the messages of an update, and what of it is work."""
    picture = 84 * 84 * 6 + 16
    handed = 2 * (ranks - 1) / ranks * one["message_bytes"] + (ranks - 1) * SHARE * success * picture
    message = handed * 8 / (gbit_per_s * 1e9) + 3 * (ranks - 1) * HOP_S
    return {
        "message_ms": message * 1000,
        "efficiency": one["processor_ms"] / (one["processor_ms"] + message * 1000),
        "megabytes": handed / 1e6,
    }


def main() -> None:
    """Measure, model, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--config", default="configs/task2.yaml")
    parser.add_argument("--set", action="append", default=[])
    parser.add_argument("--processes", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--updates", type=int, default=100)
    parser.add_argument("--quick", action="store_true", help="a few updates of small networks")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.quick:
        options.config, options.updates = "configs/debug.yaml", 4
    load = os.getloadavg()[0]
    found = {count: run(count, options.config, options.updates, options.set) for count in options.processes}
    first = found[options.processes[0]]
    print(f"{platform.machine()}, {os.cpu_count()} cores, load {load:.1f} before\n")
    print("           wall clock               processor time of the slowest")
    print("processes  steps/s  ratio  ms its sum  ms an update  steps/s  ratio  MB its sum")
    for count, one in found.items():
        ratio = one["steps_per_s"] / first["steps_per_s"]
        print(
            f"{count:9}  {one['steps_per_s']:7.0f}  {ratio:5.2f}  {one['message_ms']:10.2f}  "
            f"{one['processor_ms']:12.1f}  {one['steps_per_processor_s']:7.0f}  "
            f"{one['steps_per_processor_s'] / first['steps_per_processor_s']:5.2f}  "
            f"{one['message_bytes'] / 1e6:10.1f}"
        )
    print("\nmodel: ranks  Gbit/s  MB an update  ms  efficiency")
    model = {}
    for ranks in (8, 64, 512):
        for speed in (1, 25):
            said = model[f"{ranks} ranks, {speed} Gbit/s"] = on_network(first, ranks, speed)
            print(
                f"{ranks:12}  {speed:6}  {said['megabytes']:12.1f}  {said['message_ms']:5.0f}  "
                f"{said['efficiency']:.2f}"
            )
    if options.json:
        numbers = {"load": load, "measured": found, "model": model}
        options.json.write_text(json.dumps(numbers, indent=1) + "\n")


if __name__ == "__main__":
    main()
