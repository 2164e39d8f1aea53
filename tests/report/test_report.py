"""The page: complete, well-formed, by itself; what is missing is named in it, bad input is refused."""

import json
import re
import shutil
from pathlib import Path
from xml.etree import ElementTree

import pytest

from vhs.cli import main
from vhs.errors import CheckpointError
from vhs.report import decoder, report

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
XHTML = "{http://www.w3.org/2000/svg}"


@pytest.fixture(autouse=True)
def _quick_decoder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decoder, "STEPS", 3)


def parse(page: Path) -> ElementTree.Element:
    return ElementTree.fromstring(page.read_text(encoding="utf-8").removeprefix("<!DOCTYPE html>"))


def section_text(page: ElementTree.Element, anchor: str) -> str:
    found = page.find(f".//section[@id='{anchor}']")
    assert found is not None, anchor
    return " ".join(found.itertext())


def test_a_run_makes_one_whole_page(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "page.html"
    assert main(["report", str(runs / "seed0"), "--out", str(out), "--episodes", "3"]) == 0
    assert str(out) in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == [out]
    page = parse(out)
    assert [section.get("id") for section in page.iter("section")] == list(SECTIONS)
    for anchor in SECTIONS:
        assert "Not shown" not in section_text(page, anchor), anchor
    assert out.stat().st_size < 5e6


def test_the_page_refers_to_nothing_outside_itself(runs: Path, tmp_path: Path) -> None:
    out = report(runs / "seed0", tmp_path / "page.html", episodes=2)
    page = parse(out)
    assert not list(page.iter("script"))
    links = [value for node in page.iter() for name, value in node.attrib.items() if name in ("src", "href")]
    assert links
    assert all(link.startswith(("data:", "#")) for link in links)
    assert not re.search(r"url\(|@import", out.read_text(encoding="utf-8"))
    anchors = {node.get("id") for node in page.iter()}
    assert all(link[1:] in anchors for link in links if link.startswith("#"))


def test_an_episode_shows_a_picture_a_moment_and_its_way(runs: Path, tmp_path: Path) -> None:
    page = parse(report(runs / "seed0", tmp_path / "page.html", episodes=1))
    episodes = page.find(".//section[@id='episodes']")
    assert episodes is not None
    steps = int(re.search(r"(\d+) steps?", section_text(page, "episodes")).group(1))  # type: ignore[union-attr]
    assert len(list(episodes.iter("img"))) == steps + 1
    assert len(list(episodes.iter(f"{XHTML}svg"))) == 1
    assert re.search("success|failure|timeout", section_text(page, "episodes"))


def test_several_runs_make_bands_over_seeds(runs: Path, tmp_path: Path) -> None:
    text = report(runs, tmp_path / "page.html", episodes=2).read_text(encoding="utf-8")
    assert text.count('class="band"') >= 4  # success, and the three outcomes
    assert "2 runs" in text
    one = report(runs / "seed0", tmp_path / "one.html", episodes=2).read_text(encoding="utf-8")
    assert 'class="band"' not in one
    assert "one seed: curves have no band" in one


def test_runs_of_several_configurations_are_told_apart(runs: Path, tmp_path: Path) -> None:
    for name in ("seed0", "seed1"):
        _copy_without_checkpoint(runs / name, tmp_path / "runs" / name)
    config = tmp_path / "runs" / "seed1" / "config.yaml"
    config.write_text(config.read_text().replace("relabel_probability: 0.8", "relabel_probability: 0.4"))
    page = parse(report(tmp_path / "runs", tmp_path / "page.html"))
    curves = section_text(page, "curves")
    assert "VHS, relabel_probability 0.4" in curves
    assert "(one seed)" in curves


def test_a_run_without_checkpoint_says_what_is_missing(runs: Path, tmp_path: Path) -> None:
    _copy_without_checkpoint(runs / "seed0", tmp_path / "run")
    page = parse(report(tmp_path / "run", tmp_path / "page.html"))
    for anchor in ("confusion", "episodes", "goals", "prototypes", "features"):
        assert "Not shown: no run has a checkpoint" in section_text(page, anchor), anchor
    for anchor in ("curves", "losses", "speed", "setup"):
        assert "Not shown" not in section_text(page, anchor), anchor
    assert "no checkpoint" in section_text(page, "setup")


def test_a_store_that_is_not_warm_is_named(runs: Path, tmp_path: Path) -> None:
    import torch

    shutil.copytree(runs / "seed0", tmp_path / "run")
    state_file = max((tmp_path / "run").glob("checkpoints/*/state.pt"))
    state = torch.load(state_file, weights_only=True)
    state["learner"]["prototypes"]["seen"].zero_()
    torch.save(state, state_file)
    page = parse(report(tmp_path / "run", tmp_path / "page.html", episodes=1))
    assert re.search(r"store holds \d+ images and prototypes start at 2", section_text(page, "prototypes"))
    assert "Not shown" not in section_text(page, "goals")


def test_damaged_parts_are_named_and_the_rest_is_shown(runs: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(runs / "seed0", run)
    lines = (run / "log.jsonl").read_text().splitlines()
    (run / "log.jsonl").write_text(
        "\n".join([lines[0], "{damaged", '{"episodes": 60, "rate/success": null}', lines[1]])
    )
    (run / "run.json").write_text("{")
    max(run.glob("checkpoints/*/goals.vhs")).write_bytes(b"short")
    page = parse(report(run, tmp_path / "page.html"))
    notes = section_text(page, "setup")
    assert "line 2 is damaged" in notes
    assert "line 3 is damaged" in notes
    assert "no readable run.json" in notes
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


def _copy_without_checkpoint(run: Path, to: Path) -> None:
    to.mkdir(parents=True)
    for name in ("config.yaml", "log.jsonl", "run.json"):
        shutil.copy(run / name, to)
    assert json.loads((to / "log.jsonl").read_text().splitlines()[0])
