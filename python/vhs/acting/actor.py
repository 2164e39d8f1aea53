"""Acting: the policy's recurrent state and goal of each stream, and batched inference."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vhs.models import GoalAgent, RecurrentState, to_device


class Actor:
    """Chooses actions for a fixed number of streams, each in an episode of its own.

    Batch norm acts with running statistics, so an action never depends on which other streams share the
    batch.
    """

    def __init__(
        self,
        agent: GoalAgent,
        num_streams: int,
        *,
        dtype: torch.dtype,
        generator: torch.Generator,
        greedy: bool = False,
    ) -> None:
        """Make room for `num_streams` episodes.

        Args:
            agent: the networks; shared with the learner, never copied.
            num_streams: episodes side by side.
            dtype: type in which the convolutions multiply.
            generator: source of the sampled actions.
            greedy: take the likeliest action instead of a sample.
        """
        self._agent = agent
        self._dtype = dtype
        self._generator = generator
        self._greedy = greedy
        device = agent.gate.weight.device
        state = agent.initial_state(num_streams)
        self._hidden, self._cell = state.hidden.detach(), state.cell.detach()
        self._goals = torch.zeros(num_streams, agent.gate.in_features, device=device)
        self._interactions = torch.zeros(num_streams, dtype=torch.int64, device=device)

    def state_dict(self) -> dict[str, Tensor]:
        """State and goal of every stream; weights and generator belong to others."""
        return {
            "hidden": self._hidden,
            "cell": self._cell,
            "goals": self._goals,
            "interactions": self._interactions,
        }

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Return to a state that `state_dict` gave, with as many streams."""
        for name, tensor in self.state_dict().items():
            tensor.copy_(state[name])

    def begin(self, stream: int, goal_embedding: Tensor, interaction: int) -> None:
        """Forget the stream's last episode and take the goal of the next: shape [feature_dim], int."""
        self._hidden[stream] = 0.0
        self._cell[stream] = 0.0
        self._goals[stream] = goal_embedding
        self._interactions[stream] = interaction

    @torch.inference_mode()
    def act(
        self,
        streams: NDArray[np.int64],
        observations: NDArray[Any],
        beside: NDArray[np.float32] | None = None,
    ) -> tuple[NDArray[Any], NDArray[np.float32]]:
        """Choose an action for each of `streams`.

        Args:
            streams: which episodes, int64, shape [n].
            observations: their newest observations, as the extractor takes them.
            beside: what these have beside their frames, float32 [n, beside_dim]; None: nothing.

        Returns:
            Actions, int64 [n], or float32 [n, dim]; the critic's values, float32, shape [n].
        """
        self._agent.eval()
        index = to_device(streams, self._goals.device)
        features = self._agent.extractor(to_device(observations, self._goals.device), self._dtype)
        found = self._agent(
            features.unsqueeze(1),
            self._goals[index],
            self._interactions[index],
            RecurrentState(self._hidden[index], self._cell[index]),
            None if beside is None else to_device(beside, self._goals.device).unsqueeze(1),
        )
        self._hidden[index], self._cell[index] = found.state
        # One copy back from the device: policy and value of each stream side by side.
        both = torch.cat([found.policy[:, 0].float(), found.values.float()], dim=1).cpu()
        return self._choose(both[:, :-1]).numpy(), both[:, -1].contiguous().numpy()

    def _choose(self, policy: Tensor) -> Tensor:
        head = self._agent.head
        return head.mode(policy) if self._greedy else head.sample(policy, self._generator)
