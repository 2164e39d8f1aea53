"""Training from Python: ``vhs.train``."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any, TextIO

from vhs.config import Config, load_config, resolve_config
from vhs.config.load import read_task, unflatten
from vhs.models import ExtractorFactory
from vhs.task import Task
from vhs.train.loop import train


def train_on(
    task: Task | str,
    config: Config | Mapping[str, Any] | str | PathLike[str] | None = None,
    *,
    out: str | PathLike[str],
    extractor: ExtractorFactory | None = None,
    stream: TextIO | None = None,
) -> bool:
    """Train on a task until `train.episodes` or a signal, or resume what the directory already holds.

    Args:
        task: what to train on; or where it is, as ``vhs train --task`` takes it: then `vhs eval` and the
            others find it by themselves, and otherwise are told where it is by ``--task`` or ``task=``.
        config: a whole configuration, a YAML file, or keys such as ``{"train.episodes": 2000}``.
        out: directory of the run; made when missing.
        extractor: makes a feature extractor of one's own, to be given to `load_agent` again; the key
            `model.extractor` names one for good.
        stream: where a person reads along; standard output by default.

    Returns:
        True when the run is finished, False when a signal stopped it.

    Raises:
        ConfigError: a key or a value that is none, or a task that is not where it is said to be.
        ArgumentError: a field of the task does not fit its environment; nothing was written.
        VhsError: as for `vhs.train.loop.train`.
    """
    named = read_task(task) if isinstance(task, str) else {}
    if isinstance(config, Config):
        resolved = resolve_config([config.model_dump(), named])
    elif config is None or isinstance(config, Mapping):
        resolved = resolve_config([], [unflatten(config or {}), named])
    else:
        resolved = resolve_config([load_config([Path(config)]).model_dump(), named])
    given = task if isinstance(task, Task) else None
    return train(resolved, Path(out), stream, task=given, extractor=extractor)
