"""The docs keep their word: their code runs, their commands parse, their links lead somewhere."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from pages import DOCS, ROOT, blocks, read

import vhs
from vhs.runs.rows import read_log

PAGES = sorted(DOCS.rglob("*.md"))
OTHERS = [
    ROOT / name for name in ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md")
]


@pytest.mark.slow
@pytest.mark.parametrize("page", ["guides/own-learner.md", "guides/adapters.md", "reference/rollout.md"])
def test_python_blocks_of_a_page_run_one_after_the_other(page: str, tmp_path: Path) -> None:
    """In a directory of their own, since some write files, beside the agents that they load."""
    (tmp_path / "pretrained").symlink_to(ROOT / "pretrained")
    code = "\n".join(blocks("python", read(DOCS / page)))
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True, timeout=100, cwd=tmp_path)


@pytest.mark.slow
def test_the_guide_to_an_own_environment_ends_with_a_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its files are written and its commands given as they stand, but for fewer episodes."""
    page = read(DOCS / "guides" / "own-environment.md")
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
    assert "Asked and reached" in read(tmp_path / "runs" / "mine" / "report.html")


@pytest.mark.slow
def test_the_notebook_trains_its_toy_and_shows_the_report(tmp_path: Path) -> None:
    """As it stands, in a fresh process; it learns as well: chance succeeds in two episodes of five."""
    cells = json.loads(read(ROOT / "examples" / "toy.ipynb"))["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert all(not cell.get("outputs") for cell in cells), "outputs are made, not committed"
    shown, _, last = code[-1].rpartition("\n")
    end = "assert 'Outcomes by goal' in shown.data and '<iframe' in shown.data"
    script = "\n".join([*code[:-1], shown, f"shown = {last}", end])
    subprocess.run([sys.executable, "-W", "error", "-c", script], check=True, timeout=110, cwd=tmp_path)
    rows = read_log(tmp_path / "runs" / "lamps")
    assert sum(row["rate/success"] for row in rows[-3:]) / 3 > 0.55


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_commands_of_the_docs_parse(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from vhs.cli import _parser

    for line in "\n".join(blocks("sh", read(page))).replace("\\\n", " ").splitlines():
        words = line.partition(" #")[0].split()
        if words[:1] == ["vhs"] and not {"for", "{", "}"} & set(words) and "{" not in line:
            _parser().parse_args(words[1:])


@pytest.mark.parametrize("page", [*PAGES, *OTHERS], ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    """Pages, pictures and files; the anchors of pages of the site are checked by `make docs`."""
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", re.sub(r"```.*?```", "", read(page), flags=re.DOTALL)):
        if "://" not in target:
            assert (page.parent / target).exists(), target
            assert DOCS not in page.parents or (page.parent / target).resolve().is_relative_to(DOCS), (
                f"{target}: outside of what the site shows"
            )


@pytest.mark.parametrize("page", [*PAGES, *OTHERS], ids=lambda page: str(page.relative_to(ROOT)))
def test_a_line_is_short_and_holds_one_sentence(page: Path) -> None:
    """So that a change shows what it changed; code is short too, and titles and tables may say more."""
    lines = read(page).splitlines()
    assert [line for line in lines if len(line) > 120] == []
    prose = re.sub(r"```.*?```", "", read(page), flags=re.DOTALL).splitlines()
    several = re.compile(r"[a-z0-9)`%\]]{2}[.?!] (?!\d)[A-Z`*\[][a-z]")
    assert [line for line in prose if not line.startswith(("|", "#")) and several.search(line)] == []


def test_every_page_stands_in_the_navigation() -> None:
    def pages(nav: Any) -> list[str]:
        if isinstance(nav, str):
            return [nav]
        return [page for part in (nav if isinstance(nav, list) else nav.values()) for page in pages(part)]

    nav = tomllib.loads((ROOT / "zensical.toml").read_text())["project"]["nav"]
    assert sorted(pages(nav)) == sorted(str(page.relative_to(DOCS)) for page in PAGES)


def test_every_public_name_stands_in_the_reference() -> None:
    shown = set(re.findall(r"^::: [\w.]+\.(\w+)$", read(DOCS / "reference" / "python.md"), re.MULTILINE))
    errors = set(re.findall(r"^`(\w+)`", read(DOCS / "reference" / "errors.md"), re.MULTILINE))
    assert set(vhs.__all__) - errors == (set(vhs.__all__) & shown) | {"train"}  # `vhs.train.api.train_on`


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_files_that_a_page_names_exist(page: Path) -> None:
    for name in re.findall(
        r"`((?:examples|configs|benchmarks|rust|tests|docs|python)/[\w./-]+\w)`", read(page)
    ):
        assert (ROOT / name).exists(), name
