"""The methods that are compared, as the parts that each is made of (paper, section "Baselines").

One update serves them all: a method is a row of this table, and where a part is another formula or another
network, a small class in `vhs.learning.algorithms` or `vhs.models`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

MethodName = Literal["a3c", "gdan", "gcsl", "pg", "vhs"]
Embedding = Literal["prototype", "word"]


class Parts(NamedTuple):
    """What a method learns from."""

    embedding: Embedding
    """What names a goal to the policy unless the configuration says otherwise: a prototype of goal images, or
    a learned vector."""
    any_embedding: bool
    """Whether the other embedding makes sense too."""
    rl: bool
    """Whether rewards are learned from."""
    hindsight: bool
    """Whether relabelled episodes are imitated; their goals are features, so prototypes must name goals."""
    goal_loss: Literal["supcon", "discriminator"] | None
    """The loss on the goal store's images, if any: SupCon, or a discriminator's cross-entropy."""
    learning_rate: float | None = None
    """Learning rate at the start unless the configuration says otherwise, where the others' does not suit."""


METHODS: dict[str, Parts] = {
    "a3c": Parts("word", any_embedding=False, rl=True, hindsight=False, goal_loss=None),
    # At 5e-4 the policy behind the attention became deterministic within 7,000 episodes in one run of five.
    "gdan": Parts(
        "word", any_embedding=False, rl=True, hindsight=False, goal_loss="discriminator", learning_rate=3e-4
    ),
    "gcsl": Parts("prototype", any_embedding=False, rl=False, hindsight=True, goal_loss="supcon"),
    "pg": Parts("prototype", any_embedding=True, rl=True, hindsight=False, goal_loss="supcon"),
    "vhs": Parts("prototype", any_embedding=True, rl=True, hindsight=True, goal_loss="supcon"),
}


def check_parts(
    name: str, embedding: str, relabel_probability: float, relabel_on: Sequence[str], vhs_weight: float
) -> None:
    """Check that what the configuration says of a method's parts makes sense.

    Raises:
        ValueError: goals named by what the method cannot use, words with relabelling, nothing to learn from.
    """
    parts = METHODS[name]
    if embedding != parts.embedding and not parts.any_embedding:
        raise ValueError(
            f"method.embedding: expected {parts.embedding} for method.name = {name}, found {embedding}"
        )
    if parts.hindsight and embedding == "word" and relabel_probability > 0:
        raise ValueError(
            "method.relabel_probability: expected 0 with method.embedding = word, which has no word for what "
            f"was reached by mistake, found {relabel_probability}"
        )
    if parts.rl:
        return
    alone = f"for method.name = {name}, which learns from relabelled episodes alone"
    if relabel_probability == 0:
        raise ValueError(f"method.relabel_probability: expected above 0 {alone}, found {relabel_probability}")
    if not relabel_on:
        raise ValueError(f"method.relabel_on: expected an outcome {alone}, found none")
    if vhs_weight == 0:
        raise ValueError(f"method.vhs_weight: expected above 0 {alone}, found {vhs_weight}")
