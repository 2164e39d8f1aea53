"""Files that are complete or absent: several texts written under temporary names, then renamed."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from vhs.errors import OutputError


def write_texts(directory: Path, texts: Mapping[str, str]) -> None:
    """Write files into a directory, which is made when missing.

    None is renamed into place before all of them are on disk, so what cannot be written leaves the old files
    as they were.

    Args:
        directory: where to.
        texts: file name to content.

    Raises:
        OutputError: the directory or a file cannot be written; nothing was changed.
    """
    partial = {name: directory / f".{name}.{os.getpid()}.partial" for name in texts}
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for name in texts:
            if (directory / name).is_dir():
                raise OutputError(f"{directory / name}: cannot write: expected a file, found a directory")
        for name, text in texts.items():
            partial[name].write_text(text, encoding="utf-8")
        for name, path in partial.items():
            path.replace(directory / name)
    except OSError as error:
        raise OutputError(f"{error.filename or directory}: cannot write: {error.strerror}") from error
    finally:
        if directory.is_dir():
            for path in partial.values():
                path.unlink(missing_ok=True)
