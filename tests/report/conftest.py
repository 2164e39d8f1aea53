"""Two small runs that differ in their seed, warm enough for prototypes, and the page of one of them."""

import shutil
from io import StringIO
from pathlib import Path

import pytest
from debug import debug_config

from vhs.cli import main
from vhs.report import decoder
from vhs.train import train


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`seed0` was trained; `seed1` is its copy under another seed, without checkpoint."""
    directory = tmp_path_factory.mktemp("report")
    # A wide reach: chance succeeds often enough to fill the store.
    settings = [
        "train.episodes=120",
        "train.checkpoint_every_s=1e6",
        "method.warmup=2",
        "env.num_workers=0",
        "env.room.reach_half_angle_deg=90",
    ]
    train(debug_config(*settings), directory / "seed0", StringIO())
    (directory / "seed1").mkdir()
    for name in ("config.yaml", "log.jsonl", "run.json"):
        text = (directory / "seed0" / name).read_text()
        (directory / "seed1" / name).write_text(text.replace("seed: 0", "seed: 1"))
    return directory


@pytest.fixture(scope="session")
def page_of_one(runs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `vhs report` writes of the trained run, alone in its directory."""
    out = tmp_path_factory.mktemp("page") / "page.html"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(decoder, "STEPS", 3)
        assert main(["report", str(runs / "seed0"), "--out", str(out), "--episodes", "3"]) == 0
    return out


@pytest.fixture
def bare(runs: Path, tmp_path: Path) -> Path:
    """A directory with a run that has no checkpoint."""
    shutil.copytree(runs / "seed1", tmp_path / "runs" / "run")
    return tmp_path / "runs"
