"""YAML as its version 1.2 reads scalars (core schema), in which a mapping has a key once; and bounded.

PyYAML follows version 1.1, in which ``010`` is 8, ``1:30`` is 90 and ``1e4`` is a text. A file of a few lines
whose aliases multiply would be gigabytes: its expanded size is counted before anything is built.
"""

from __future__ import annotations

import re
from typing import Any

import yaml

MOST_NODES = 100_000
"""Scalars, lists and mappings of a file, each alias counted with all that it stands for."""

_CORE = (
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    ("int", r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", list("-+0123456789")),
    (
        "float",
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        list("-+.0123456789"),
    ),
    ("merge", "<<", ["<"]),
)
"""Tag, texts, and the characters with which those begin; the first that fits counts."""


def parse_yaml(text: str) -> Any:
    """The one document of a text, as plain values.

    Raises:
        yaml.YAMLError: it is no such document, or too large.
    """
    try:
        return yaml.load(text, Loader=_Loader)
    except RecursionError:
        raise yaml.YAMLError("lists or mappings inside each other, too many to follow") from None
    except ValueError as error:  # a date or a number that there is not
        raise yaml.YAMLError(str(error)) from error


def dump_yaml(value: Any, *, on_one_line: bool = False) -> str:
    """A text that `parse_yaml` reads back to the same value."""
    text: str = yaml.dump(
        value,
        Dumper=_Dumper,
        sort_keys=False,
        default_flow_style=on_one_line,
        width=2**31 if on_one_line else None,
    )
    return text.removesuffix("...\n").strip() if on_one_line else text


class _Loader(yaml.SafeLoader):
    """Reads the core schema."""

    def get_single_node(self) -> yaml.Node | None:
        """The whole document, before anything is built from it."""
        node = super().get_single_node()
        if node is not None:
            _count(node, {})
        return node

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """The node of a mapping, before keys are merged into it; an error at the second of two equal keys."""
        node = super().compose_mapping_node(anchor)
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if (key.tag, key.value) in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"a second `{key.value}`", key.start_mark
                    )
                seen.add((key.tag, key.value))
        return node


class _Dumper(yaml.SafeDumper):
    """Quotes the texts that the core schema would read as something else."""

    def ignore_aliases(self, data: Any) -> bool:
        """Write everything out: a file for people."""
        return True


def _integer(loader: _Loader, node: yaml.ScalarNode) -> int:
    text = loader.construct_scalar(node)
    base = {"0o": 8, "0x": 16}.get(text[:2], 10)
    return int(text, base)


def _count(node: yaml.Node, sizes: dict[int, int | None]) -> int:
    """Nodes below a node, itself included, with every alias written out."""
    known = sizes.get(id(node), 0)
    if known is None:
        raise yaml.composer.ComposerError(None, None, "an alias of something that it is in", node.start_mark)
    if known:
        return known
    sizes[id(node)] = None
    total = 1
    if isinstance(node, yaml.MappingNode):
        total += sum(_count(key, sizes) + _count(value, sizes) for key, value in node.value)
    elif isinstance(node, yaml.SequenceNode):
        total += sum(_count(item, sizes) for item in node.value)
    if total > MOST_NODES:
        raise yaml.composer.ComposerError(
            None, None, f"more than {MOST_NODES:,} values, aliases written out", node.start_mark
        )
    sizes[id(node)] = total
    return total


for _class in (_Loader, _Dumper):
    _class.yaml_implicit_resolvers = {}  # none of version 1.1
    for _tag, _texts, _first in _CORE:
        _class.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(f"(?:{_texts})\\Z"), _first)
_Loader.add_constructor("tag:yaml.org,2002:int", _integer)
