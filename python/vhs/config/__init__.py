"""The configuration of a run: its schema, the files that set it, and the names that tell variants apart."""

from vhs.config.load import dump_config, known_keys, load_config, resolve_config
from vhs.config.schema import Config, EnvSection, MethodSection, TrainSection

__all__ = [
    "Config",
    "EnvSection",
    "MethodSection",
    "TrainSection",
    "dump_config",
    "known_keys",
    "load_config",
    "resolve_config",
]
