"""Visual hindsight self-imitation on an actor-critic: paper Algorithm 1 and Eq. 6; less of it is A3C or PG.

Each learner of an update embeds every image it needs - episodes and goal images - in one pass of the
extractor, so that the batch norm normalises f(o_T) and the features behind the prototypes alike, and runs the
LSTM once over the episodes as they happened and, under the goal that they reached, over those that are
relabelled. One optimiser step follows from the mean of their gradients.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import normalize

from vhs import EpisodeBatch, GoalStore, Hindsight, Prototypes, Rng, discounted_returns, relabel
from vhs.config import MethodSection, TrainSection
from vhs.errors import DivergenceError
from vhs.learning.replicas import Replicas
from vhs.learning.shares import GoalImages, Learned, Share, to_arrays, to_numpy, to_tensors
from vhs.losses import (
    ImitationTerms,
    actor_critic_loss,
    hindsight_imitation_loss,
    lambda_returns,
    supcon_loss,
)
from vhs.models import GoalAgent, to_device


class VHS:
    """The agent with its goal store, prototypes and optimiser.

    The goal store is read here and filled by the training loop. Goals made of images are constants in every
    loss, goal words are learned. Which terms there are, `vhs.learning.methods` says: without relabelling this
    is PG, without the goal store too it is A3C (Mnih et al. 2016).
    """

    def __init__(
        self,
        agent: GoalAgent,
        goal_store: GoalStore,
        prototypes: Prototypes,
        *,
        method: MethodSection,
        train: TrainSection,
        success_reward: float,
        dtype: torch.dtype,
        rng: Rng,
    ) -> None:
        """Join the parts.

        Args:
            agent: the networks, on the device they stay on.
            goal_store: images of reached goals.
            prototypes: running goal embeddings.
            method: weights and switches of the method.
            train: optimiser settings.
            success_reward: what the environment pays for the last step of a success, unscaled.
            dtype: type in which the convolutions multiply.
            rng: the source of the relabelling decisions.
        """
        self.agent = agent
        self.goal_store = goal_store
        self.prototypes = prototypes
        self.optimiser = torch.optim.Adam(
            agent.parameters(), lr=train.learning_rate, amsgrad=True, fused=True
        )
        self._replicas = Replicas(agent, train.learners, train.threads)
        self.rng = rng
        self.updates = 0
        self._method = method
        self._train = train
        self._success_reward = success_reward
        self.dtype = dtype
        self._device = agent.gate.weight.device

    def embed_goal(self, label: int) -> Tensor:
        """The goal embedding of a class for one episode: its word, or p^x (paper Eq. 4).

        While there is no prototype, it is N(0, 1): an exact one needs a stored image of its class, a running
        one a SupCon batch.

        Returns:
            float32, a constant, shape [feature_dim].
        """
        if self.agent.words is not None:
            return self.agent.words.weight[label].detach().clone()
        if self._method.prototype == "exact":
            self._refresh_exactly(label)
        embedding = self.prototypes.embed(np.array([label], dtype=np.int64))[0]
        return self._tensor(embedding)

    @property
    def is_warm(self) -> bool:
        """Whether the store holds enough images for the loss on them, and so for running prototypes."""
        return len(self.goal_store) >= self._method.warmup

    def update(self, shares: Sequence[tuple[EpisodeBatch, Tensor]]) -> dict[str, float]:
        """Learn from finished episodes: L = L_RL + supcon_weight L_s + vhs_weight L_VHS (paper Eq. 6).

        A baseline has some of these terms.

        Args:
            shares: one for each of `train.learners`: episodes, and the goal embedding each was acted under,
                of shape [B, feature_dim]; goal words are looked up anew, so that they learn.

        Returns:
            The mean over the learners of each term, unweighted, the gradient's norm before clipping and the
            share of relabelled episodes where a method relabels.

        Raises:
            DivergenceError: a loss is not finite; the weights are as before.
        """
        work = [Share(batch, goals, self._relabel(batch), self._sample_goals()) for batch, goals in shares]
        learned = self._replicas.map(self._learn, work)
        names = learned[0].terms
        metrics = {name: sum(one.terms[name].item() for one in learned) / len(learned) for name in names}
        self._check_finite(metrics)
        self._replicas.merge()
        metrics["grad_norm"] = self._step()
        for share, found in zip(work, learned, strict=True):
            if share.stored is not None and self._method.prototype == "running":
                self.prototypes.update(to_numpy(found.goal_features), to_numpy(share.stored.labels))
        self.updates += 1
        if not self._method.parts.hindsight:
            return metrics
        relabelled = np.concatenate([share.hindsight.selected for share in work])
        return metrics | {"relabelled": float(relabelled.mean())}

    def _relabel(self, batch: EpisodeBatch) -> Hindsight:
        method = self._method
        probability = method.relabel_probability if method.parts.hindsight else 0.0
        return relabel(batch, on=method.relabel_on, probability=probability, rng=self.rng)

    def _learn(self, agent: GoalAgent, share: Share) -> Learned:
        """Losses of one share and, in `agent`, their gradients."""
        agent.train()
        agent.zero_grad(set_to_none=True)
        episode_features, goal_features = self._embed(agent, share)
        terms = self._episode_losses(agent, share, episode_features)
        if share.stored is not None:
            terms |= self._goal_terms(agent, goal_features, share.stored.labels)
        loss = self._weigh(terms)
        if loss.requires_grad:  # GCSL may have nothing to imitate
            loss.backward()  # type: ignore[no-untyped-call]
        return Learned({name: term.detach() for name, term in terms.items()}, goal_features.detach())

    def _embed(self, agent: GoalAgent, share: Share) -> tuple[Tensor, Tensor]:
        """Features of the episodes' observations and of the goal images, by one pass."""
        observations = self._tensor(share.batch.observations)
        count = len(observations)
        if share.stored is not None:
            observations = torch.cat([observations, share.stored.observations])
        features = agent.extractor(observations, self.dtype)
        return features[:count], features[count:]

    def _episode_losses(self, agent: GoalAgent, share: Share, features: Tensor) -> dict[str, Tensor]:
        """The terms of L_RL on every episode and of L_VHS on the relabelled ones, by one run of the LSTM."""
        batch, hindsight = share.batch, share.hindsight
        episodes, steps = batch.actions.shape
        chosen = self._tensor(np.flatnonzero(hindsight.selected))
        rows = self._tensor(batch.offsets).unsqueeze(1) + torch.arange(steps, device=self._device)
        sequences = features[rows.clamp(max=len(features) - 1)]
        reached = self._hindsight_goals(features[self._tensor(hindsight.goal_rows)[chosen]].detach())
        log_probs, values, _ = agent(
            torch.cat([sequences, sequences[chosen]]),
            torch.cat([self._instructed_goals(agent, share), reached]),
            torch.cat([self._tensor(batch.interactions), self._tensor(hindsight.interactions)[chosen]]),
        )
        actions, valid = self._tensor(batch.actions), self._tensor(batch.mask).float()
        rewards = self._tensor(batch.rewards) * self._train.reward_scale
        returns = lambda_returns(
            rewards, values[:episodes], valid, self._train.gamma, self._train.return_lambda
        )
        rl = actor_critic_loss(log_probs[:episodes], actions, values[:episodes], returns, valid)
        terms = {"policy": rl.policy, "value": rl.value, "entropy": rl.entropy}
        if not self._method.parts.hindsight:
            return terms
        imitation = ImitationTerms(values.new_zeros(()), values.new_zeros(()))
        if len(chosen):
            targets = self._tensor(self._hindsight_values(batch))[chosen]
            imitation = hindsight_imitation_loss(
                log_probs[episodes:],
                actions[chosen],
                values[episodes:],
                targets,
                valid[chosen],
                valid.sum(),
                self._method.hindsight_discount,
            )
        return terms | {"imitation_policy": imitation.policy, "imitation_value": imitation.value}

    def _goal_terms(self, agent: GoalAgent, features: Tensor, labels: Tensor) -> dict[str, Tensor]:
        """The terms on the store's images, from their features and classes."""
        return {"supcon": supcon_loss(features, labels, self._method.supcon_temperature)}

    def _instructed_goals(self, agent: GoalAgent, share: Share) -> Tensor:
        """The goal embedding of each episode as it was instructed, shape [B, feature_dim]."""
        if agent.words is None:
            return share.goals
        found: Tensor = agent.words(self._tensor(share.batch.goals))
        return found

    def _hindsight_goals(self, reached: Tensor) -> Tensor:
        """The goals of relabelled episodes, from their f(o_T), both of shape [R, feature_dim]."""
        has_prototypes = self.prototypes.seen.all() and self.is_warm
        if self._method.hindsight_goal == "feature" or not has_prototypes:
            return reached
        table = self._tensor(self.prototypes.table)
        nearest = (reached @ normalize(table, dim=1).T).argmax(dim=1)
        return table[nearest]

    def _hindsight_values(self, batch: EpisodeBatch) -> NDArray[np.float32]:
        """The target v_i of the hindsight value, shape [B, T] (paper: the critic's value when acting)."""
        if self._method.value_target == "behaviour":
            return batch.values
        rewards = batch.rewards.copy()
        rewards[np.arange(len(rewards)), batch.lengths - 1] = self._success_reward
        return discounted_returns(rewards * self._train.reward_scale, batch.lengths, self._train.gamma)

    def _weigh(self, terms: dict[str, Tensor]) -> Tensor:
        """The weighted sum of the terms."""
        method, train = self._method, self._train
        weights = {
            "policy": 1.0,
            "value": train.value_weight,
            "entropy": -self._scheduled("entropy_weight"),
            "imitation_policy": method.vhs_weight,
            "imitation_value": method.vhs_weight,
            "supcon": method.supcon_weight,
            "discriminator": method.discriminator_weight,
        }
        return torch.stack([weights[name] * term for name, term in terms.items()]).sum()

    def _check_finite(self, terms: Mapping[str, float]) -> None:
        if not all(math.isfinite(term) for term in terms.values()):
            found = ", ".join(f"{name} {term:.3g}" for name, term in terms.items())
            raise DivergenceError(f"update {self.updates + 1}: expected a finite loss, found {found}")

    def _step(self) -> float:
        """Make one optimiser step from the gradients in `agent`; their norm before clipping."""
        norm = nn.utils.clip_grad_norm_(self.agent.parameters(), self._train.max_grad_norm).item()
        if not math.isfinite(norm):
            raise DivergenceError(f"update {self.updates + 1}: expected a finite gradient, found norm {norm}")
        for group in self.optimiser.param_groups:
            group["lr"] = self._scheduled("learning_rate")
        self.optimiser.step()
        return norm

    def _scheduled(self, name: str) -> float:
        """The present value of a number of `train` that may move to `<name>_end` over training."""
        train = self._train
        start, end = getattr(train, name), getattr(train, f"{name}_end")
        if end is None:
            return float(start)
        done = min(self.updates * train.episodes_per_update / train.schedule_episodes, 1.0)
        return float(start + (end - start) * done)

    def _sample_goals(self) -> GoalImages | None:
        if not (self._method.parts.goal_loss and self.is_warm):
            return None
        observations, labels = self.goal_store.sample(self._method.supcon_batch, balanced=True)
        return GoalImages(self._tensor(observations), self._tensor(labels))

    def _refresh_exactly(self, label: int) -> None:
        """Set p^x to the mean feature of stored images, with running statistics as when acting."""
        if self.goal_store.counts[label] == 0:
            return
        images = self.goal_store.sample_class(label, self._method.prototype_samples)
        self.agent.eval()
        with torch.inference_mode():
            features = self.agent.extractor(self._tensor(images), self.dtype)
        self.prototypes.update(to_numpy(features), np.full(len(images), label, dtype=np.int64))

    def _tensor(self, array: NDArray[Any]) -> Tensor:
        return to_device(array, self._device)

    def state_dict(self) -> dict[str, Any]:
        """Everything that an update reads or changes, but for the goal store (which saves itself)."""
        return {
            "agent": self.agent.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "prototypes": to_tensors(self.prototypes.state_dict()),
            "rng": torch.from_numpy(self.rng.state),
            "updates": self.updates,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Return to a state that `state_dict` gave."""
        self.agent.load_state_dict(state["agent"])
        self._replicas.spread_statistics()
        self.optimiser.load_state_dict(state["optimiser"])
        self.prototypes.load_state_dict(to_arrays(state["prototypes"]))
        self.rng = Rng.from_state(state["rng"].numpy())
        self.updates = int(state["updates"])
