"""Goals: what names them to the policy, and what of them is kept to learn from.

One face for whoever acts, learns or looks: an episode is told something and acts under its embedding, what
an episode reached becomes a goal in hindsight, and images of reached goals feed the losses on them. Here
goals are classes, named by prototypes of their images or by learned words; `vhs.learning.told` has pictures
and vectors, which are told as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor
from torch.nn.functional import normalize

from vhs import (
    ArgumentError,
    DtypeError,
    EpisodeBatch,
    EpisodeBuffer,
    GoalStore,
    LabelError,
    Prototypes,
    ShapeError,
)
from vhs.config import MethodSection
from vhs.models import GoalAgent, to_device, to_numpy

Told = int | NDArray[Any]
"""What an episode is told: a goal class, an observation or a vector, as the buffer holds it."""


class GoalImages(NamedTuple):
    """A class-balanced batch: uint8 [n, stack, height, width, colours], and classes, int64 [n]."""

    observations: Tensor
    labels: Tensor
    classes: NDArray[np.int64]
    """The same as `labels`, where no device need be asked for it."""


class Goals(Protocol):
    """What the goals of a run are to acting and learning."""

    store: GoalStore
    """Images of reached goals; saved beside the rest of the state, and put back by whoever loads both."""

    @property
    def has_classes(self) -> bool:
        """Whether goals have classes to tell apart, and so losses on their images a sense."""
        ...

    @property
    def counts(self) -> NDArray[np.int64]:
        """Images of reached goals of each class, shape [classes]."""
        ...

    @property
    def is_warm(self) -> bool:
        """Whether enough images are stored for the losses on them."""
        ...

    def begin(self, told: Told) -> Tensor:
        """The embedding of an episode that begins: `embedding`, after everything that is drawn for it.

        Returns:
            float32, a constant, shape [feature_dim].
        """
        ...

    def refresh(self, told: Told) -> None:
        """Bring the embedding up to the newest weights and images, where it is made of images when needed."""
        ...

    def embedding(self, told: Told) -> Tensor:
        """What names a goal now; draws nothing and changes nothing.

        Returns:
            float32, a constant, shape [feature_dim].
        """
        ...

    def pictures(self, batch: EpisodeBatch, rows: NDArray[np.int64]) -> NDArray[Any] | None:
        """Pictures of goals that an update embeds with its observations; `rows` as for `hindsight`.

        Returns:
            [n, *observation_shape]; None where observations and stored images are enough.
        """
        ...

    def instructed(self, agent: GoalAgent, batch: EpisodeBatch, acted: Tensor, shown: Tensor) -> Tensor:
        """The goal embeddings under which an update looks at lived episodes.

        Args:
            agent: one that learns, whose words get the gradient.
            batch: the episodes, with what each was told.
            acted: what it acted under, float32 [B, feature_dim].
            shown: features of `pictures`, [n, feature_dim]; of none where there are none.

        Returns:
            float32 [B, feature_dim].
        """
        ...

    def hindsight(
        self,
        agent: GoalAgent,
        batch: EpisodeBatch,
        rows: NDArray[np.int64],
        reached: Tensor,
        shown: Tensor,
    ) -> Tensor:
        """The goals of relabelled episodes.

        Args:
            agent: one that learns.
            batch: the episodes.
            rows: of their packed observations, those that reached the goals, shape [R].
            reached: f of those, float32 [R, feature_dim].
            shown: as for `instructed`.

        Returns:
            float32 [R, feature_dim].
        """
        ...

    def recognise(self, reached: Tensor) -> Tensor | None:
        """The class of what each f(o_T) shows, as far as the agent can tell.

        Args:
            reached: float32 [R, feature_dim].

        Returns:
            int64 [R]; None before the classes can be told apart.
        """
        ...

    def collect(self, buffer: EpisodeBuffer, ids: ArrayLike) -> None:
        """Keep what the successes among some finished episodes reached."""
        ...

    def batch(self) -> GoalImages | None:
        """Draw the goal images of an update; None before `is_warm`."""
        ...

    def learned(self, images: GoalImages, features: Tensor) -> None:
        """Take the features, float32 [n, feature_dim], that an update gave to a batch of images."""
        ...

    def summed(self, images: GoalImages | None, features: Tensor) -> Tensor:
        """What `learned` makes of a batch, to be summed over ranks: float32 [classes, feature_dim + 1].

        Returns:
            The sum of each class's features and, last, how many there are; of no class where nothing follows.
        """
        ...

    def learned_together(self, sums: Tensor) -> None:
        """As `learned`, from the sum over all ranks of what `summed` gave."""
        ...

    def state_dict(self) -> dict[str, Tensor]:
        """All that changes but the store."""
        ...

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Return to a state that `state_dict` gave."""
        ...


