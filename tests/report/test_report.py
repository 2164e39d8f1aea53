"""The page: complete, well-formed, by itself; what is missing is named in it, bad input is refused."""

import re
import shutil
import subprocess
from io import StringIO
from pathlib import Path
from xml.etree import ElementTree

import pytest
from pages import DOCS, read

from vhs.cli import main
from vhs.errors import CheckpointError
from vhs.learning.terms import TERMS
from vhs.report import decoder, report
from vhs.runs.checkpoint import load_checkpoint, save_checkpoint
from vhs.runs.rows import read_log
from vhs.train import train

pytestmark = pytest.mark.slow

SECTIONS = (
    "curves",
    "confusion",
    "episodes",
    "goals",
    "prototypes",
    "features",
    "losses",
    "speed",
    "setup",
)
SVG = "{http://www.w3.org/2000/svg}"


def parse(page: Path) -> ElementTree.Element:
    return ElementTree.fromstring(page.read_text(encoding="utf-8").removeprefix("<!DOCTYPE html>"))


def section_text(page: ElementTree.Element, anchor: str) -> str:
    found = page.find(f".//section[@id='{anchor}']")
    assert found is not None, anchor
    return " ".join(found.itertext())


def test_a_run_makes_one_whole_page(page_of_one: Path) -> None:
    assert list(page_of_one.parent.iterdir()) == [page_of_one]
    page = parse(page_of_one)
    assert [section.get("id") for section in page.iter("section")] == list(SECTIONS)
    for anchor in SECTIONS:
        assert "Not shown" not in section_text(page, anchor), anchor
    assert page_of_one.stat().st_size < 5e6


def test_the_page_refers_to_nothing_outside_itself(page_of_one: Path) -> None:
    page = parse(page_of_one)
    assert [script.attrib for script in page.iter("script")] == [{}], (
        "the one that tells values, inside the page"
    )
    links = [value for node in page.iter() for name, value in node.attrib.items() if name in ("src", "href")]
    assert links
    assert all(link.startswith(("data:", "#")) for link in links)
    assert not re.search(r"url\(|@import", page_of_one.read_text(encoding="utf-8"))
    anchors = {node.get("id") for node in page.iter()}
    assert all(link[1:] in anchors for link in links if link.startswith("#"))


@pytest.mark.skipif(shutil.which("node") is None, reason="nothing here reads JavaScript")
def test_the_script_of_the_page_is_whole(page_of_one: Path, tmp_path: Path) -> None:
    """What a browser would run, with the marks that keep it out of the XML."""
    (script,) = parse(page_of_one).iter("script")
    assert script.text is not None
    (tmp_path / "hover.js").write_text(script.text)
    subprocess.run(["node", "--check", str(tmp_path / "hover.js")], check=True)


def test_an_episode_shows_a_picture_a_moment_and_its_way(page_of_one: Path) -> None:
    cards = parse(page_of_one).findall(".//section[@id='episodes']/div")
    assert cards
    for episode in cards:
        text = " ".join(episode.itertext())
        told = re.search(r"(\d+) steps?", text)
        assert told is not None
        assert len(list(episode.iter("img"))) == int(told.group(1)) + 1
        assert len(list(episode.iter(f"{SVG}svg"))) == 1
        assert re.search("success|failure|timeout", text)


def test_several_runs_make_bands_over_seeds(bare: Path, page_of_one: Path, tmp_path: Path) -> None:
    shutil.copytree(bare / "run", bare / "other")
    config = bare / "other" / "config.yaml"
    config.write_text(config.read_text().replace("seed: 1", "seed: 2"))
    text = report(bare, tmp_path / "page.html").read_text(encoding="utf-8")
    assert text.count('class="band"') >= 4  # success, and the three outcomes
    assert "2 runs" in text
    one = page_of_one.read_text(encoding="utf-8")
    assert 'class="band"' not in one
    assert "one seed: curves have no band" in one


def test_curves_carry_the_numbers_of_the_log(bare: Path, tmp_path: Path) -> None:
    page = parse(report(bare, tmp_path / "page.html"))
    curves = [line for line in page.iter(f"{SVG}polyline") if line.get("data-label") == "VHS"]
    rows = read_log(bare / "run")
    assert [float(x) for x in curves[0].attrib["data-x"].split()] == [row["episodes"] for row in rows]
    told = [float(y) for y in curves[0].attrib["data-y"].split()]
    assert told == pytest.approx([row["rate/success"] for row in rows], rel=1e-5)
    assert curves[0].get("data-kind") == "share"


def test_every_logged_metric_is_explained(runs: Path) -> None:
    page = read(DOCS / "reference" / "metrics.md")
    page = page[page.index("## Counters") : page.index("## Evaluations")]
    explained = {
        name for line in page.splitlines() if line[:1] == "`" for name in re.findall(r"`([\w/]+)`", line)
    }
    logged = {re.sub(r"^goals/\d+$", "goals/N", key) for row in read_log(runs / "seed0") for key in row}
    assert logged | {f"loss/{term}" for term in TERMS} == explained


