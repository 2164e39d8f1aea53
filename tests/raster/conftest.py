"""Makes `support` importable and chooses MuJoCo's OpenGL before anything imports MuJoCo."""

import os
import sys
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")
sys.path.insert(0, str(Path(__file__).parent))
