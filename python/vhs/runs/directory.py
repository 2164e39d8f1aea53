"""The directory of a run: which configuration made it, and with what."""

from __future__ import annotations

import json
import platform
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from vhs import __version__
from vhs.config import Config, dump_config, load_config
from vhs.config.schema import DECIDED_BY_TASK, unread_keys
from vhs.config.task import file_of
from vhs.config.variants import differing_keys, flat_config
from vhs.distribution import names_of_ours
from vhs.errors import CheckpointError, ConfigError
from vhs.reading import read_bounded
from vhs.runs.checkpoint import has_checkpoint, newest_checkpoint, remove_partial_checkpoints
from vhs.runs.files import is_partial, remove_partial, write_files, writing
from vhs.runs.lock import hold
from vhs.runs.rows import LOG_NAME
from vhs.runs.seal import sealed, unsealed

CONFIG_NAME = "config.yaml"
META_NAME = "run.json"
LOCK_NAME = ".lock"
PACKAGE = Path(__file__).parents[1]
AGENT_NAME = "agent.safetensors"
"""Only in the directory of an exported agent."""

_MOST_BYTES = 10_000_000

MAY_CHANGE = frozenset(
    {
        "env.deadline_s",
        "env.num_workers",
        "train.episodes",
        "train.checkpoint_every_s",
        "train.keep_checkpoints",
        "train.threads",
        "train.device",
        "train.log_every",
        "train.loggers",
        "train.media_every",
        "train.peer_timeout_s",
    }
)
"""Keys that a resumed run may set anew: none of them changes what is learned from an episode, but for
rounding where `train.threads` or `train.device` changes, and for its order without lock-step."""


def default_run_directory(config: Config) -> Path:
    """Where a run goes when nobody says: the same command finds the same directory again."""
    return Path("runs") / f"{config.task_name}-{config.method.name}-seed{config.seed}"


def check_run(config: Config, run: Path) -> None:
    """Check that a directory is free, or holds a run of the same configuration.

    Raises:
        CheckpointError: another configuration made the run, it is an exported agent, or the directory holds
            something else.
    """
    if run.exists() and not _is_ours(run):
        kind = "files of something else" if run.is_dir() else "a file"
        raise CheckpointError(
            f"{run}: expected a new or an empty directory, or that of a run, found {kind}; give another --out"
        )
    if is_exported(run):
        raise CheckpointError(f"{run}: holds an exported agent, which cannot train on; give another --out")
    # A start that failed before anything was learned holds nobody to what it was started with.
    if (run / CONFIG_NAME).exists() and (has_checkpoint(run) or _has_rows(run)):
        old = read_config(run)
        changed = set(differing_keys([fixed_settings(old), fixed_settings(config)])) - _left_to_task(config)
        if old.task != config.task and not _has_moved(old, config):
            changed.add("task")
        if changed:
            raise CheckpointError(
                f"{run}: holds a run with other values of {', '.join(sorted(changed))}; "
                "give another --out, or the configuration it was made with"
            )


def as_begun(config: Config, run: Path) -> Config:
    """The same configuration with what the task decided when a run began, where that run goes on.

    A version may let a task decide otherwise than the one before, and a run keeps to what it began with.

    Raises:
        CheckpointError: the directory holds a configuration that cannot be read.
    """
    if not ((run / CONFIG_NAME).exists() and has_checkpoint(run)):
        return config
    old = read_config(run)
    update: dict[str, Any] = {}
    for key in _left_to_task(config):
        name, _, leaf = key.partition(".")
        section = update.get(name, getattr(config, name))
        update[name] = section.model_copy(update={leaf: getattr(getattr(old, name), leaf)})
    return config.model_copy(update=update)


@contextmanager
def open_run(
    config: Config, run: Path, *, precision: str, episodes: int, start: Mapping[str, Any] | None = None
) -> Iterator[None]:
    """Make the directory, say in it what makes the run, remove what a kill left half-written, and hold it.

    Args:
        config: what the run is made with.
        run: its directory.
        precision: type in which this machine's convolutions multiply.
        episodes: of the checkpoint that the run goes on from; 0 for a new run.
        start: what another run learned that it begins with; None: nothing.

    Raises:
        CheckpointError: another process has gone on since the checkpoint was read.
        OutputError: the directory cannot be written, or another process trains in it.
    """
    with writing(run):
        run.mkdir(parents=True, exist_ok=True)
    with hold(run / LOCK_NAME, f"{run}: another process trains here; wait for it, or give another --out"):
        if newest_checkpoint(run) != episodes:
            raise CheckpointError(f"{run}: another process has just trained here; start again")
        remove_partial_checkpoints(run)
        remove_partial(run, "|".join(map(re.escape, (CONFIG_NAME, META_NAME, LOG_NAME))))
        files = {CONFIG_NAME: dump_config(config)}
        if episodes < config.train.episodes:  # a start that trains nothing makes nothing
            made = describe() | {"precision": precision} | ({} if start is None else {"start": start})
            meta = _meta(run, made, episodes)
            files[META_NAME] = json.dumps(sealed(meta), indent=2) + "\n"
        write_files(run, files)
        yield


