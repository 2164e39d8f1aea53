"""Hypothesis profiles: `HYPOTHESIS_PROFILE=thorough` searches longer, the default is quick and repeatable.

Also loads triton before any test opens an OpenGL context (see `vhs.envs.opengl`), and leaves torch one
thread, as `vhs train` does: two that spin for each other take seven times as long beside a busy process.
"""

import os

import torch
from hypothesis import HealthCheck, settings

from vhs.envs.opengl import load_triton_first

load_triton_first()
torch.set_num_threads(1)

# No deadline: a machine that is busy elsewhere is not a bug.
settings.register_profile("quick", max_examples=50, deadline=None, derandomize=True)
settings.register_profile(
    "thorough", max_examples=1000, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "quick"))
