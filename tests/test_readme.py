"""README and docs keep their word: their code runs, their commands exist, their links lead somewhere."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str, page: str = README) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page, re.DOTALL)


@pytest.mark.parametrize("code", blocks("python"), ids=lambda code: code.splitlines()[0])
def test_python_blocks_run(code: str) -> None:
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True, timeout=60)


@pytest.mark.slow
@pytest.mark.parametrize("page", ["library.md", "rollout.md"])
def test_python_blocks_of_a_page_run_one_after_the_other(page: str) -> None:
    code = "\n".join(blocks("python", (ROOT / "docs" / page).read_text(encoding="utf-8")))
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True, timeout=100, cwd=ROOT)


@pytest.mark.slow
def test_the_guide_to_an_own_environment_ends_with_a_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its files are written and its commands given as they stand, but for fewer episodes."""
    page = (ROOT / "docs" / "own-environment.md").read_text(encoding="utf-8")
    for text in blocks("(?:python|yaml)", page):
        name, _, content = text.removeprefix("# ").partition("\n")
        (tmp_path / name).write_text(content)
    few = ["--set", "train.episodes=40", "--set", "env.num_envs=4", "--set", "env.num_workers=0"]
    commands = [line.split() for block in blocks("sh", page) for line in block.splitlines()]
    assert [command[1] for command in commands[:4]] == ["train", "eval", "play", "report"]
    arguments = [command[command.index("vhs") + 1 :] for command in commands]
    arguments = [[*words, *(few if words[0] == "train" else [])] for words in arguments]
    arguments.append(["eval", "runs/python", "--task", "mine.py", "--episodes", "2"])
    python = (tmp_path / "train.py").read_text().replace('"train.episodes": 6000', '"train.episodes": 8')
    code = f"{python}\nfrom vhs.cli import main\nfor words in {arguments}: assert main(words) == 0, words"
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT / "python"), str(tmp_path)]))
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True, timeout=110, cwd=tmp_path)
    assert (tmp_path / "film.gif").stat().st_size > 1000
    assert "Asked and reached" in (tmp_path / "runs" / "mine" / "report.html").read_text(encoding="utf-8")


def test_make_targets_of_the_readme_exist() -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    commands = re.findall(r"^make ([a-z]+)", "\n".join(blocks("sh")), re.MULTILINE)
    assert {"train", "test"} <= set(commands) <= targets


def test_continuous_integration_runs_the_readmes_test_command() -> None:
    assert (ROOT / ".ci" / "run").read_text().rstrip().endswith("make test")
    assert os.access(ROOT / ".ci" / "run", os.X_OK)


def test_command_lines_of_the_readme_parse(capsys: pytest.CaptureFixture[str]) -> None:
    from vhs.cli import _parser

    lines = [line for block in blocks("sh") for line in block.splitlines() if line.startswith("vhs ")]
    assert len(lines) >= 2
    for line in lines:
        options = _parser().parse_args(line.split()[1:])
        for path in getattr(options, "config", []):
            assert (ROOT / path).exists(), path


def test_relative_links_lead_somewhere() -> None:
    pages = [
        ROOT / "README.md",
        ROOT / "ARCHITECTURE.md",
        ROOT / "CONTRIBUTING.md",
        *(ROOT / "docs").glob("*.md"),
    ]
    for page in pages:
        for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text(encoding="utf-8")):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{page.name}: {target}"
