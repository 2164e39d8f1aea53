"""Hindsight goals for reinforcement learning from images.

This module is the storage and relabelling library: it needs numpy alone. The environments (`vhs.envs`) and
the training code are imported on their own.
"""

from typing import TYPE_CHECKING, Any

from vhs._core import (
    ArgumentError,
    DamagedFileError,
    DtypeError,
    EmptyError,
    EpisodeBatch,
    EpisodeBuffer,
    EpisodeError,
    GoalStore,
    Hindsight,
    LabelError,
    LayoutError,
    NonFiniteError,
    OutOfMemoryError,
    ProtocolError,
    Prototypes,
    Rng,
    ShapeError,
    UnsupportedError,
    VhsError,
    __version__,
    discounted_returns,
    relabel,
)
from vhs.outcome import Outcome
from vhs.raster import RasterRenderer

if TYPE_CHECKING:
    from vhs.rollout import RolloutPool

__all__ = [
    "ArgumentError",
    "DamagedFileError",
    "DtypeError",
    "EmptyError",
    "EpisodeBatch",
    "EpisodeBuffer",
    "EpisodeError",
    "GoalStore",
    "Hindsight",
    "LabelError",
    "LayoutError",
    "NonFiniteError",
    "OutOfMemoryError",
    "Outcome",
    "ProtocolError",
    "Prototypes",
    "RasterRenderer",
    "Rng",
    "RolloutPool",
    "ShapeError",
    "UnsupportedError",
    "VhsError",
    "__version__",
    "discounted_returns",
    "relabel",
]


def __getattr__(name: str) -> Any:
    # The pool needs gymnasium, which the library alone does without.
    if name == "RolloutPool":
        from vhs.rollout import RolloutPool

        return RolloutPool
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
