"""Agents of the Hugging Face Hub, ``hf://user/name``: looked at before they are fetched.

A stranger may have made them: only the files of an exported agent are fetched, none larger than such a file
may be, and nothing of them is executed. They lie in the cache of huggingface_hub, once for each revision.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeGuard

from vhs.errors import CheckpointError, ConfigError
from vhs.runs.agent_file import MOST_BYTES as AGENT_BYTES
from vhs.runs.directory import AGENT_NAME, CONFIG_NAME, META_NAME
from vhs.runs.evaluations import EVALUATIONS_NAME

SCHEME = "hf://"
_NAMED = re.compile(r"hf://([\w.-]+/[\w.-]+)(?:@([\w./-]+))?")
_LIMITS = {AGENT_NAME: AGENT_BYTES, CONFIG_NAME: 200_000, META_NAME: 10_000_000, EVALUATIONS_NAME: 10_000_000}
"""Files that are fetched, and bytes that each may have."""
_NEEDED = (AGENT_NAME, CONFIG_NAME)


def is_on_hub(named: Path | str) -> TypeGuard[str]:
    """Whether an agent is named as one of the Hub."""
    return isinstance(named, str) and named.startswith(SCHEME)


def repository(named: str) -> tuple[str, str | None]:
    """User and name, and the revision if one is given, of ``hf://user/name@revision``.

    Raises:
        ConfigError: it is something else.
    """
    found = _NAMED.fullmatch(named)
    if found is None:
        raise ConfigError(f"{named}: expected hf://user/name, or hf://user/name@revision")
    return found[1], found[2]


def fetch_agent(named: str) -> Path:
    """Fetch an exported agent.

    Args:
        named: ``hf://user/name``, or ``hf://user/name@revision``.

    Returns:
        The directory in which it lies, for `load_agent`; what is cached is not fetched again.

    Raises:
        ConfigError: it is not named so.
        CheckpointError: it is not there, is no exported agent, or a file of it is too large.
        ModuleNotFoundError: huggingface_hub is not installed.
    """
    from huggingface_hub import HfApi
    from huggingface_hub.hf_api import RepoFile

    repo, revision = repository(named)
    with answering(named, CheckpointError):
        api = HfApi()
        commit = api.model_info(repo, revision=revision).sha
        tree = list(api.list_repo_tree(repo, revision=commit))
    sizes = {item.path: item.size for item in tree if isinstance(item, RepoFile)}
    missing = [name for name in _NEEDED if name not in sizes]
    if missing:
        raise CheckpointError(f"{named}: expected an exported agent, found no {' and no '.join(missing)}")
    for name, most in _LIMITS.items():
        if sizes.get(name, 0) > most:
            raise CheckpointError(
                f"{named}: {name}: expected at most {most:,} bytes, found {sizes[name]:,}; none was fetched"
            )
    with answering(named, CheckpointError):
        return Path(api.snapshot_download(repo, revision=commit, allow_patterns=list(_LIMITS)))


@contextmanager
def answering(named: str, kind: type[Exception]) -> Iterator[None]:
    """Say in a sentence what the Hub refused, or that it cannot be reached.

    Raises:
        Exception: of that kind.
    """
    try:
        yield
    except Exception as error:  # whatever huggingface_hub and what it stands on raise
        reason = str(error).strip().partition("\n")[0] or type(error).__name__
        raise kind(f"{named}: the Hub says: {reason}") from error
