"""The one table of methods: which terms each learns from, and what else tells it apart (paper, "Baselines").

A term is named as in the log, and its formula is found under that name in `vhs.learning.terms`. The
configuration reads this table to refuse keys that do nothing, so it needs no torch.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

Embedding = Literal["prototype", "word"]
Network = Literal["gated", "discriminative"]


class Method(NamedTuple):
    """A row: what a method learns from."""

    terms: tuple[str, ...]
    """Names of its losses, in the order in which they are summed."""
    fixed: Mapping[str, Any] = {}
    """Keys of the configuration's section `method` that have one value in this method."""
    network: Network = "gated"
    """The agent's networks, as `vhs.models.make_agent` names them."""
    learning_rate: float | None = None
    """Learning rate at the start unless the configuration says otherwise, where the others' does not suit."""

    @property
    def has_rewards(self) -> bool:
        """Whether rewards are learned from."""
        return "policy" in self.terms

    @property
    def has_imitation(self) -> bool:
        """Whether relabelled episodes are imitated; they are told features, so prototypes must name goals."""
        return "imitation_policy" in self.terms

    def parts(self, embedding: str) -> frozenset[str]:
        """What may read a key of the configuration: the terms, and what names goals."""
        return frozenset((*self.terms, self.fixed.get("embedding", embedding)))


_A3C = ("policy", "value", "entropy")
_PG = (*_A3C, "supcon")
_VHS = (*_PG, "imitation_policy", "imitation_value", "replay", "localise", "remember")

METHODS: dict[str, Method] = {
    "a3c": Method(_A3C, fixed={"embedding": "word"}),
    # At 5e-4 the policy behind the attention became deterministic within 7,000 episodes in one run of five.
    "gdan": Method(
        (*_A3C, "discriminator"),
        fixed={"embedding": "word"},
        network="discriminative",
        learning_rate=3e-4,
    ),
    # Every step counts alike in Ghosh et al.
    "gcsl": Method(
        ("imitation_policy", "supcon"),
        fixed={"embedding": "prototype", "hindsight_discount": 1.0, "imitate_still": True},
    ),
    "pg": Method(_PG),
    "vhs": Method(_VHS),
}


def settle(section: Mapping[str, Any]) -> dict[str, Any]:
    """A section `method` as it was given, with what its method fixes and what names its goals filled in."""
    method = METHODS.get(str(section.get("name", "vhs")))
    fixed = {} if method is None else method.fixed
    own: dict[str, Any] = {"embedding": "prototype"} | dict(fixed)
    if section.get("embedding") == "word" and method is not None and "replay" in method.terms:
        own["replay_ratio"] = 0
    return {**section, **{key: value for key, value in own.items() if section.get(key) is None}}


def check_method(name: str, section: Mapping[str, Any]) -> None:
    """Check that what a whole section `method` says of a method's parts makes sense.

    Raises:
        ValueError: another value of what is fixed, words with relabelling, nothing to learn from.
    """
    method = METHODS[name]
    inside, outside = section["localisation_in_view_deg"], section["localisation_out_of_view_deg"]
    if inside > outside:
        raise ValueError(
            "method.localisation_in_view_deg: expected at most method.localisation_out_of_view_deg = "
            f"{outside}, found {inside}"
        )
    for key, value in method.fixed.items():
        if section[key] != value:
            raise ValueError(f"method.{key}: expected {value} for method.name = {name}, found {section[key]}")
    probability = section["relabel_probability"]
    if method.has_imitation and section["embedding"] == "word" and probability > 0:
        raise ValueError(
            "method.relabel_probability: expected 0 with method.embedding = word, which has no word for what "
            f"was reached by mistake, found {probability}"
        )
    if "replay" in method.terms and section["embedding"] == "word" and section["replay_ratio"]:
        raise ValueError(
            "method.replay_ratio: expected 0 with method.embedding = word, which has no word for what was "
            f"reached by mistake, found {section['replay_ratio']}"
        )
    if method.has_rewards or not method.has_imitation:
        return
    alone = f"for method.name = {name}, which learns from relabelled episodes alone"
    if probability == 0:
        raise ValueError(f"method.relabel_probability: expected above 0 {alone}, found {probability}")
    if section["relabel_on"] == ():
        raise ValueError(f"method.relabel_on: expected an outcome {alone}, found none")
    if section["vhs_weight"] == 0:
        raise ValueError(f"method.vhs_weight: expected above 0 {alone}, found {section['vhs_weight']}")
