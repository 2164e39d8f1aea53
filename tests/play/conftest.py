"""One small trained run for all tests of this folder."""

from io import StringIO
from pathlib import Path

import pytest
from debug import debug_config

from vhs.train import train


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("play") / "run"
    settings = ["task=task3", "train.episodes=8", "train.checkpoint_every_s=1e6", "env.num_workers=0"]
    train(debug_config(*settings), directory, StringIO())
    return directory
