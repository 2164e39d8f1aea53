"""What samplers return, entry by entry: the one way to it for tensors and for data sets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vhs._core import EpisodeBatch, Hindsight, TransitionBatch, WindowBatch

__all__ = ["Arrays", "arrays_of"]

Arrays = dict[str, Any]
"""Arrays by name, and dictionaries of them."""

_KINDS = (EpisodeBatch, Hindsight, TransitionBatch, WindowBatch)


def arrays_of(batch: Any) -> Arrays | NDArray[Any]:
    """A batch as a dictionary of arrays; mappings and tuples of such are taken too.

    Args:
        batch: Of a sampler of `EpisodeBuffer`, whose attributes become entries, without those that are None;
            `fields` is a dictionary in it. Or an array, or a mapping or a tuple (whose entries are "0",
            "1"...) of what is taken here.

    Raises:
        TypeError: For something else.
    """
    if isinstance(batch, np.ndarray):
        return batch
    if isinstance(batch, _KINDS):
        batch = {name: getattr(batch, name) for name in dir(batch) if not name.startswith("_")}
    if isinstance(batch, tuple):
        batch = {str(place): part for place, part in enumerate(batch)}
    if isinstance(batch, Mapping):
        return {name: arrays_of(part) for name, part in batch.items() if part is not None}
    raise TypeError(
        f"expected a batch of a sampler, an array, or a mapping or tuple of them, got {type(batch).__name__}"
    )
