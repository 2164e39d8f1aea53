"""From a configuration and the spec of a task to a learner at its beginning."""

from __future__ import annotations

from vhs import Rng
from vhs.acting.setup import convolution_dtype, settled
from vhs.config import Config
from vhs.learning.learner import Learner
from vhs.learning.reckoning import make_reckoning
from vhs.learning.replay import make_replay
from vhs.learning.stillness import Stillness
from vhs.learning.told import make_goals
from vhs.models import ExtractorFactory, make_agent
from vhs.task import TaskSpec
from vhs.world import ALONE, World


def make_learner(
    config: Config, spec: TaskSpec, extractor: ExtractorFactory | None = None, world: World = ALONE
) -> Learner:
    """The learner of every rank at its beginning, before any episode; `extractor` as for `make_agent`."""
    config = settled(config, spec)
    agent, dtype = make_agent(config, spec, extractor), convolution_dtype(config)
    return Learner(
        agent,
        make_goals(config, agent, spec, dtype),
        method=config.method,
        train=config.train,
        success_reward=spec.success_reward or 0.0,
        dtype=dtype,
        rng=Rng(config.seed),
        reckoning=make_reckoning(config.method, spec),
        stillness=None if config.method.imitate_still else Stillness(spec),
        replay=make_replay(config, spec, world.size),
        world=world,
    )
