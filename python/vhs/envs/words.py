"""A `Task` in words: an environment that needs no Python, as a configuration describes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from vhs._core import ArgumentError
from vhs.rules import Rule
from vhs.task import Instruction, Motion, Move, Outcome, OutcomeReward, Task, Turn


@dataclass(frozen=True, slots=True)
class RuledOutcome:
    """Judges by rules: the first that holds; where none does, terminated is a failure, the rest a timeout."""

    rules: Mapping[Outcome, Rule]

    def __call__(self, reward: float, terminated: bool, truncated: bool, info: dict[str, Any]) -> Outcome:
        """The outcome of an episode by its last step.

        Raises:
            ArgumentError: A rule names what is not there.
        """
        named = {"reward": reward, "terminated": terminated, "truncated": truncated, "info": info}
        for outcome, rule in self.rules.items():
            if rule.holds(named, info):
                return outcome
        return Outcome.FAILURE if terminated else Outcome.TIMEOUT


@dataclass(frozen=True, slots=True)
class RuledTouch:
    """Says by a rule whether a step reached something."""

    rule: Rule

    def __call__(self, info: Mapping[str, Any]) -> bool:
        """Of the `info` of any step.

        Raises:
            ArgumentError: The rule names what is not there.
        """
        return bool(self.rule.holds({"info": info}, info))


@dataclass(frozen=True, slots=True)
class InfoEntry:
    """What an entry of `info` says was reached."""

    name: str

    def __call__(self, info: Mapping[str, Any]) -> int:
        """The class.

        Raises:
            ArgumentError: There is no such entry.
        """
        if self.name not in info:
            raise ArgumentError(
                f"expected the entry `{self.name}` in info, found {', '.join(info) or 'none'}"
            )
        return int(info[self.name])


def task_of_words(words: Mapping[str, Any]) -> Task:
    """The task that words describe.

    Args:
        words: the fields of `vhs.config.task.TaskSection`, checked.
    """
    told = {name: words[name] for name in ("image", "goal", "interaction") if words[name] is not None}
    plain = ("make", "name", "max_steps", "max_steps_keyword", "goals", "replayable", "limit_ends")
    fields: dict[str, Any] = {name: words[name] for name in (*plain, "actions", "metrics")}
    fields |= {name: dict(words[name]) for name in ("interactions", "keys")}
    if words["beside"]:
        told["fields"] = tuple(words["beside"])
    if told:
        fields["read"] = Instruction(**told)
    if words["outcome"]:
        rules = {outcome: words["outcome"].get(outcome.name.lower()) for outcome in Outcome}
        fields["judge"] = RuledOutcome({outcome: Rule(rule) for outcome, rule in rules.items() if rule})
    if words["reward"] is not None:
        fields["reward"] = OutcomeReward(**words["reward"])
    if words["touched"] is not None:
        fields["touched"] = RuledTouch(Rule(words["touched"]))
    if words["reached"] is not None:
        fields["reached"] = InfoEntry(words["reached"])
    if words["moves"] is not None:
        fields["moves"] = {action: _motion(**motion) for action, motion in words["moves"].items()}
    return Task(**fields)


def _motion(forward_m: float, left_m: float, deg: float | None) -> Motion:
    return Move(forward_m=forward_m, left_m=left_m) if deg is None else Turn(deg=deg)
