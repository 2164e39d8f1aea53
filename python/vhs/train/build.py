"""From a configuration and the spec of a task to a learner at its beginning."""

from __future__ import annotations

from vhs import Rng
from vhs.acting.setup import convolution_dtype
from vhs.config import Config
from vhs.learning.goals import make_goals
from vhs.learning.learner import Learner
from vhs.learning.reckoning import make_reckoning
from vhs.models import make_agent
from vhs.task import TaskSpec


def make_learner(config: Config, spec: TaskSpec) -> Learner:
    """The learner at its beginning, before any episode."""
    agent, dtype = make_agent(config, spec), convolution_dtype(config)
    method = config.method.for_task(can_localise=spec.can_localise)
    return Learner(
        agent,
        make_goals(config, agent, spec.num_goals, dtype),
        method=method,
        train=config.train,
        success_reward=spec.success_reward or 0.0,
        dtype=dtype,
        rng=Rng(config.seed),
        reckoning=make_reckoning(method, spec),
    )
