"""Configuration files and assignments: read as YAML, merged in order, checked; errors name the key."""

from __future__ import annotations

import copy
import difflib
import reprlib
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from vhs.config.schema import BEFORE, GONE, Config, idle_keys, unread_keys
from vhs.config.task import TAGS, TaskSection, placed
from vhs.config.yaml12 import dump_yaml, parse_yaml
from vhs.distribution import find_config, names_of_ours
from vhs.errors import ConfigError
from vhs.reading import read_bounded

_Schema = TypeVar("_Schema", bound=BaseModel)

MOST_BYTES = 200_000
"""Of a configuration file."""

_SHORT = reprlib.Repr()
"""Shows what a person wrote, and of more than that the beginning."""
_SHORT.maxlevel, _SHORT.maxstring, _SHORT.maxother = 3, 80, 80
_SHORT.maxlist = _SHORT.maxtuple = _SHORT.maxdict = 12


def load_config(
    paths: Sequence[Path | str] = (),
    overrides: Iterable[str] = (),
    *,
    task: str | None = None,
    may_be_pipe: bool = True,
) -> Config:
    """Resolve a configuration: defaults, then each file in order, then each ``key=value``.

    A file that names no method speaks to all of them: its keys reach the methods that read them. A whole
    configuration, as a run saves it, may hold keys that its method does not read: earlier versions wrote all.
    Keys that it lacks are as they were when it was saved (`vhs.config.schema.BEFORE`).

    Args:
        paths: YAML files, each a mapping of some of the sections of `Config`; a name such as ``task2`` is
            one of those that come with the package.
        overrides: dotted assignments such as ``train.learning_rate=1e-4``.
        task: the task, over that of every file and of the overrides: as the key `task` has it, or a YAML file
            with that key.
        may_be_pipe: whether a path may lead to something else than a regular file; not for files of others.

    Raises:
        ConfigError: a file that cannot be read, an unknown key (the nearest right one is named), a value of
            the wrong type or out of range, a key that the method does not read.
    """
    trees = [read_placed(find_config(path), may_be_pipe=may_be_pipe) for path in paths]
    assigned = [placed(nest(*parse_assignment(text)), Path()) for text in overrides]
    return resolve_config(trees, [*assigned, *([read_task(task)] if task is not None else [])])


def read_task(named: str) -> dict[str, Any]:
    """The key `task` alone, of a person who named it: as the key has it, or a YAML file with that key.

    Raises:
        ConfigError: a YAML file that cannot be read, or that has no such key.
    """
    if not named.endswith((".yaml", ".yml")):
        return placed({"task": named}, Path())
    tree = read_placed(Path(named))
    if "task" not in tree:
        raise ConfigError(f"--task: expected a file with the key `task`, found none in {named}")
    return {"task": tree["task"]}


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
    return validate(Config, tree, list(known_keys()))


def validate(schema: type[_Schema], tree: Mapping[str, Any], keys: Sequence[str]) -> _Schema:
    """A nested mapping as what a schema describes.

    Args:
        schema: of the whole mapping.
        tree: values as `parse_yaml` gives them.
        keys: the known ones, for the nearest one to an unknown one.

    Raises:
        ConfigError: a line for each thing that is wrong.
    """
    try:
        found = schema.model_validate(tree)
    except ValidationError as error:
        raise ConfigError("\n".join(_explain(detail, keys) for detail in error.errors())) from None
    wrong = list(_truths(tree, found.model_dump()))
    if wrong:
        raise ConfigError("\n".join(f"{key}: expected a number, found {shown}" for key, shown in wrong))
    return found


def _truths(given: Any, taken: Any, where: str = "") -> Iterator[tuple[str, str]]:
    """Where true or false was taken for 1 or 0, which pydantic does and no person means."""
    if isinstance(given, bool) and type(taken) in (int, float):
        yield where, str(given).lower()
    elif isinstance(given, Mapping) and isinstance(taken, Mapping):
        for key in given.keys() & taken.keys():
            yield from _truths(given[key], taken[key], f"{where}.{key}" if where else str(key))
    elif isinstance(given, list | tuple) and isinstance(taken, list | tuple):
        for index, pair in enumerate(zip(given, taken, strict=False)):
            yield from _truths(*pair, f"{where}.{index}")


def dump_config(config: Config) -> str:
    """The configuration as YAML that `load_config` reads back to the same value: the keys that are read."""
    unread = {key for key, _ in unread_keys(config.method.parts)}
    return dump_yaml(_without(config.model_dump(mode="json"), unread))


def read_yaml(path: Path, *, may_be_pipe: bool = True, like: str = "configs/*.yaml") -> dict[str, Any]:
    """A YAML file that holds a mapping.

    Args:
        path: of the file.
        may_be_pipe: as for `load_config`.
        like: which of ours are named where there is none: the `kind` of `names_of_ours`.

    Raises:
        ConfigError: it cannot be read, or holds something else.
    """
    try:
        tree = parse_yaml(read_bounded(path, MOST_BYTES, may_be_pipe=may_be_pipe).decode())
    except OSError as error:
        ours = names_of_ours(path, like)
        raise ConfigError(f"{path}: cannot read the configuration: {error.strerror}{ours}") from error
    except (yaml.YAMLError, ValueError) as error:
        raise ConfigError(f"{path}: expected YAML, found {error}") from error
    if tree is None:
        return {}
    if not isinstance(tree, dict):
        raise ConfigError(f"{path}: expected a mapping of sections, found {type(tree).__name__}")
    return tree


def read_placed(path: Path, *, may_be_pipe: bool = True) -> dict[str, Any]:
    """As `read_yaml`; a task that is a file is found from the directory of the YAML file."""
    return placed(read_yaml(path, may_be_pipe=may_be_pipe), path.parent)


def parse_assignment(assignment: str) -> tuple[str, Any]:
    """Key and value of ``key=value``, the value as YAML.

    Raises:
        ConfigError: there is no key, or the value is no YAML.
    """
    key, equals, text = assignment.partition("=")
    if not equals or not key.strip():
        raise ConfigError(f"--set: expected key=value, found {assignment!r}")
    try:
        value = parse_yaml(text)
    except yaml.YAMLError as error:
        raise ConfigError(f"--set {key}: expected a YAML value, found {text!r}") from error
    return key.strip(), value


def nest(key: str, value: Any) -> dict[str, Any]:
    """``nest("a.b", 1)`` is ``{"a": {"b": 1}}``."""
    for part in reversed(key.split(".")):
        value = {part: value}
    return dict(value)


def _heard(overlay: Mapping[str, Any], whole: Mapping[str, Any]) -> Mapping[str, Any]:
    """What an overlay has to say in the `whole` configuration that it is a part of."""
    section = overlay.get("method")
    if overlay.keys() >= Config.model_fields.keys():
        return _without(_merged([unflatten(BEFORE), overlay]), idle_keys(overlay) | GONE)
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


def _explain(detail: ErrorDetails, keys: Sequence[str]) -> str:
    where = ".".join(str(part) for part in detail["loc"] if part not in TAGS)
    if detail["type"] == "extra_forbidden":
        return unknown_key(where, keys)
    if detail["type"] == "value_error":
        said = str(detail["ctx"]["error"])
        return said if detail["loc"] == () or said.startswith(where) else f"{where}: {said}"
    found = detail["input"]
    shown = "nothing" if found is None else _SHORT.repr(found)
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
        kind = TaskSection if name == "task" and section is Config else field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from known_keys(kind, f"{prefix}{name}.")
