"""What is installed as `vhs-rl`: how its extras are asked for, and the files that come with it, by name.

In a checkout `configs` and `pretrained` beside this file are links to the directories at its top, which hold
the files; a wheel holds them here.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

NAME = "vhs-rl"
"""On PyPI, where `vhs` is another project."""
_PACKAGE = Path(__file__).parent
_CONFIGS = _PACKAGE / "configs"


def pip_install(extra: str) -> str:
    """The command that brings an extra, for a person to whom something is missing."""
    return f"pip install '{NAME}[{extra}]'"


def find_config(named: Path | str) -> Path:
    """A configuration file: the one at this path, or else of ours the one of this name, as in ``task2``."""
    return _find(Path(named), [_CONFIGS, _CONFIGS / "algorithms"], ".yaml")


def find_sweep(named: Path | str) -> Path:
    """A sweep file, likewise: ``quick``."""
    return _find(Path(named), [_CONFIGS / "sweeps"], ".yaml")


def find_agent(named: Path | str) -> Path:
    """A directory of a run or an agent: the one at this path, or else of ours the one of this name."""
    return _find(Path(named), [_PACKAGE / "pretrained"], "")


def names_of_ours(named: Path, kind: str) -> str:
    """What a message about a bare name of nothing may add: the names that there are.

    Args:
        named: what a person wrote.
        kind: of files of ours, as a pattern in the package: ``configs/*.yaml``.
    """
    if named.exists() or len(named.parts) != 1 or named.suffix:
        return ""
    names = sorted(file.stem for file in _PACKAGE.glob(kind))
    return f"; of ours there are {', '.join(names)}" if names else ""


def _find(path: Path, folders: Sequence[Path], suffix: str) -> Path:
    """What is at the path; where nothing is, and it is a bare name, the file of ours that has it."""
    if path.exists() or len(path.parts) != 1 or path.suffix:
        return path
    ours = [folder / f"{path.name}{suffix}" for folder in folders]
    return next((file for file in ours if file.exists()), path)