def _is_ours(run: Path) -> bool:
    """Whether a run made the directory, as far as a kill let it, or nobody has put anything there."""
    if not run.is_dir():
        return False
    names = {path.name for path in run.iterdir() if not is_partial(path)}
    if names <= {LOCK_NAME} or is_exported(run) or has_checkpoint(run):
        return True
    # Somebody's own overlay is a `config.yaml` as well.
    return CONFIG_NAME in names and not names.isdisjoint({META_NAME, LOCK_NAME})


def _meta(run: Path, start: dict[str, Any], episodes: int) -> dict[str, Any]:
    """What made the run first, and under `resumed` every later start, maybe of another machine or commit."""
    if not episodes:
        return start
    try:
        first = read_meta(run)
    except CheckpointError:  # lost: the later starts are better than nothing
        first = {}
    return first | {"resumed": [*first.get("resumed", []), {"episodes": episodes, **start}]}


def read_config(run: Path) -> Config:
    """The configuration that made a run.

    Raises:
        CheckpointError: `run` is not the directory of a run.
    """
    path = run / CONFIG_NAME
    if not path.exists():
        ours = names_of_ours(run, "pretrained/*")
        raise CheckpointError(f"{run}: expected the directory of a run, found no {CONFIG_NAME} in it{ours}")
    try:
        return load_config([path], may_be_pipe=False)
    except ConfigError as error:
        raise CheckpointError(f"{path}: damaged configuration: {error}") from error


def is_exported(path: Path) -> bool:
    """Whether a directory holds an exported agent instead of a run."""
    return (path / AGENT_NAME).exists()


def fixed_settings(config: Config) -> dict[str, Any]:
    """What a run keeps for good, by dotted key: a checkpoint says it beside the weights that it made.

    Of a task in a file it is the name, for a file may move.
    """
    unread = {key for key, _ in unread_keys(config.method.parts)}
    settings = {key: value for key, value in flat_config(config).items() if key not in MAY_CHANGE | unread}
    return settings | ({"task": config.task_name} if "task" in settings else {})


def check_settings(run: Path, config: Config, made_with: Mapping[str, Any]) -> None:
    """Check that the configuration in a directory is the one that made the checkpoint there.

    Args:
        run: the directory.
        config: the one in it.
        made_with: `fixed_settings` as the checkpoint has them.

    Raises:
        CheckpointError: it has changed since; the keys are named.
    """
    found = fixed_settings(config)
    changed = sorted(key for key in found.keys() & made_with.keys() if found[key] != made_with[key])
    if changed:
        raise CheckpointError(
            f"{run / CONFIG_NAME}: has other values of {', '.join(changed)} than the checkpoint was made with"
        )


def read_meta(run: Path) -> dict[str, Any]:
    """What made a run: `describe` at its first start, and at every later one in the list ``resumed``.

    Raises:
        CheckpointError: the file is missing or damaged.
    """
    path = run / META_NAME
    try:
        meta: Any = json.loads(read_bounded(path, _MOST_BYTES))
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise CheckpointError(f"{path}: expected JSON, found {error}") from error
    if isinstance(meta, dict):
        try:
            whole = unsealed(meta)
        except ValueError as error:
            raise CheckpointError(f"{path}: expected {error}") from error
        starts = whole.get("resumed", [])
        if isinstance(starts, list) and all(isinstance(start, dict) for start in starts):
            return whole
    raise CheckpointError(f"{path}: expected a JSON object, with a list of objects as `resumed` if any")


def describe() -> dict[str, Any]:
    """What made a result: command, version, commit, machine and time."""
    return {
        "command": shlex.join(["vhs", *sys.argv[1:]]),
        "version": __version__,
        "commit": _commit(),
        "python": platform.python_version(),
        "machine": f"{platform.machine()}, {_processor()}",
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _has_rows(run: Path) -> bool:
    log = run / LOG_NAME
    return log.exists() and log.stat().st_size > 0


def _left_to_task(config: Config) -> set[str]:
    """Keys whose value the task decides; in a run they hold what it decided."""
    flat = flat_config(config)
    return {key for key in DECIDED_BY_TASK if flat.get(key) is None}


def _has_moved(old: Config, new: Config) -> bool:
    """Whether the file of the task was moved to where it is now said to be."""
    before, now = file_of(old.task), file_of(new.task)
    if before is None or now is None:
        return False
    return not before[0].exists() and (before[0].name, before[1]) == (now[0].name, now[1])


def _commit() -> str | None:
    """The commit of the checkout that this package lies in, if it lies in one of its own.

    An environment inside another repository is no checkout of this one.
    """
    if _git("rev-parse", "--show-prefix") != "python/vhs/":
        return None
    return _git("describe", "--always", "--dirty", "--abbrev=12") or None


def _git(*arguments: str) -> str:
    """What git says about the directory of the package; nothing where there is no git or no repository."""
    command = ["git", *arguments]
    try:
        answer = subprocess.run(command, cwd=PACKAGE, capture_output=True, text=True, timeout=10)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return answer.stdout.strip()


def _processor() -> str:
    """The processor's name where Linux tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{names[0]} x{len(names)}" if names else platform.processor()
