"""Checks a wheel as those who install it find it: what is in it, and what it does where there is no Rust.

    python .ci/check_wheel.py dist/vhs_rl-*.whl [--extra train]

It is installed into an environment of its own and used from an empty directory. With the extra `train` an
agent of ours is evaluated by its name, and a few episodes are trained; without, the library alone is used.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import tomllib
import venv
import zipfile
from collections.abc import Sequence
from email.parser import HeaderParser
from pathlib import Path

ROOT = Path(__file__).parents[1]
LIBRARY = "import vhs; assert len(vhs.GoalStore(2, (2, 2, 3), capacity_per_class=5, seed=0)) == 0"
FOLDERS = {"python/": "", "configs/": "vhs/configs/", "pretrained/": "vhs/pretrained/"}
"""Of the checkout, and where they are in a wheel."""
LINK = "120000"
"""Mode of a symbolic link in git."""


def main() -> None:
    """Check the wheel that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--extra", choices=["train"])
    options = parser.parse_args()
    check_content(options.wheel)
    check_metadata(options.wheel)
    with tempfile.TemporaryDirectory() as folder:
        check_use(options.wheel.resolve(), options.extra, Path(folder))
    print(f"{options.wheel.name}: {options.wheel.stat().st_size / 1e6:.1f} MB, good")


def shipped_files() -> set[str]:
    """What a wheel holds of the checkout, by its path there: the package, its configurations and agents."""
    command = ["git", "ls-files", "--stage"]
    told = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    files = set()
    for line in told.splitlines():
        mode, _, path = line.partition(" ")[0], *line.partition("\t")[1:]
        for folder, place in FOLDERS.items():
            if mode != LINK and path.startswith(folder):
                files.add(place + path.removeprefix(folder))
    return files


def check_content(wheel: Path) -> None:
    """Whether a wheel holds all that it shall, the extension module once, and nothing else."""
    with zipfile.ZipFile(wheel) as opened:
        found = {name for name in opened.namelist() if ".dist-info/" not in name and not name.endswith("/")}
    extension = {name for name in found if name.endswith((".so", ".pyd"))}
    expected = shipped_files()
    if len(extension) != 1 or found - extension != expected:
        sys.exit(
            f"{wheel}: expected one extension module, found {sorted(extension)}; "
            f"missing {sorted(expected - found)}; not ours {sorted(found - extension - expected)}"
        )


def check_metadata(wheel: Path) -> None:
    """Whether name, version and commands are those of the manifests."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    version = tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]["package"]["version"]
    with zipfile.ZipFile(wheel) as opened:
        inner = next(name for name in opened.namelist() if name.endswith(".dist-info/METADATA"))
        said = HeaderParser().parsestr(opened.read(inner).decode())
        commands = opened.read(inner.replace("METADATA", "entry_points.txt")).decode()
    if (said["Name"], said["Version"]) != (project["name"], version):
        sys.exit(f"{wheel}: expected {project['name']} {version}, found {said['Name']} {said['Version']}")
    if any(f"{command}=" not in commands for command in project["scripts"]):
        sys.exit(f"{wheel}: expected the commands {list(project['scripts'])}, found {commands!r}")


def check_use(wheel: Path, extra: str | None, folder: Path) -> None:
    """Install a wheel and use it, where no compiler is on the path."""
    home = folder / "environment"
    venv.create(home, with_pip=True)
    scripts = home / ("Scripts" if os.name == "nt" else "bin")
    python = str(scripts / "python")
    clean = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    clean["PATH"] = os.pathsep.join([str(scripts), *([] if os.name == "nt" else ["/usr/bin", "/bin"])])
    empty = folder / "empty"
    empty.mkdir()

    def run(command: Sequence[str]) -> None:
        subprocess.run(command, cwd=empty, env=clean, check=True)

    run([python, "-m", "pip", "install", "--quiet", "--only-binary", ":all:", *_wanted(wheel, extra)])
    run([python, "-c", LIBRARY])
    if extra:
        vhs = str(scripts / "vhs")
        run([str(scripts / "vhs-rl"), "--version"])
        run([vhs, "eval", "task2", "--episodes", "20"])
        run([vhs, "train", "--config", "debug", "--set", "train.episodes=8", "--out", "run"])


def _wanted(wheel: Path, extra: str | None) -> list[str]:
    return [f"{wheel}[{extra}]" if extra else str(wheel)]


if __name__ == "__main__":
    main()
