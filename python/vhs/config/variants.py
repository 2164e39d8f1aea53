"""Configurations as flat keys, and the short names that tell variants of one apart."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from vhs.config import Config, known_keys, resolve_config


def flat_config(config: Config) -> dict[str, Any]:
    """Dotted key to plain value, for every key of a configuration."""
    return flatten(config.model_dump(mode="json"))


def plain_method(name: str) -> dict[str, Any]:
    """The flat configuration of a method by its own defaults."""
    return flat_config(resolve_config([{"method": {"name": name}}]))


def flatten(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """A nested mapping as one of dotted keys."""
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        flat |= flatten(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {prefix + key: value}
    return flat


def differing_keys(variants: Sequence[Mapping[str, Any]]) -> list[str]:
    """Keys whose value is not the same in all of some flat configurations, in the order of the schema."""
    keys = dict.fromkeys(key for variant in variants for key in variant)
    return [key for key in keys if any(v.get(key) != variants[0].get(key) for v in variants[1:])]


@dataclass(frozen=True, slots=True, order=True)
class Label:
    """What a group of runs is called: ``vhs relabel_on=timeout`` as a text."""

    method: str
    changes: tuple[str, ...] = ()
    """``relabel_on=timeout``: what sets it apart from the plain method."""
    copy: str = ""
    """Which of several of one configuration it is; empty for the only one."""

    def __str__(self) -> str:
        """As the tables of ``vhs compare`` and its ``--reference`` have it."""
        return " ".join([self.method, *self.changes, *([f"({self.copy})"] if self.copy else [])])


def label(variant: Mapping[str, Any], variants: Sequence[Mapping[str, Any]]) -> Label:
    """The method, and where it departs from its defaults.

    Only keys count in which `variants` of that method differ, so that the plain method is called by its name.
    """
    method = variant["method.name"]
    keys = differing_keys([other for other in variants if other["method.name"] == method])
    plain = plain_method(method)
    changed = [key for key in keys if variant.get(key) != plain.get(key)]
    return Label(method, tuple(describe_keys(variant, changed)))


def describe_keys(flat: Mapping[str, Any], keys: Iterable[str]) -> list[str]:
    """``["relabel_probability=0.4", "relabel_on=failure+timeout"]``: fit for a table and a file name."""
    return [f"{_short(key)}={describe_value(flat.get(key))}" for key in keys]


def describe_value(value: Any) -> str:
    """A value as one word; a list as ``failure+timeout``."""
    if isinstance(value, list | tuple):
        return "+".join(map(describe_value, value)) or "none"
    text = "null" if value is None else str(value)
    return re.sub(r"[^\w.+-]", "_", text)


def _short(key: str) -> str:
    """The last part of a key where no other key ends in it."""
    leaf = key.rpartition(".")[2]
    leaves = Counter(known.rpartition(".")[2] for known in known_keys())
    return leaf if leaves[leaf] == 1 else key
