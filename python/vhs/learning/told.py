"""Goals that are told as they are, pictures and vectors, and the one way from a task to its goals.

A picture is embedded as an observation is, goal = f(picture), so whatever an episode saw last can be its goal
in hindsight. A vector goes through a small network of the agent. Classes are a bonus: where a task names
them beside, the losses on goal images apply.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vhs import EpisodeBatch, GoalStore, Prototypes
from vhs.config import Config
from vhs.learning.goals import ClassGoals, PrototypeGoals, Told, WordGoals
from vhs.models import GoalAgent, to_device
from vhs.task import TaskSpec


class _ToldGoals(ClassGoals):
    """What an episode is told needs no name."""

    @property
    def has_classes(self) -> bool:
        """Whether the task names classes beside what it tells."""
        return self.store.num_classes > 1

    def begin(self, told: Told) -> Tensor:
        """The embedding as it is now."""
        return self.embedding(told)

    def refresh(self, told: Told) -> None:
        """An embedding is always up to date."""


class PictureGoals(_ToldGoals):
    """Goals that are observations: f(picture) names one."""

    frame_stack = 1
    """Frames in an observation."""

    def embedding(self, told: Told) -> Tensor:
        """Features of one picture, shape `observation_shape`, by running statistics."""
        self._agent.eval()
        with torch.no_grad():
            picture = to_device(np.ascontiguousarray(told)[None], self._device)
            found: Tensor = self._agent.extractor(picture, self._dtype)[0]
        return found

    def pictures(self, batch: EpisodeBatch, rows: NDArray[np.int64]) -> NDArray[Any] | None:
        """The goals told, then the newest frames of those reached, still as a goal that is told is.

        An observation that was lived shows motion, and with it the last action; a goal that is told does not.
        """
        assert batch.desired_goals is not None, "a buffer of observations"
        return np.concatenate([batch.desired_goals, self._still(batch.observations[rows])])

    def _still(self, observations: NDArray[Any]) -> NDArray[Any]:
        """Stacks [n, *observation_shape] of their newest frame alone."""
        is_picture = observations.ndim == 4  # channels of frames are stacked, else frames
        axis = -1 if is_picture else 1
        newest = np.split(observations, self.frame_stack, axis)[-1]
        return np.concatenate([newest] * self.frame_stack, axis)

    def instructed(self, agent: GoalAgent, batch: EpisodeBatch, acted: Tensor, shown: Tensor) -> Tensor:
        """Features of the pictures told, with a gradient: nothing else teaches f what of a goal matters."""
        return shown[: len(batch.lengths)]

    def hindsight(
        self,
        agent: GoalAgent,
        batch: EpisodeBatch,
        rows: NDArray[np.int64],
        reached: Tensor,
        shown: Tensor,
    ) -> Tensor:
        """Features of the newest frames, with a gradient."""
        return shown[len(batch.lengths) :]


class VectorGoals(_ToldGoals):
    """Goals that are vectors, embedded by `GoalAgent.embed_vectors`, which learns."""

    def embedding(self, told: Told) -> Tensor:
        """Of one vector, without a gradient."""
        with torch.no_grad():
            return self._agent.embed_vectors(self._vectors(np.asarray(told)[None]))[0]

    def instructed(self, agent: GoalAgent, batch: EpisodeBatch, acted: Tensor, shown: Tensor) -> Tensor:
        """The vectors told, embedded anew so that their network learns."""
        assert batch.desired_goals is not None, "a buffer of vectors"
        return agent.embed_vectors(self._vectors(batch.desired_goals))

    def hindsight(
        self,
        agent: GoalAgent,
        batch: EpisodeBatch,
        rows: NDArray[np.int64],
        reached: Tensor,
        shown: Tensor,
    ) -> Tensor:
        """The vectors that were reached."""
        assert batch.achieved_goals is not None, "a buffer of vectors"
        return agent.embed_vectors(self._vectors(batch.achieved_goals[rows]))

    def _vectors(self, goals: NDArray[np.generic]) -> Tensor:
        """Goals of any shape and type as float32 [n, numbers]."""
        return to_device(goals.reshape(len(goals), -1).astype(np.float32), self._device)


def make_goals(config: Config, agent: GoalAgent, spec: TaskSpec, dtype: torch.dtype) -> ClassGoals:
    """The goals of a run on a task before its first episode, named to `agent`."""
    method = config.method
    momentum = method.prototype_momentum if method.prototype == "running" else 0.0
    named: type[ClassGoals] = WordGoals if method.embedding == "word" else PrototypeGoals
    kinds: dict[str, type[ClassGoals]] = {
        "labels": named,
        "observations": PictureGoals,
        "vectors": VectorGoals,
    }
    shape = agent.extractor.observation_shape
    goals = kinds[spec.goals](
        agent,
        GoalStore(spec.num_goals, shape, method.goal_capacity, seed=config.seed),
        Prototypes(spec.num_goals, config.model.feature_dim, momentum=momentum, seed=config.seed),
        method,
        dtype,
    )
    if isinstance(goals, PictureGoals):
        goals.frame_stack = config.model.frame_stack
    return goals
