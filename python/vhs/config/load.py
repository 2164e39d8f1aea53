"""Configuration files and assignments: read as YAML, merged in order, checked; errors name the key."""

from __future__ import annotations

import copy
import difflib
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from vhs.config.schema import Config, idle_keys, unread_keys
from vhs.errors import ConfigError


def load_config(paths: Sequence[Path | str] = (), overrides: Iterable[str] = ()) -> Config:
    """Resolve a configuration: defaults, then each file in order, then each ``key=value``.

    A file that names no method speaks to all of them: its keys reach the methods that read them. A whole
    configuration, as a run saves it, may hold keys that its method does not read: earlier versions wrote all.

    Args:
        paths: YAML files, each a mapping of some of the sections of `Config`.
        overrides: dotted assignments such as ``train.learning_rate=1e-4``.

    Raises:
        ConfigError: a file that cannot be read, an unknown key (the nearest right one is named), a value of
            the wrong type or out of range, a key that the method does not read.
    """
    trees = [read_yaml(Path(path)) for path in paths]
    return resolve_config(trees, (nest(*parse_assignment(text)) for text in overrides))


def resolve_config(
    overlays: Iterable[Mapping[str, Any]], assignments: Iterable[Mapping[str, Any]] = ()
) -> Config:
    """Resolve a configuration from nested mappings, later ones over earlier ones.

    Args:
        overlays: as of files, see `load_config`.
        assignments: over those; each is meant for the method that results.

    Raises:
        ConfigError: as `load_config`.
    """
    given, meant = list(overlays), list(assignments)
    whole = _merged([*given, *meant])
    tree = _merged([*(_heard(overlay, whole) for overlay in given), *meant])
    try:
        return Config.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(explain(error, list(known_keys()))) from None


def dump_config(config: Config) -> str:
    """The configuration as YAML that `load_config` reads back to the same value: the keys that are read."""
    unread = {key for key, _ in unread_keys(config.method.parts)}
    return yaml.safe_dump(_without(config.model_dump(mode="json"), unread), sort_keys=False)


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML file that holds a mapping.

    Raises:
        ConfigError: it cannot be read, or holds something else.
    """
    try:
        tree = _parse_yaml(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot read the configuration: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: expected YAML, found {error}") from error
    if tree is None:
        return {}
    if not isinstance(tree, dict):
        raise ConfigError(f"{path}: expected a mapping of sections, found {type(tree).__name__}")
    return tree


def parse_assignment(assignment: str) -> tuple[str, Any]:
    """Key and value of ``key=value``, the value as YAML.

    Raises:
        ConfigError: there is no key, or the value is no YAML.
    """
    key, equals, text = assignment.partition("=")
    if not equals or not key.strip():
        raise ConfigError(f"--set: expected key=value, found {assignment!r}")
    try:
        value = _parse_yaml(text)
    except yaml.YAMLError as error:
        raise ConfigError(f"--set {key}: expected a YAML value, found {text!r}") from error
    return key.strip(), value


class _Loader(yaml.SafeLoader):
    """YAML in which a mapping has a key once, as the standard says; PyYAML lets the last one win."""

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


def _parse_yaml(text: str) -> Any:
    return yaml.load(text, Loader=_Loader)


def nest(key: str, value: Any) -> dict[str, Any]:
    """``nest("a.b", 1)`` is ``{"a": {"b": 1}}``."""
    for part in reversed(key.split(".")):
        value = {part: value}
    return dict(value)


def _heard(overlay: Mapping[str, Any], whole: Mapping[str, Any]) -> Mapping[str, Any]:
    """What an overlay has to say in the `whole` configuration that it is a part of."""
    section = overlay.get("method")
    if overlay.keys() >= Config.model_fields.keys():
        return _without(overlay, idle_keys(overlay))
    names_method = isinstance(section, Mapping) and "name" in section
    return overlay if names_method else _without(overlay, idle_keys(whole))


def _without(tree: Mapping[str, Any], keys: Container[str], prefix: str = "") -> dict[str, Any]:
    """A nested mapping without some dotted keys."""
    return {
        key: _without(value, keys, f"{prefix}{key}.") if isinstance(value, Mapping) else value
        for key, value in tree.items()
        if f"{prefix}{key}" not in keys
    }


def _merged(trees: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Later mappings over earlier ones."""
    tree: dict[str, Any] = {}
    for overlay in trees:
        _merge(tree, copy.deepcopy(overlay))
    return tree


def unflatten(keys: Mapping[str, Any]) -> dict[str, Any]:
    """Dotted keys as a nested mapping, later ones over earlier ones."""
    return _merged(nest(key, value) for key, value in keys.items())


def _merge(tree: dict[str, Any], overlay: Mapping[str, Any]) -> None:
    for key, value in overlay.items():
        present = tree.get(key)
        if isinstance(present, dict) and isinstance(value, Mapping):
            _merge(present, value)
        else:
            tree[key] = value


def explain(error: ValidationError, keys: Sequence[str]) -> str:
    """A line for each thing that is wrong: expected and found; `keys` are the known ones."""
    return "\n".join(_explain(detail, keys) for detail in error.errors())


def _explain(detail: ErrorDetails, keys: Sequence[str]) -> str:
    where = ".".join(str(part) for part in detail["loc"])
    if detail["type"] == "extra_forbidden":
        return unknown_key(where, keys)
    if detail["type"] == "value_error":
        return str(detail["ctx"]["error"])
    found = detail["input"]
    shown = "nothing" if found is None else repr(found)
    return f"{where}: expected {_expected(detail['msg'])}, found {shown}"


def _expected(message: str) -> str:
    """Turn pydantic's "Input should be X" into "X"."""
    return message.removeprefix("Input should be ").removeprefix("a valid ").partition(", unable to")[0]


def unknown_key(where: str, keys: Sequence[str]) -> str:
    """Say that `where` is none of `keys`, and name the nearest one that is."""
    nearest = difflib.get_close_matches(where, keys, n=1, cutoff=0.5) or difflib.get_close_matches(
        where.rpartition(".")[2], [key.rpartition(".")[2] for key in keys], n=1, cutoff=0.6
    )
    hint = ""
    if nearest:
        full = next(key for key in keys if key == nearest[0] or key.rpartition(".")[2] == nearest[0])
        hint = f"; did you mean `{full}`?"
    return f"unknown key `{where}`{hint}"


def known_keys(section: type[BaseModel] = Config, prefix: str = "") -> Iterator[str]:
    """Dotted names of every key of a configuration, sections included."""
    for name, field in section.model_fields.items():
        yield prefix + name
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from known_keys(kind, f"{prefix}{name}.")
