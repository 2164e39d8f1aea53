"""Runs small programs that show faults, a process each: ``python tests/run_cases.py DIRECTORY``.

A program exits 0 where the fault is gone. One that imports names as version 0.1.0 had them runs as a copy
that says their names of today.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

MOVED = {
    "from vhs.train.checkpoint import": "from vhs.runs.checkpoint import",
    "from vhs.train.directory import": "from vhs.runs.directory import",
    "from vhs.train.log import RunLog": "from vhs.train.log import TrainingLog as RunLog",
    "from vhs.train.export import _write": "from vhs.runs.files import write_files as _write",
    "from vhs.eval.record import": "from vhs.runs.evaluations import",
    '"state.pt"': '"state.safetensors"',
}
NEEDS_RUN = ("01-state-pt-bit-flip-is-silent",)
"""Programs that take the directory of a run."""
OTHER_VERSIONS = {
    "01-mujoco-lower-bound": "needs an environment with mujoco 3.3",
    "13-mujoco-3.3-cameras": "needs an environment with mujoco 3.3",
}
LIMIT_S = 300.0


def todays(path: Path, directory: Path) -> Path:
    """A program with the names of today: itself, or a copy in `directory`."""
    text = changed = path.read_text(encoding="utf-8")
    for before, now in MOVED.items():
        changed = changed.replace(before, now)
    if changed == text:
        return path
    copy = directory / path.name
    copy.write_text(changed, encoding="utf-8")
    return copy


def small_run(directory: Path) -> Path:
    """A run of a few episodes."""
    run = directory / "run"
    command = [sys.executable, "-m", "vhs.cli", "train", "--config", "configs/debug.yaml"]
    subprocess.run(
        [*command, "--set", "train.episodes=8", "--out", str(run)], check=True, capture_output=True
    )
    return run


def run(path: Path, arguments: list[str]) -> tuple[int, str]:
    """Exit status and last line of a program."""
    command = [sys.executable if path.suffix == ".py" else "bash", str(path), *arguments]
    # Shell programs call `python` and `vhs`.
    places = [str(Path(sys.executable).parent), os.environ.get("PATH", "")]
    environment = os.environ | {"PATH": os.pathsep.join(places)}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=LIMIT_S, env=environment
        )
    except subprocess.TimeoutExpired:
        return 124, f"no end within {LIMIT_S:g} s"
    lines = (done.stdout.strip() or done.stderr.strip()).splitlines()
    return done.returncode, lines[-1] if lines else ""


def main() -> int:
    """Print a line a program; the exit status says whether any failed."""
    root = Path(sys.argv[1])
    programs = sorted(path for path in root.rglob("*") if path.suffix in (".py", ".sh"))
    if not programs:
        print(f"{root}: expected a directory of programs, found none; give another one: make cases CASES=DIR")
        return 2
    failed = 0
    with tempfile.TemporaryDirectory() as directory:
        for path in programs:
            name = path.relative_to(root)
            if path.stem in OTHER_VERSIONS:
                print(f"  --  {name}: {OTHER_VERSIONS[path.stem]}", flush=True)
                continue
            arguments = [str(small_run(Path(directory)))] if path.stem in NEEDS_RUN else []
            status, line = run(todays(path, Path(directory)), arguments)
            failed += status != 0
            print(f"{status:4d}  {name}: {line[:160]}", flush=True)
    print(f"{failed} of {len(programs)} failed")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
