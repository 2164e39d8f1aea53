"""The README keeps its word: its code runs, its commands exist."""

import os
import re
import subprocess
import sys

import pytest
from pages import ROOT, blocks, read

README = read(ROOT / "README.md")


@pytest.mark.parametrize("code", blocks("python", README), ids=lambda code: code.splitlines()[0])
def test_python_blocks_run(code: str) -> None:
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True, timeout=60)


def test_make_targets_of_the_readme_exist() -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    commands = re.findall(r"^make ([a-z]+)", "\n".join(blocks("sh", README)), re.MULTILINE)
    assert {"train", "test"} <= set(commands) <= targets


def test_continuous_integration_runs_the_readmes_test_command() -> None:
    assert (ROOT / ".ci" / "run").read_text().rstrip().endswith("make test")
    assert os.access(ROOT / ".ci" / "run", os.X_OK)


def test_command_lines_of_the_readme_parse(capsys: pytest.CaptureFixture[str]) -> None:
    from vhs.cli import _parser

    lines = [line for block in blocks("sh", README) for line in block.splitlines() if line.startswith("vhs ")]
    assert len(lines) >= 2
    for line in lines:
        options = _parser().parse_args(line.split()[1:])
        for path in getattr(options, "config", []):
            assert (ROOT / path).exists(), path