def test_an_environment_without_map_and_way_shows_what_there_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from toy import toy_config, toy_task

    task = toy_task()
    assert task.reached is None
    assert task.shortest is None
    train(toy_config("vhs", "train.episodes=24", "method.warmup=2"), tmp_path / "run", StringIO(), task=task)
    monkeypatch.setattr(decoder, "STEPS", 3)
    page = parse(report(tmp_path / "run", tmp_path / "page.html", episodes=6, task=task))
    said = section_text(page, "confusion")
    assert "Outcomes by goal" in said
    assert "Steps that episodes took" in said
    assert "learns what it reached" not in said
    tips = [bar.attrib["data-tip"] for bar in page.iter(f"{SVG}rect") if bar.get("class") == "bar"]
    by_goal = [tip for tip in tips if " of " in tip]
    assert sum(int(re.findall(r": (\d+) of", tip)[0]) for tip in by_goal) == 6
    assert sum(int(re.findall(r": (\d+) ", tip)[0]) for tip in tips if tip not in by_goal) == 6
    episodes = page.findall(".//section[@id='episodes']/div")
    assert episodes
    assert all(not list(episode.iter(f"{SVG}svg")) for episode in episodes), "no view from above"


def test_runs_of_several_configurations_are_told_apart(bare: Path, tmp_path: Path) -> None:
    shutil.copytree(bare / "run", bare / "other")
    config = bare / "other" / "config.yaml"
    text = config.read_text().replace("relabel_probability: 0.8", "relabel_probability: 0.4")
    text = text.replace("relabel_on:\n  - failure\n", "relabel_on:\n  - failure\n  - timeout\n")
    config.write_text(text)
    page = parse(report(bare, tmp_path / "page.html"))
    curves = section_text(page, "curves")
    assert "VHS, relabel_probability=0.4, relabel_on=failure+timeout" in curves
    assert "(one seed)" in curves


def test_a_run_without_checkpoint_says_what_is_missing(bare: Path, tmp_path: Path) -> None:
    page = parse(report(bare / "run", tmp_path / "page.html"))
    for anchor in ("confusion", "episodes", "goals", "prototypes", "features"):
        assert "Not shown: no run has a checkpoint" in section_text(page, anchor), anchor
    for anchor in ("curves", "losses", "speed", "setup"):
        assert "Not shown" not in section_text(page, anchor), anchor
    assert "no checkpoint" in section_text(page, "setup")


def test_a_store_that_is_not_warm_is_named(runs: Path, tmp_path: Path) -> None:
    shutil.copytree(runs / "seed0", tmp_path / "run")
    state, goal_store = load_checkpoint(tmp_path / "run")
    state["learner"]["prototypes"]["seen"].zero_()
    save_checkpoint(tmp_path / "run", 121, state, goal_store, keep=1)
    page = parse(report(tmp_path / "run", tmp_path / "page.html", episodes=1))
    assert re.search(r"store holds \d+ images and prototypes start at 2", section_text(page, "prototypes"))
    assert "Not shown" not in section_text(page, "goals")


def test_damaged_parts_are_named_and_the_rest_is_shown(runs: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(runs / "seed0", run)
    lines = (run / "log.jsonl").read_text().splitlines()
    (run / "log.jsonl").write_text(
        "\n".join([lines[0], "{damaged", '{"episodes": 60, "rate/success": null}', lines[1], ""])
    )
    (run / "run.json").write_text("{")
    max(run.glob("checkpoints/*/goals.vhs")).write_bytes(b"short")
    page = parse(report(run, tmp_path / "page.html"))
    notes = section_text(page, "setup")
    assert "log.jsonl:2: damaged line: expected a JSON object" in notes
    assert "log.jsonl:3: damaged line: expected a share as `rate/success`, found None" in notes
    assert "run.json: expected JSON" in notes
    assert str(tmp_path) not in notes, "a page is for others: no paths of this machine"
    assert "damaged checkpoint" in section_text(page, "goals")
    assert "Not shown" not in section_text(page, "curves")


def test_a_directory_without_runs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"expected config\.yaml or log\.jsonl in it or below"):
        report(tmp_path)
    with pytest.raises(CheckpointError, match="found no directory"):
        report(tmp_path / "nothing")
    assert not list(tmp_path.iterdir())


def test_a_page_that_cannot_be_written_is_refused_before_the_work(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for out, told in (
        (tmp_path / "no" / "page.html", "expected an existing folder"),
        (tmp_path, "directory"),
    ):
        assert main(["report", str(runs), "--out", str(out)]) == 1
        assert told in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
