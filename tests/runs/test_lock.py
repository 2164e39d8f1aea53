"""The one lock: held by one process at a time, given back when its holder dies, inherited where asked for."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from vhs.errors import OutputError
from vhs.runs.lock import hold

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="fcntl is one of Unix")

HOLDER = """
import sys, time
from pathlib import Path
from vhs.runs.lock import hold
with hold(Path(sys.argv[1]), "held"):
    print("holds", flush=True)
    time.sleep(60)
"""


@pytest.mark.parametrize("name", [".lock", ""])
def test_a_second_process_is_refused_until_the_first_dies(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    process = subprocess.Popen([sys.executable, "-c", HOLDER, str(path)], stdout=subprocess.PIPE)
    assert process.stdout is not None
    try:
        assert process.stdout.readline() == b"holds\n"
        waited: list[str] = []
        with (
            pytest.raises(OutputError, match=r"^busy$"),
            hold(path, "busy", patience_s=0.1, wait=lambda: waited.append("once")),
        ):
            pass
        assert waited == ["once"]
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
    with hold(path, "busy", patience_s=5.0):
        pass
    assert list(tmp_path.iterdir()) == ([path] if name else [])


def test_children_hold_it_only_where_asked_for(tmp_path: Path) -> None:
    for by_children in (False, True):
        with hold(tmp_path / ".lock", "busy", by_children=by_children) as descriptor:
            child = subprocess.Popen(["sleep", "0.5"], pass_fds=(descriptor,))
        began = time.monotonic()
        with hold(tmp_path / ".lock", "busy", by_children=by_children, patience_s=30):
            assert (child.poll() is not None) == by_children, time.monotonic() - began
        child.wait()


def test_a_place_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write: Not a directory"), hold(tmp_path / "file" / "x", ""):
        pass
    assert os.listdir(tmp_path) == ["file"]
