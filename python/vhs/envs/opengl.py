"""Environment variables that OpenGL needs, set before anything imports mujoco.

Owns the two defaults below; a value that the user has set is left alone. Imported first by `vhs.envs`,
because mujoco chooses its OpenGL platform once, on import.
"""

from __future__ import annotations

import os
import sys


def choose_defaults() -> None:
    """Choose EGL where there is no display, and no worker threads for Mesa's software renderer."""
    if not sys.platform.startswith("linux"):
        return
    if not os.environ.get("DISPLAY"):
        os.environ.setdefault("MUJOCO_GL", "egl")
    # 0 worker threads: at 84x84 pixels handing tiles to other threads costs more than drawing them.
    os.environ.setdefault("LP_NUM_THREADS", "0")


choose_defaults()
