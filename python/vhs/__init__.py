"""Hindsight goals for reinforcement learning from images.

This module is the storage and relabelling library: it needs numpy alone. The environments (`vhs.envs`) and
the training code are imported on their own.
"""

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
    SparseReward,
    TransitionBatch,
    VhsError,
    WindowBatch,
    __version__,
    discounted_returns,
    relabel,
)
from vhs.outcome import Outcome

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
    "Rng",
    "ShapeError",
    "SparseReward",
    "TransitionBatch",
    "VhsError",
    "WindowBatch",
    "discounted_returns",
    "relabel",
]
