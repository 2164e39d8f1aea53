"""Training of runs; the module itself trains too: ``vhs.train(task, config, out=...)``."""

import sys
from types import ModuleType
from typing import Any

from vhs.train.api import train_on
from vhs.train.loop import train

__all__ = ["train", "train_on"]


class _Trains(ModuleType):
    """This module, which can be called as `train_on`: the name `vhs.train` is the function's and its own."""

    def __call__(self, *args: Any, **kwargs: Any) -> bool:
        return train_on(*args, **kwargs)


sys.modules[__name__].__class__ = _Trains
