"""The one rule for what is written: complete or absent, and on the disk when the call returns.

A file or directory is made under a temporary name beside its place, flushed to the disk and then renamed; the
rename is flushed too. A link stays a link, a file keeps its mode, and what is no file is refused. Temporary
names are `.partial-PID-NAME`: what a kill leaves behind is told from what is not ours.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from vhs.errors import OutputError

_NO_SYNC = {errno.EINVAL, errno.ENOTSUP, errno.EBADF, errno.EACCES, errno.EPERM}
"""Of directories that cannot be opened or flushed on some systems."""


def write_files(directory: Path, files: Mapping[str, str | bytes]) -> None:
    """Write files into a directory, which is made when missing.

    None is renamed before all of them are on the disk, so what cannot be written leaves the old files as they
    were. They are renamed in their order: the last one says that all are there.

    Args:
        directory: where to.
        files: name to content; texts as UTF-8, in which the bytes of strange paths become question marks.

    Raises:
        OutputError: the directory or a file cannot be written; nothing was changed.
    """
    with writing(directory):
        directory.mkdir(parents=True, exist_ok=True)
    targets = {name: _target(directory / name) for name in files}
    try:
        for name, content in files.items():
            with writing(directory / name):
                _partial(targets[name]).write_bytes(
                    content if isinstance(content, bytes) else content.encode(errors="replace")
                )
        _settle(directory, targets.values())
    finally:
        for target in targets.values():
            _forget(_partial(target))


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """Have a file written by something that wants a name, as an encoder does.

    Yields:
        The temporary name, with the suffix of `path`; renamed when the block ends without an error.

    Raises:
        OutputError: the file cannot be written; what was there is left as it was.
    """
    target = _target(path)
    try:
        yield _partial(target)
        _settle(path, [target])
    finally:
        _forget(_partial(target))


@contextmanager
def new_directory(path: Path) -> Iterator[Path]:
    """Have a directory of files made that appears with all of them.

    Args:
        path: does not exist yet; its parent does.

    Yields:
        The directory under its temporary name; renamed when the block ends without an error.

    Raises:
        OutputError: it cannot be written; there is no directory then.
    """
    partial = _partial(path)
    try:
        with writing(path):
            shutil.rmtree(partial, ignore_errors=True)
            partial.mkdir()
        yield partial
        with writing(path):
            for file in partial.iterdir():
                _sync(file)
            _sync_directory(partial)
            partial.rename(path)
            _sync_directory(path.parent)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def remove_directory(path: Path) -> None:
    """Remove a directory so that none of its files is missing before all are: under a temporary name.

    Raises:
        OutputError: it cannot be removed.
    """
    with writing(path):
        shutil.rmtree(path.rename(_partial(path)))


def remove_partial(directory: Path, names: str) -> None:
    """Remove what kills left of files and directories; nobody may be writing them.

    Args:
        directory: where they would be.
        names: a regular expression for whole names.

    Raises:
        OutputError: one cannot be removed.
    """
    ours = re.compile(rf"\.partial-(\d+-)?(?:{names})")
    with writing(directory):
        for path in directory.iterdir():
            if ours.fullmatch(path.name):
                shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()


def is_partial(path: Path) -> bool:
    """Whether a name is one that a kill may have left behind."""
    return path.name.startswith(".partial-")


def check_writable(path: Path) -> None:
    """Refuse before a minute of work a file that could not be written after it.

    Raises:
        OutputError: no such folder, something else than a file, or no permission.
    """
    if not path.absolute().parent.is_dir():
        raise OutputError(f"{path}: expected an existing folder, found none: {path.absolute().parent}")
    partial = _partial(_target(path))
    with writing(path):
        partial.touch()
        partial.unlink()


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Say what cannot be written, and why.

    Raises:
        OutputError: a full disk, a missing permission, a directory that is gone.
    """
    try:
        yield
    except OSError as error:
        raise OutputError(f"{path}: cannot write: {error.strerror or error}") from error


def _partial(path: Path) -> Path:
    return path.with_name(f".partial-{os.getpid()}-{path.name}")


def _target(path: Path) -> Path:
    """The file that a path leads to, through links."""
    with writing(path):
        target = path.resolve()
        if target.exists() and not target.is_file():
            kind = "a directory" if target.is_dir() else "no regular file"
            raise OutputError(f"{path}: cannot write: expected a file, found {kind}")
    return target


def _settle(path: Path, targets: Iterable[Path]) -> None:
    """Flush files that are written under their temporary names, then rename them."""
    targets = list(targets)
    with writing(path):
        for target in targets:
            if target.exists():
                _partial(target).chmod(target.stat().st_mode & 0o7777)
            _sync(_partial(target))
        for target in targets:
            _partial(target).replace(target)
        for directory in {target.parent for target in targets}:
            _sync_directory(directory)


def _forget(partial: Path) -> None:
    # Where it could not be written it cannot be removed either: the first error is the one to tell.
    with suppress(OSError):
        partial.unlink()


def _sync(path: Path) -> None:
    # Windows flushes what is open for writing alone.
    descriptor = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _sync_directory(path: Path) -> None:
    """Make a rename durable; a no-op where directories cannot be opened or flushed."""
    try:
        _sync(path)
    except OSError as error:
        if error.errno not in _NO_SYNC:
            raise
