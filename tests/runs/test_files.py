"""What is written is complete or absent, where a link leads, with the mode it had, and on the disk."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from vhs.errors import OutputError
from vhs.runs.files import check_writable, new_directory, new_file, remove_partial, write_files


def names(directory: Path) -> list[str]:
    return sorted(path.name for path in directory.iterdir())


def test_a_target_that_is_a_directory_is_refused_before_any_file_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("old")
    (tmp_path / "b").mkdir()
    with pytest.raises(OutputError, match="b: cannot write: expected a file, found a directory"):
        write_files(tmp_path, {"a": "new", "b": "new"})
    assert (tmp_path / "a").read_text() == "old"
    assert names(tmp_path) == ["a", "b"]


def test_a_link_stays_a_link_and_a_file_keeps_its_mode(tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / "file").write_text("old")
    (tmp_path / "far" / "file").chmod(0o640)
    (tmp_path / "link").symlink_to("far/file")
    write_files(tmp_path, {"link": "new"})
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "far" / "file").read_text() == "new"
    assert stat.S_IMODE((tmp_path / "far" / "file").stat().st_mode) == 0o640
    assert names(tmp_path / "far") == ["file"]


@pytest.mark.skipif(sys.platform == "win32", reason="no named pipes")
def test_what_is_no_file_is_refused_and_stays(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for write in (lambda: write_files(tmp_path, {"pipe": "x"}), lambda: check_writable(tmp_path / "pipe")):
        with pytest.raises(OutputError, match="expected a file, found no regular file"):
            write()
    assert (tmp_path / "pipe").is_fifo()


def test_a_file_of_an_encoder_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    def encode(text: str, *, fails: bool) -> None:
        with new_file(tmp_path / "film.gif") as partial:
            assert partial.suffix == ".gif", "encoders choose by it"
            partial.write_text(text)
            if fails:
                raise ZeroDivisionError

    encode("old", fails=False)
    with pytest.raises(ZeroDivisionError):
        encode("new", fails=True)
    assert names(tmp_path) == ["film.gif"]
    assert (tmp_path / "film.gif").read_text() == "old"


def test_a_directory_appears_with_all_of_its_files_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(FileNotFoundError), new_directory(tmp_path / "whole") as partial:
        (partial / "missing" / "a").write_text("a")
    assert names(tmp_path) == ["file"]
    with new_directory(tmp_path / "whole") as partial:
        (partial / "a").write_text("a")
        assert not (tmp_path / "whole").exists()
    assert (tmp_path / "whole" / "a").read_text() == "a"


def test_only_our_own_leftovers_are_removed(tmp_path: Path) -> None:
    ours = [".partial-12-log.jsonl", ".partial-log.jsonl"]
    foreign = ["log.jsonl", "thesis.tmp", ".partial-12-thesis.tex", "my.partial-12-log.jsonl"]
    for name in [*ours, *foreign]:
        (tmp_path / name).write_text("")
    remove_partial(tmp_path, r"log\.jsonl")
    assert names(tmp_path) == sorted(foreign)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="strace is one of Linux")
def test_files_and_their_directory_are_flushed_before_the_call_returns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flushed: list[str] = []
    flush, replace = os.fsync, Path.replace
    monkeypatch.setattr(
        os, "fsync", lambda fd: (flushed.append(Path(f"/proc/self/fd/{fd}").readlink().name), flush(fd))
    )
    monkeypatch.setattr(
        Path, "replace", lambda path, to: (flushed.append(f"-> {to.name}"), replace(path, to))
    )
    write_files(tmp_path, {"a": "1", "b": "2"})
    partial = f".partial-{os.getpid()}-"
    assert flushed == [f"{partial}a", f"{partial}b", "-> a", "-> b", tmp_path.name]


def test_the_error_is_the_first_one_where_nothing_can_be_written_or_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, *_: object, **__: object) -> None:
        raise OSError(30, "Read-only file system", str(path))

    monkeypatch.setattr(Path, "write_bytes", refuse)
    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(OutputError, match="a: cannot write: Read-only file system"):
        write_files(tmp_path, {"a": "1"})


def test_a_text_with_the_bytes_of_a_strange_path_can_be_written(tmp_path: Path) -> None:
    write_files(tmp_path, {"page.html": os.fsdecode(b"caf\xe9")})
    assert (tmp_path / "page.html").read_text() == "caf?"


def test_a_kill_between_the_names_leaves_whole_files(tmp_path: Path) -> None:
    code = (
        "import os, signal, sys; from pathlib import Path; from vhs.runs.files import write_files\n"
        "replace = Path.replace\n"
        "def die(path, to):\n"
        "    replace(path, to); os.kill(os.getpid(), signal.SIGKILL)\n"
        "Path.replace = die\n"
        "write_files(Path(sys.argv[1]), {'a': 'new', 'b': 'new'})"
    )
    write_files(tmp_path, {"a": "old", "b": "old"})
    assert subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False).returncode == -9
    assert ((tmp_path / "a").read_text(), (tmp_path / "b").read_text()) == ("new", "old")
    remove_partial(tmp_path, "a|b")
    assert names(tmp_path) == ["a", "b"]