class ClassGoals(Goals):
    """Goals that are classes: their images in a store, and p^x, the mean feature of a class (paper Eq. 4)."""

    def __init__(
        self,
        agent: GoalAgent,
        store: GoalStore,
        prototypes: Prototypes,
        method: MethodSection,
        dtype: torch.dtype,
    ) -> None:
        """Join the parts.

        Args:
            agent: the networks, for words and for features of exact prototypes.
            store: images of reached goals, in so many classes as `prototypes` has.
            prototypes: the table of them.
            method: when and how they are made.
            dtype: type in which the convolutions multiply.
        """
        self.store = store
        self.prototypes = prototypes
        self._agent = agent
        self._method = method
        self._dtype = dtype
        self._device = agent.gate.weight.device

    @property
    def has_classes(self) -> bool:
        """Always."""
        return True

    @property
    def counts(self) -> NDArray[np.int64]:
        """Images stored of each class, shape [classes]."""
        return self.store.counts

    @property
    def is_warm(self) -> bool:
        """Whether the store holds `method.warmup` images."""
        return len(self.store) >= self._method.warmup

    def pictures(self, batch: EpisodeBatch, rows: NDArray[np.int64]) -> NDArray[Any] | None:
        """None: a class is told by its name."""
        return None

    def recognise(self, reached: Tensor) -> Tensor | None:
        """The prototype nearest in angle; None without any, and before `is_warm`.

        A class that nothing was reached of yet has no prototype and is never the nearest.
        """
        (known,) = np.nonzero(self.prototypes.seen)
        if not (len(known) and self.is_warm):
            return None
        table = to_device(self.prototypes.table[known], self._device)
        nearest = (reached @ normalize(table, dim=1).T).argmax(dim=1)
        return to_device(known, self._device)[nearest]

    def show(self, label: int, observations: NDArray[np.uint8]) -> None:
        """Let a class be named by some pictures from now on, where pictures name classes; nothing learns.

        Args:
            label: the class.
            observations: pictures of it, uint8 [n, *observation_shape], one at least.

        Raises:
            ArgumentError: these goals are told otherwise.
            LabelError, DtypeError, ShapeError: for an argument that does not fit; nothing has changed.
        """
        raise ArgumentError(
            "show: expected goals that are named by prototypes of pictures (method.embedding = prototype), "
            f"found {type(self).__name__}"
        )

    def collect(self, buffer: EpisodeBuffer, ids: ArrayLike) -> None:
        """Store the last observation of each success under its instructed class, if it is a picture."""
        if buffer.dtype == np.uint8:
            self.store.collect(buffer, ids)

    def batch(self) -> GoalImages | None:
        """`method.supcon_batch` images, balanced over the classes; None before `is_warm`."""
        if not self.is_warm:
            return None
        assert self._method.supcon_batch is not None, "a configuration that is settled for its task"
        observations, labels = self.store.sample(self._method.supcon_batch, balanced=True)
        return GoalImages(to_device(observations, self._device), to_device(labels, self._device), labels)

    def learned(self, images: GoalImages, features: Tensor) -> None:
        """Move running prototypes towards the features of an update."""
        if self._method.prototype == "running":
            self.prototypes.update(to_numpy(features), images.classes)

    def summed(self, images: GoalImages | None, features: Tensor) -> Tensor:
        """Of no class where prototypes are not running ones."""
        count = self.prototypes.num_classes if self._method.prototype == "running" else 0
        sums = features.new_zeros(count, self.prototypes.dim + 1)
        if images is not None and count:
            sums[:, :-1].index_add_(0, images.labels, features)
            sums[:, -1] = torch.bincount(images.labels, minlength=count)
        return sums

    def learned_together(self, sums: Tensor) -> None:
        """Move running prototypes towards the mean features over all ranks."""
        found = to_numpy(sums)
        (there,) = np.nonzero(found[:, -1])
        if len(there):
            self.prototypes.update(found[there, :-1] / found[there, -1:], there)

    def state_dict(self) -> dict[str, Tensor]:
        """The prototypes, as tensors, which `torch.load` reads without unpickling code."""
        arrays: Mapping[str, Any] = {**self.prototypes.state_dict()}
        return {name: torch.from_numpy(array) for name, array in arrays.items()}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Return to prototypes that `state_dict` gave."""
        self.prototypes.load_state_dict({name: tensor.numpy() for name, tensor in state.items()})


class PrototypeGoals(ClassGoals):
    """Classes that are named by their prototypes.

    A running prototype follows the features of each update's batch; an exact one is made of stored images
    when an episode begins; of a class that was shown it stays what it is. A class without one is named by
    N(0, 1), anew for each episode.
    """

    @cached_property
    def _shown(self) -> set[int]:
        """Classes that are named by the pictures that were shown of them, whatever the store has."""
        return set()

    @cached_property
    def _noise(self) -> NDArray[np.float32]:
        """What names each class until it has a prototype, shape [classes, feature_dim]."""
        return np.zeros_like(self.prototypes.table)

    def begin(self, told: Told) -> Tensor:
        """The embedding of an episode of class `told`: its prototype as of now, else fresh noise."""
        if self._method.prototype == "exact":
            self.refresh(told)
        else:
            self._draw_noise(told)
        return self.embedding(told)

    def refresh(self, told: Told) -> None:
        """Draw an exact p^x anew: from stored images, or as noise while there is none."""
        if self._method.prototype == "exact":
            if self.store.counts[told] and told not in self._shown:
                self._embed_images(int(told))
            self._draw_noise(told)

    def embedding(self, told: Told) -> Tensor:
        """p^x; of a class without one, the noise that its last episode began with, zeros before the first."""
        vectors = self.prototypes.table if self.prototypes.seen[told] else self._noise
        return to_device(vectors[told].copy(), self._device)

    def instructed(self, agent: GoalAgent, batch: EpisodeBatch, acted: Tensor, shown: Tensor) -> Tensor:
        """What the episodes acted under: prototypes are constants in every loss."""
        return acted

    def hindsight(
        self,
        agent: GoalAgent,
        batch: EpisodeBatch,
        rows: NDArray[np.int64],
        reached: Tensor,
        shown: Tensor,
    ) -> Tensor:
        """The prototype nearest in angle to each f(o_T), or f(o_T) itself, as `method.hindsight_goal` says.

        Without any prototype, and before goals can be told apart, it is f(o_T). A class that was never
        reached has none, names nothing and holds up nothing. The goal is a constant: a gradient could make it
        easy instead of the policy good.
        """
        reached = reached.detach()
        nearest = None if self._method.hindsight_goal == "feature" else self.recognise(reached)
        return reached if nearest is None else to_device(self.prototypes.table, self._device)[nearest]

    def show(self, label: int, observations: NDArray[np.uint8]) -> None:
        """Set p^x to the mean feature of some pictures, with running statistics as when acting."""
        _check_shown(label, observations, self.prototypes.num_classes, self.store.observation_shape)
        state = self.prototypes.state_dict()
        state["table"][label] = to_numpy(self._features(observations)).mean(axis=0)
        state["seen"][label] = True
        self.prototypes.load_state_dict(state)
        self._shown.add(label)

    def _draw_noise(self, told: Told) -> None:
        """A fresh N(0, 1) vector for a class without a prototype."""
        if not self.prototypes.seen[told]:
            self._noise[told] = self.prototypes.embed(np.array([told], dtype=np.int64))[0]

    def _embed_images(self, told: int) -> None:
        """Set p^x to the mean feature of stored images, with running statistics as when acting."""
        images = self.store.sample_class(told, self._method.prototype_samples)
        labels = np.full(len(images), told, dtype=np.int64)
        self.prototypes.update(to_numpy(self._features(images)), labels)

    def _features(self, images: NDArray[np.uint8]) -> Tensor:
        self._agent.eval()
        with torch.inference_mode():
            features: Tensor = self._agent.extractor(to_device(images, self._device), self._dtype)
        return features


class WordGoals(ClassGoals):
    """Classes that are named by learned words of the agent; their images and prototypes tell no policy."""

    def begin(self, told: Told) -> Tensor:
        """The word as it is now."""
        return self.embedding(told)

    def refresh(self, told: Told) -> None:
        """A word is always up to date."""

    def embedding(self, told: Told) -> Tensor:
        """A copy of the word, without a gradient."""
        return _words(self._agent).weight[told].detach().clone()

    def instructed(self, agent: GoalAgent, batch: EpisodeBatch, acted: Tensor, shown: Tensor) -> Tensor:
        """The words as `agent` has them, looked up anew so that they learn."""
        found: Tensor = _words(agent)(to_device(batch.goals, acted.device))
        return found

    def hindsight(
        self,
        agent: GoalAgent,
        batch: EpisodeBatch,
        rows: NDArray[np.int64],
        reached: Tensor,
        shown: Tensor,
    ) -> Tensor:
        """f(o_T), a constant: no word says what was reached by mistake."""
        return reached.detach()


def _words(agent: GoalAgent) -> torch.nn.Embedding:
    assert agent.words is not None, "an agent that was built with words"
    return agent.words


def _check_shown(
    label: int, observations: NDArray[np.uint8], num_classes: int, shape: tuple[int, ...]
) -> None:
    """Check what `show` is told."""
    if not 0 <= label < num_classes:
        raise LabelError(f"show: expected a class in 0..{num_classes}, found {label}")
    if observations.dtype != np.uint8:
        raise DtypeError(f"show: expected pictures of dtype uint8, found {observations.dtype}")
    if observations.shape[1:] != shape or not len(observations):
        raise ShapeError(
            f"show: expected pictures of shape [n, {', '.join(map(str, shape))}], n at least 1, "
            f"found {list(observations.shape)}"
        )
