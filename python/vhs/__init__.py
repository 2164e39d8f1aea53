"""Hindsight goals for reinforcement learning from images.

This module is the storage and relabelling library: it needs numpy alone. The environments (`vhs.envs`) and
the training code are imported on their own; `HindsightRecorder` brings gymnasium when it is first used, and
`train` torch.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from vhs._core import (
    ArgumentError,
    DamagedFileError,
    DtypeError,
    EmptyError,
    EpisodeBatch,
    EpisodeBuffer,
    EpisodeError,
    Field,
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
    UnsupportedError,
    VhsError,
    WindowBatch,
    discounted_returns,
    egomotion,
    relabel,
)
from vhs._core import __version__ as __version__
from vhs.raster import RasterRenderer
from vhs.task import Move, Outcome, OutcomeReward, Seen, Task, TaskSpec, Turn

if TYPE_CHECKING:
    from vhs.recorder import HindsightRecorder
    from vhs.rollout import RolloutPool
    from vhs.train.api import train_on as train

_LAZY = {"HindsightRecorder": "vhs.recorder", "RolloutPool": "vhs.rollout"}

__all__ = [
    "ArgumentError",
    "DamagedFileError",
    "DtypeError",
    "EmptyError",
    "EpisodeBatch",
    "EpisodeBuffer",
    "EpisodeError",
    "Field",
    "GoalStore",
    "Hindsight",
    "HindsightRecorder",
    "LabelError",
    "LayoutError",
    "Move",
    "NonFiniteError",
    "OutOfMemoryError",
    "Outcome",
    "OutcomeReward",
    "ProtocolError",
    "Prototypes",
    "RasterRenderer",
    "Rng",
    "RolloutPool",
    "Seen",
    "ShapeError",
    "SparseReward",
    "Task",
    "TaskSpec",
    "TransitionBatch",
    "Turn",
    "UnsupportedError",
    "VhsError",
    "WindowBatch",
    "discounted_returns",
    "egomotion",
    "relabel",
    "train",
]


def __getattr__(name: str) -> Any:
    # What needs gymnasium is loaded when it is asked for: the library alone does without.
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    if name == "train":
        return import_module("vhs.train")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
