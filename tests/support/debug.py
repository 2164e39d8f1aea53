"""The debug configuration, for every folder of tests."""

from pathlib import Path

from vhs.config import Config, load_config

CONFIGS = Path(__file__).parents[2] / "configs"
DEBUG = CONFIGS / "debug.yaml"


def debug_config(*overrides: str) -> Config:
    """`configs/debug.yaml` with assignments such as ``train.episodes=8``."""
    return load_config([DEBUG], overrides)
