"""A run that begins where another one stands: its weights, prototypes and goal images.

Optimiser, schedules, counters, generators and kept episodes are the new run's own. Goal classes are the same
by label; those that the new task has more come behind them, with weights of their own and no picture yet.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from vhs import GoalStore
from vhs.distribution import find_agent
from vhs.errors import CheckpointError
from vhs.learning.averaging import averaged
from vhs.learning.goals import Goals
from vhs.learning.learner import Learner
from vhs.models import GoalAgent
from vhs.runs.agent_file import read_agent
from vhs.runs.checkpoint import fitting, load_checkpoint
from vhs.runs.directory import AGENT_NAME, is_exported
from vhs.runs.remote import fetch_agent, is_on_hub


class Start(NamedTuple):
    """What a run began with."""

    named: str
    """As `train.start_from` names it."""
    episodes: int
    """That had been learned from."""
    classes: int
    """Goal classes that there were."""
    new_classes: int
    """That the task has more."""
    prototypes: int
    images: int
    """Goal images; an exported agent has none."""
    new_heads: tuple[str, ...]
    """Which it lacked of the heads that only teach: what is in view (`sight`), where the goal lies
    (`bearing`)."""

    def __str__(self) -> str:
        """A sentence about it."""
        named = f"{self.prototypes} prototypes of {self.classes} goal classes, " if self.prototypes else ""
        more = f"; new classes: {self.new_classes}" if self.new_classes else ""
        more += f"; heads that are new: {', '.join(self.new_heads)}" if self.new_heads else ""
        return (
            f"starting from {self.named} at episode {self.episodes}: its weights, {named}"
            f"{self.images} pictures of goals{more}"
        )

    def as_dict(self) -> dict[str, Any]:
        """What ``run.json`` says of it."""
        return {"run": self.named, **{name: getattr(self, name) for name in self._fields[1:]}}


class _Found(NamedTuple):
    networks: Mapping[str, Tensor]
    prototypes: Mapping[str, Tensor]
    store: GoalStore | None
    episodes: int


def start(named: str, learner: Learner) -> Start:
    """Put what another run learned into a learner at its beginning.

    Args:
        named: directory of a run or of an exported agent, or the name of one, as for `load_agent`.
        learner: of the new run.

    Raises:
        CheckpointError: it is not there, is damaged, or does not fit; nothing has changed.
    """
    path = fetch_agent(named) if is_on_hub(named) else find_agent(named)
    with fitting(path):
        found = _read(path)
        prototypes = _named(path, learner.goals, found.prototypes)
        weights = _grown(path, learner.agent, found.networks)
        store = _images(path, learner.goals.store, found.store)
    learner.agent.load_state_dict(weights)
    learner.goals.load_state_dict(prototypes)
    learner.goals.store = store
    seen = found.prototypes["seen"]
    own, theirs = (
        {aside for aside in learner.agent.aside if any(name.startswith(aside) for name in names)}
        for names in (weights, found.networks)
    )
    return Start(
        named,
        found.episodes,
        classes=len(seen),
        new_classes=store.num_classes - len(seen),
        prototypes=int(seen.sum()),
        images=len(store),
        new_heads=tuple(sorted(name.rstrip(".") for name in own - theirs)),
    )


def _read(path: Path) -> _Found:
    if is_exported(path):
        file = read_agent(path / AGENT_NAME)
        return _Found(file.networks, file.prototypes, None, file.trained_episodes)
    state, store = load_checkpoint(path)
    return _Found(*averaged(state["learner"]), store, int(state["progress"]["episodes"]))


def _named(path: Path, goals: Goals, found: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The prototypes found, and of the classes that there are more none yet.

    Raises:
        CheckpointError: they are of more classes, or of other features.
    """
    named, seen, table = goals.state_dict(), found["seen"], found["table"]
    if len(seen) > len(named["seen"]):
        raise CheckpointError(
            f"train.start_from: expected at most {len(named['seen'])} goal classes, as the task has, "
            f"found {len(seen)} in {path}"
        )
    if table.shape[1:] != named["table"].shape[1:]:
        raise CheckpointError(
            f"train.start_from: expected features of {named['table'].shape[1]} numbers, "
            f"found {table.shape[1]} in {path}"
        )
    named["seen"][: len(seen)], named["table"][: len(table)] = seen, table
    return named


def _grown(path: Path, agent: GoalAgent, found: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The weights found, with the agent's own for the classes that it has more and for a head that they lack.

    Raises:
        CheckpointError: they are those of another network.
    """
    wanted = agent.state_dict()
    grown: dict[str, Tensor] = {}
    for name in sorted(wanted.keys() | found.keys()):
        own, theirs = wanted.get(name), found.get(name)
        if name.startswith(agent.aside) and (own is None or theirs is None):
            grown |= {} if own is None else {name: own}
            continue
        if own is not None and theirs is not None:
            if own.shape == theirs.shape:
                grown[name] = theirs
                continue
            if name.startswith(agent.by_class) and own.shape[1:] == theirs.shape[1:]:
                grown[name] = torch.cat([theirs.to(own), own[len(theirs) :]])
                continue
        shapes = ["none" if one is None else str(list(one.shape)) for one in (own, theirs)]
        raise CheckpointError(
            f"train.start_from: expected the network of {path} here too: `{name}` is of shape {shapes[0]}, "
            f"there {shapes[1]}"
        )
    return grown


def _images(path: Path, own: GoalStore, found: GoalStore | None) -> GoalStore:
    """The images found, in as many classes as there are now: as they lie, or as many as there were, drawn.

    Raises:
        CheckpointError: they are of another shape.
    """
    if found is None:
        return own
    if found.observation_shape != own.observation_shape:
        raise CheckpointError(
            f"train.start_from: expected goal images of shape {list(own.observation_shape)}, "
            f"found {list(found.observation_shape)} in {path}"
        )
    sizes = own.num_classes, own.capacity_per_class
    store = found
    if (found.num_classes, found.capacity_per_class) != sizes:
        store = GoalStore(sizes[0], own.observation_shape, sizes[1])
        for label, count in enumerate(found.counts.tolist()):
            for image in found.sample_class(label, min(count, sizes[1])) if count else ():
                store.push(image, label)
    store.rng_state = own.rng_state
    return store
