"""What tells a changed entry of a run's JSON files: each object that is written carries its own digest.

Rows of `log.jsonl`, entries of `eval.json` and the object of `run.json` hold, as the last key, the SHA-256 of
the rest. One without it is taken as it is: vhs up to 0.1.0 wrote none, and a person may.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

KEY = "sha256"


def sealed(entry: Mapping[str, Any]) -> dict[str, Any]:
    """An entry as it is written: the digest of the rest behind it.

    Args:
        entry: what JSON can hold, keys of text.
    """
    rest = {key: value for key, value in entry.items() if key != KEY}
    return rest | {KEY: _digest(rest)}


def unsealed(entry: Mapping[str, Any]) -> dict[str, Any]:
    """An entry as it was before it was written.

    Raises:
        ValueError: it is another than the one that was written.
    """
    rest = {key: value for key, value in entry.items() if key != KEY}
    if KEY in entry and entry[KEY] != _digest(rest):
        raise ValueError(
            f"what was written, found another entry than `{KEY}` is of (drop that key after a change by hand)"
        )
    return rest


def _digest(rest: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()
