"""Environment variables that OpenGL needs, set before anything imports mujoco.

Owns the defaults below; a value that the user has set is left alone. Imported first by `vhs.envs`, because
mujoco chooses its OpenGL platform once, on import.
"""

from __future__ import annotations

import ctypes
import os
import sys
from contextlib import suppress
from importlib import import_module


def choose_defaults() -> None:
    """Choose EGL where there is no display, and no worker threads for Mesa's software renderer."""
    if not sys.platform.startswith("linux"):
        return
    if not os.environ.get("DISPLAY"):
        # Asking for EGL where it is missing makes `import mujoco` itself fail; without OpenGL the dynamics
        # still work, and only drawing has to be refused.
        os.environ.setdefault("MUJOCO_GL", "egl" if has_library("libEGL.so.1") else "disable")
    # 0 worker threads: at 84x84 pixels handing tiles to other threads costs more than drawing them.
    os.environ.setdefault("LP_NUM_THREADS", "0")


def load_triton_first() -> None:
    """Load torch's compiler library, where it is installed, before the first GL context.

    Mesa and triton, which torch loads with its first optimiser, each bring an LLVM of their
    own. A triton that is loaded after Mesa has drawn crashes the process; the other order is safe.
    """
    with suppress(ImportError):
        import_module("triton._C.libtriton")


def has_library(name: str) -> bool:
    """Whether the loader finds a shared library."""
    try:
        ctypes.CDLL(name)
    except OSError:
        return False
    return True


choose_defaults()
