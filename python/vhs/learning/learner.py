"""One update of any method: gather once, run forward once, sum the method's terms, step (paper Eq. 6).

A rank's share of an update embeds every image that it needs - episodes and goal images - in one pass of the
extractor, so that the batch norm normalises f(o_T) and the features behind the prototypes alike, and runs the
LSTM once over the episodes as they happened and, under the goal that they reached, over those that are
relabelled and some kept from before. One optimiser step follows from the mean of the shares' gradients.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from vhs import EpisodeBatch, Hindsight, Outcome, Rng, relabel
from vhs.buffer import beside
from vhs.config import MethodSection, TrainSection
from vhs.errors import DivergenceError
from vhs.learning.averaging import Average
from vhs.learning.goals import GoalImages, Goals
from vhs.learning.merging import Terms, average_gradients
from vhs.learning.reckoning import Reckoned, Reckoning, remember
from vhs.learning.replay import Replay
from vhs.learning.stillness import Stillness
from vhs.learning.terms import TERMS, Episodes, Forward, Images, Over, Reached, Term
from vhs.models import GoalAgent, to_device, to_numpy
from vhs.world import ALONE, World

_SLACK = 1e-5
"""More than torch adds to a norm before it divides by it: what is not clipped would not have been."""


class Share(NamedTuple):
    """What this rank learns from in an update."""

    batch: EpisodeBatch
    """B episodes that have just ended, and behind them R that are replayed."""
    goals: Tensor
    """The goal embedding each that has just ended was acted under, shape [B, feature_dim]."""
    hindsight: Hindsight
    """What of all B + R reached, if it reached anything."""
    imitated: NDArray[np.int64]
    """Which of the batch are imitated under that, those that are replayed last."""
    is_still: NDArray[np.bool_]
    """Steps of those that are not imitated, as they changed nothing, bool [B + R, T]."""
    images: GoalImages | None

    @property
    def num_ended(self) -> int:
        """B."""
        return len(self.goals)


class Learned(NamedTuple):
    """What it found: unweighted terms, features of its goal images, float32 [n, feature_dim]."""

    terms: dict[str, Tensor]
    image_features: Tensor


class _Pass(NamedTuple):
    """Episodes for the LSTM, each under one goal."""

    over: Over
    rows: NDArray[np.int64]
    """Which of the batch, shape [B]."""
    is_valid: NDArray[np.bool_]
    """Steps of each that terms are over, shape [B, T]: until it reached that goal, and not still."""
    inputs: tuple[Tensor, Tensor, Tensor]
    """Features [B, T, feature_dim], goals [B, feature_dim], interactions [B]."""
    known: Tensor | None
    """What observations have beside their frames, [B, T, beside_dim]."""


def reached_after(batch: EpisodeBatch, touched: NDArray[np.int64]) -> NDArray[np.int64]:
    """Steps until each of the first episodes of a batch reached something, 0 where nothing was reached.

    Args:
        batch: the episodes.
        touched: steps until they last touched something, as their task says, int64 [B]. What failed has
            reached something at its end, said or not.
    """
    outcomes, lengths = batch.outcomes[: len(touched)], batch.lengths[: len(touched)]
    return np.where((outcomes == Outcome.FAILURE) & (touched == 0), lengths, touched)


class Learner:
    """Agent, goals and optimiser: what an update changes.

    Prototypes are constants in every loss; goal words, and what embeds pictures and vectors, learn. The terms
    are those of the method's row in `vhs.learning.methods`.
    """

    def __init__(
        self,
        agent: GoalAgent,
        goals: Goals,
        *,
        method: MethodSection,
        train: TrainSection,
        success_reward: float,
        dtype: torch.dtype,
        rng: Rng,
        reckoning: Reckoning | None = None,
        stillness: Stillness | None = None,
        replay: Replay | None = None,
        world: World = ALONE,
    ) -> None:
        """Join the parts.

        Args:
            agent: the networks, on the device they stay on.
            goals: what names goals, and their images.
            method: its row says the terms, its keys their weights and switches.
            train: optimiser settings, as settled for the task.
            success_reward: what the environment pays for the last step of a success, unscaled.
            dtype: type in which the convolutions multiply.
            rng: the source of the relabelling decisions.
            reckoning: says where what was reached had been; without it the terms on that are left out.
            stillness: says which steps changed nothing, which are then not imitated; without it all are.
            replay: keeps episodes to be imitated again; without it the terms on them are left out.
            world: the ranks that take each step together.
        """
        self.agent = agent
        self.goals = goals
        self.replay = replay
        self.optimiser = torch.optim.Adam(
            agent.parameters(), lr=train.learning_rate, amsgrad=True, fused=True
        )
        self.rng = rng
        self.updates = 0
        self.dtype = dtype
        self._world = world
        self._method = method
        self._train = train
        self._success_reward = success_reward
        self._reckoning, self._stillness = reckoning, stillness
        self._average = Average(train.ema_decay) if train.ema_decay else None
        # Without classes there is nothing to tell images of goals apart by.
        lacking = {
            over
            for over, is_there in (
                ("reached", reckoning is not None and agent.sight is not None),
                ("remembered", reckoning is not None and agent.bearing is not None),
                ("replayed", replay is not None),
                ("images", goals.has_classes),
            )
            if not is_there
        }
        terms = {name: TERMS[name] for name in method.row.terms}
        self._terms: dict[str, Term] = {
            name: term for name, term in terms.items() if term.over not in lacking
        }
        self._over = {term.over for term in self._terms.values()}
        self._device = agent.gate.weight.device

    @property
    def has_every_term(self) -> bool:
        """Whether goal images suffice for the terms on them, if there are any."""
        return "images" not in self._over or self.goals.is_warm

    def update(
        self,
        batch: EpisodeBatch,
        goals: Tensor,
        touched: NDArray[np.int64] | None = None,
        *,
        along: Sequence[Tensor] = (),
        meanwhile: Callable[[], None] = lambda: None,
    ) -> dict[str, float]:
        """Learn from finished episodes: this rank's share of them.

        Args:
            batch: B episodes that have just ended, as many on every rank, and behind them any number that are
                replayed: imitated under what they reached at their ends.
            goals: the goal embedding each of the B was acted under, of shape [B, feature_dim]; goal words
                are looked up anew, so that they learn.
            touched: steps until each of the B last reached something, int64 [B]; None: only their ends reach
                anything.
            along: what is to be summed over the ranks in the same message.
            meanwhile: done while that message is under way, with the weights before the update; not done by a
                process alone.

        Returns:
            The mean over the ranks of each term, unweighted, the gradient's norm before clipping and the
            share of relabelled episodes where a method relabels.

        Raises:
            DivergenceError: a loss is not finite; the weights are as before.
            PeerError: another rank is gone.
        """
        hindsight, imitated = self._relabel(batch, len(goals), touched)
        is_still = np.zeros_like(batch.mask)
        if self._stillness is not None:
            is_still = self._stillness.before_ends(batch, imitated, hindsight.lengths[imitated])
        share = Share(batch, goals, hindsight, imitated, is_still, self._images())
        learned = self._learn(share)
        if "relabelled" in self._over:
            num_relabelled = (share.imitated < share.num_ended).sum()
            learned.terms["relabelled"] = torch.tensor(np.float32(num_relabelled / share.num_ended))
        terms = Terms([*self._terms, "relabelled"], learned.terms, self._device)
        sums = self.goals.summed(share.images, learned.image_features) if self._world.size > 1 else None
        if sums is not None:
            average_gradients(self._world, self.agent, [terms.sums, sums, *along], meanwhile)
        parameters = list(self.agent.parameters())
        norm = nn.utils.get_total_norm([one.grad for one in parameters if one.grad is not None])
        metrics, found = terms.means(norm)
        self._check_finite(metrics, found)
        metrics["grad_norm"] = found
        most = self._train.max_grad_norm
        if found > most - _SLACK:  # most gradients are short, and a product with 1 reads and writes them all
            nn.utils.clip_grads_with_norm_(parameters, most, norm)
        self._step()
        if sums is not None:
            self.goals.learned_together(sums)
        elif share.images is not None:
            self.goals.learned(share.images, learned.image_features)
        if self._average is not None:
            self._average.update(self.agent, self.goals)
        self.updates += 1
        return metrics

    def scheduled(self, key: str) -> float:
        """The present value of a number of the configuration, which may move to ``<key>_end`` over training.

        Args:
            key: dotted, of the sections `method` or `train`.
        """
        section, _, name = key.partition(".")
        values, train = {"method": self._method, "train": self._train}[section], self._train
        start, end = getattr(values, name), getattr(values, f"{name}_end", None)
        if end is None:
            return float(start)
        done = min(self.updates * train.episodes_per_update / train.schedule_episodes, 1.0)
        return float(start + (end - start) * done)

    def _relabel(
        self, batch: EpisodeBatch, num_ended: int, touched: NDArray[np.int64] | None
    ) -> tuple[Hindsight, NDArray[np.int64]]:
        """What each episode reached, and which are imitated: by chance, and all that are replayed."""
        method, ends = self._method, None
        probability = method.relabel_probability if "relabelled" in self._over else 0.0
        if touched is not None:
            ends = batch.lengths.copy()
            ends[:num_ended] = reached_after(batch, touched)
        chosen = relabel(batch, on=method.relabel_on, probability=probability, rng=self.rng, ends=ends)
        (imitated,) = np.nonzero(chosen.selected[:num_ended])
        if len(batch.lengths) == num_ended:
            return chosen, imitated
        reached = relabel(batch, on=tuple(Outcome), probability=1.0, rng=0, ends=ends)
        return reached, np.concatenate([imitated, np.arange(num_ended, len(batch.lengths))])

    def _images(self) -> GoalImages | None:
        return self.goals.batch() if "images" in self._over else None

    def _learn(self, share: Share) -> Learned:
        """Terms of one share and, in the agent, the gradients of their sum."""
        agent = self.agent
        agent.train()
        agent.zero_grad(set_to_none=True)
        features, image_features, shown = self._embed(agent, share)
        terms = self._evaluate(self._forward(agent, share, features, image_features, shown))
        weighted = [self._weight(self._terms[name]) * term for name, term in terms.items()]
        loss = torch.stack([*weighted, features.new_zeros(())]).sum()
        if loss.requires_grad:  # a method without rewards may have nothing to imitate
            loss.backward()  # type: ignore[no-untyped-call]
        return Learned({name: term.detach() for name, term in terms.items()}, image_features.detach())

    def _embed(self, agent: GoalAgent, share: Share) -> tuple[Tensor, Tensor, Tensor]:
        """Features of the episodes' observations, of goal images and of other pictures of goals, at once."""
        batch, parts = share.batch, [self._tensor(share.batch.observations)]
        if share.images is not None:
            parts.append(share.images.observations)
        pictures = self.goals.pictures(batch, share.hindsight.goal_rows[share.imitated])
        if pictures is not None:
            parts.append(self._tensor(pictures))
        features = agent.extractor(torch.cat(parts) if len(parts) > 1 else parts[0], self.dtype)
        count, shown = len(parts[0]), 0 if pictures is None else len(pictures)
        own, images, others = torch.split(features, [count, len(features) - count - shown, shown])
        return own, images, others

    def _forward(
        self, agent: GoalAgent, share: Share, features: Tensor, image_features: Tensor, shown: Tensor
    ) -> Forward:
        """Run the LSTM once, over lived and relabelled episodes as far as terms read them."""
        batch = share.batch
        length = batch.actions.shape[1]
        # What follows a step that a limit cut off is the critic's to say, and it reads one observation more.
        is_cut = ~batch.terminated[: share.num_ended]
        steps = torch.arange(length + int(is_cut.any()), device=self._device)
        rows = (self._tensor(batch.offsets).unsqueeze(1) + steps).clamp(max=len(features) - 1)
        sequences = features[rows]
        known = beside(batch.fields)
        told = None if known is None else self._tensor(known)[rows]
        passes = self._passes(agent, share, features, sequences, told, shown)
        passed: dict[str, Episodes] = {}
        if passes:
            inputs = map(torch.cat, zip(*(one.inputs for one in passes), strict=True))
            everywhere = (
                torch.cat([one.known for one in passes if one.known is not None])
                if told is not None
                else None
            )
            made = agent(*inputs, beside=everywhere)
            sizes = [len(one.rows) for one in passes]
            parts = (part.split(sizes) for part in (made.policy, made.values, made.hidden))
            for one, policy, values, hidden in zip(passes, *parts, strict=True):
                passed[one.over] = Episodes(
                    one.rows,
                    agent.head,
                    policy[:, :length],
                    values[:, :length],
                    hidden[:, :length],
                    self._tensor(batch.actions[one.rows]),
                    self._tensor(one.is_valid).float(),
                    self._beyond(batch, one.rows, values) if is_cut.any() else None,
                )
        images = None if share.images is None else Images(image_features, share.images.labels)
        reached = remembered = None
        if {"reached", "remembered"} & self._over:
            assert self._reckoning is not None
            reckoned = self._reckoning(batch)
            if "reached" in self._over:
                reached = self._reached(batch, reckoned, features, sequences[:, :length])
            if "remembered" in self._over:
                remembered = remember(batch, reckoned, passed, self._device)
        return Forward(
            agent,
            batch,
            share.num_ended,
            share.hindsight.lengths,
            lived=passed.get("lived"),
            relabelled=passed.get("relabelled"),
            replayed=passed.get("replayed"),
            images=images,
            reached=reached,
            remembered=remembered,
            method=self._method,
            train=self._train,
            success_reward=self._success_reward,
        )

    def _beyond(self, batch: EpisodeBatch, rows: NDArray[np.int64], values: Tensor) -> Tensor:
        """V(o_T) of episodes that a limit cut off, 0 of the others; values as far as o_T, [B, T + 1]."""
        last = values.gather(1, self._tensor(batch.lengths[rows]).unsqueeze(1)).squeeze(1)
        return last.detach() * self._tensor(~batch.terminated[rows])

    def _passes(
        self,
        agent: GoalAgent,
        share: Share,
        features: Tensor,
        sequences: Tensor,
        known: Tensor | None,
        shown: Tensor,
    ) -> list[_Pass]:
        """What the LSTM has to run over, of features of each episode, shape [B, T, feature_dim]."""
        batch, hindsight, count = share.batch, share.hindsight, share.num_ended
        passes = []
        if "lived" in self._over:
            goals = self.goals.instructed(agent, batch, share.goals, shown)[:count]
            inputs = sequences[:count], goals, self._tensor(batch.interactions[:count])
            own = None if known is None else known[:count]
            passes.append(_Pass("lived", np.arange(count), batch.mask[:count], inputs, own))
        if not len(share.imitated):
            return passes
        rows = hindsight.goal_rows[share.imitated]
        reached = self.goals.hindsight(agent, batch, rows, features[self._tensor(rows)], shown)
        is_replayed = share.imitated >= count
        steps = np.arange(batch.mask.shape[1])
        over: Over
        for over, is_part in (("relabelled", ~is_replayed), ("replayed", is_replayed)):
            places = np.flatnonzero(is_part)
            selected = share.imitated[places]
            if len(selected):
                chosen = self._tensor(selected)
                done = self._tensor(hindsight.interactions)[chosen]
                inputs = sequences[chosen], reached[self._tensor(places)], done
                own = None if known is None else known[chosen]
                is_reaching = steps < hindsight.lengths[selected, None]
                passes.append(_Pass(over, selected, is_reaching & ~share.is_still[selected], inputs, own))
        return passes

    def _reached(
        self, batch: EpisodeBatch, reckoned: Reckoned, features: Tensor, sequences: Tensor
    ) -> Reached | None:
        """Views of what episodes reached: what a success was told, what a failure's end looks like."""
        rows, bearings = reckoned
        labels = self._tensor(batch.goals[rows])
        ends = features[self._tensor(batch.offsets[rows] + batch.lengths[rows])].detach()
        is_told = batch.outcomes[rows] == Outcome.SUCCESS
        seen = self.goals.recognise(ends)
        if seen is None:  # what is not told is not known
            rows, bearings, labels = (
                rows[is_told],
                bearings[is_told],
                self._tensor(batch.goals[rows[is_told]]),
            )
        else:
            labels = torch.where(self._tensor(is_told), labels, seen)
        if not len(rows):
            return None
        valid = self._tensor(batch.mask[rows]).float()
        return Reached(sequences[self._tensor(rows)], labels, self._tensor(bearings), valid)

    def _evaluate(self, x: Forward) -> dict[str, Tensor]:
        """Every term of the method, unweighted; those on images as soon as there are any."""
        found = {}
        for name, term in self._terms.items():
            if getattr(x, term.over) is not None:
                found[name] = term.loss(x)
            elif term.over in ("relabelled", "replayed", "reached", "remembered"):
                found[name] = torch.zeros((), device=self._device)
        return found

    def _weight(self, term: Term) -> float:
        weight = self.scheduled(term.weight) if isinstance(term.weight, str) else term.weight
        return term.sign * weight

    def _check_finite(self, terms: Mapping[str, float], norm: float) -> None:
        if not all(math.isfinite(term) for term in terms.values()):
            found = ", ".join(f"{name} {term:.3g}" for name, term in terms.items())
            raise DivergenceError(f"update {self.updates + 1}: expected a finite loss, found {found}")
        if not math.isfinite(norm):
            raise DivergenceError(f"update {self.updates + 1}: expected a finite gradient, found norm {norm}")

    def _step(self) -> None:
        """Make one optimiser step from the gradients in `agent`."""
        for group in self.optimiser.param_groups:
            group["lr"] = self.scheduled("train.learning_rate")
        self.optimiser.step()

    def _tensor(self, array: NDArray[Any]) -> Tensor:
        return to_device(array, self._device)

    def state_dict(self) -> dict[str, Any]:
        """Everything that an update reads or changes, but for the goal store (which saves itself)."""
        average = {} if self._average is None else {"average": self._average.state_dict()}
        return {
            "agent": self.agent.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "prototypes": self.goals.state_dict(),
            "rng": torch.from_numpy(self.rng.state),
            "updates": self.updates,
            **average,
            **self._replay_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Return to a state that `state_dict` gave."""
        self.agent.load_state_dict(state["agent"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.goals.load_state_dict(state["prototypes"])
        self.rng = Rng.from_state(state["rng"].numpy())
        self.updates = int(state["updates"])
        if self._average is not None and "average" in state:
            self._average.load_state_dict(state["average"], self._device)
        if self.replay is not None:
            self.replay.load_state_dict(state["replay"])

    def own_state(self) -> dict[str, Any]:
        """What a rank draws with, and keeps; prototypes are its own where it draws their images."""
        return {
            "rng": torch.from_numpy(self.rng.state),
            "images": torch.from_numpy(self.goals.store.rng_state),
            "prototypes": self.goals.state_dict(),
            **self._replay_state(),
        }

    def load_own_state(self, state: Mapping[str, Any]) -> None:
        """Return to a state that `own_state` gave."""
        self.rng = Rng.from_state(state["rng"].numpy())
        self.goals.store.rng_state = state["images"].numpy()
        self.goals.load_state_dict(state["prototypes"])
        if self.replay is not None and "replay" in state:
            self.replay.load_state_dict(state["replay"])

    def draw_from(self, seed: int) -> None:
        """Draw with generators that begin at a seed."""
        state = torch.from_numpy(Rng(seed).state)
        prototypes = self.goals.state_dict() | {"rng": state}
        self.load_own_state({"rng": state, "images": state, "prototypes": prototypes})
        if self.replay is not None:
            self.replay.draw_from(state.numpy())

    def _replay_state(self) -> dict[str, Any]:
        return {} if self.replay is None else {"replay": self.replay.state_dict()}

    def digest(self) -> str:
        """SHA-256 of all that is alike on every rank: weights, batch statistics, images by class."""
        digest = hashlib.sha256(self.goals.counts.tobytes())
        for tensor in self.agent.state_dict().values():
            digest.update(to_numpy(tensor).tobytes())
        return digest.hexdigest()
