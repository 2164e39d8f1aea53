"""Two small runs that differ in their seed, warm enough for prototypes."""

from io import StringIO
from pathlib import Path

import pytest

from vhs.config import load_config
from vhs.train import train

CONFIGS = Path(__file__).parents[2] / "configs"


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("report")
    for seed in (0, 1):
        settings = [f"seed={seed}", "train.episodes=160", "method.warmup=2", "env.num_workers=0"]
        settings += ["env.room.reach_half_angle_deg=90"]  # chance succeeds often enough to fill the store
        config = load_config([CONFIGS / "debug.yaml"], settings)
        train(config, directory / f"seed{seed}", StringIO())
    return directory
