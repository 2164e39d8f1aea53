"""The sweep file: its schema, and the runs that it asks for.

A sweep is base configurations, keys set on top, and grids: every combination of a grid's values, with every
seed, is a run. Combinations that resolve to the same configuration are one run.
"""

from __future__ import annotations

import itertools
import os
import shlex
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from vhs.config import Config, known_keys, resolve_config
from vhs.config.load import nest, parse_assignment, read_placed, read_yaml, unflatten, validate
from vhs.config.schema import idle_keys
from vhs.config.task import placed, placed_task
from vhs.config.variants import describe_keys, differing_keys, flat_config
from vhs.config.yaml12 import dump_yaml
from vhs.errors import ConfigError

RESERVED = {
    "seed": "seeds stand in `seeds`",
    "env.num_workers": "a sweep chooses it by the cores of a run",
    "train.threads": "a sweep chooses it by the cores of a run",
}
"""Keys that a sweep file may not set, and why."""


def _unique(seeds: tuple[int, ...]) -> tuple[int, ...]:
    if len(set(seeds)) < len(seeds):
        raise ValueError(f"seeds: expected each seed once, found {list(seeds)}")
    return seeds


def _free(keys: Mapping[str, Any]) -> Mapping[str, Any]:
    for key in keys:
        if key in RESERVED:
            raise ValueError(f"{key}: expected another key, {RESERVED[key]}")
    return keys


Seeds = Annotated[
    tuple[Annotated[int, Field(ge=0, lt=2**31)], ...], Field(min_length=1), AfterValidator(_unique)
]
Keys = Annotated[dict[str, Any], AfterValidator(_free)]
Values = Annotated[dict[str, Annotated[list[Any], Field(min_length=1)]], AfterValidator(_free)]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class EvalSection(_Section):
    """How every finished run is evaluated: the options of ``vhs eval``."""

    episodes: Annotated[int, Field(ge=1)] = 300
    seed: Annotated[int, Field(ge=0)] = 0
    greedy: bool = False


class GridSection(_Section):
    """One grid: the product of its values."""

    set: Keys = Field(default_factory=dict)
    """Dotted keys for this grid alone, over those of the sweep."""
    grid: Values = Field(default_factory=dict)
    """Dotted key to the values that it takes."""
    seeds: Seeds | None = None
    """Seeds of this grid; null takes those of the sweep."""


class Sweep(_Section):
    """The content of a sweep file."""

    base: tuple[str, ...] = ()
    """Configuration files, relative to the sweep file, later ones over earlier ones."""
    set: Keys = Field(default_factory=dict)
    """Dotted keys over the base, as ``vhs train --set`` takes them."""
    seeds: Seeds = (0,)
    eval: EvalSection = Field(default_factory=EvalSection)
    grids: Annotated[tuple[GridSection, ...], Field(min_length=1)]


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """One configuration with one seed."""

    name: str
    """Task, method, the keys that the grids changed, seed: also the directory of the run."""
    config: Config
    arguments: tuple[str, ...]
    """Of ``vhs train``, without ``--out``."""

    def training(self, directory: Path) -> list[str]:
        """Arguments of ``vhs`` that train it."""
        return ["train", *self.arguments, "--out", str(directory)]


def evaluation(directory: Path, section: EvalSection) -> list[str]:
    """Arguments of ``vhs`` that evaluate the run in a directory as a sweep asks for."""
    greedy = ["--greedy"] if section.greedy else []
    return ["eval", str(directory), "--episodes", str(section.episodes), "--seed", str(section.seed), *greedy]


def list_commands(path: Path, out: Path, overrides: Iterable[str] = ()) -> list[str]:
    """The runs of a sweep file as lines for a shell, on a core each, whoever starts them.

    Args:
        path: the sweep file.
        out: directory of the runs.
        overrides: as for `read_sweep`.

    Returns:
        A line a run, which trains or resumes it and then evaluates it, always in the same order.

    Raises:
        ConfigError: the sweep file or `overrides` cannot be used.
    """
    content, lines = read_sweep(path, overrides), []
    for run in plan_runs(path, content, 1):
        both = run.training(out / run.name), evaluation(out / run.name, content.eval)
        lines.append(" && ".join(shlex.join(["vhs", *arguments]) for arguments in both))
    return lines


def read_sweep(path: Path, overrides: Iterable[str] = ()) -> Sweep:
    """Read a sweep file; each ``key=value`` of the overrides goes over its `set`, and under its grids.

    Raises:
        ConfigError: a file that cannot be read, an unknown key (the nearest one is named), a wrong value.
    """
    tree, assigned = read_yaml(path), placed(dict(map(parse_assignment, overrides)), Path())
    if assigned and isinstance(tree.setdefault("set", {}), dict):
        tree["set"] |= assigned
    try:
        content = validate(Sweep, tree, [*known_keys(Sweep), *known_keys(GridSection, "grids.")])
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    return _placed(content, path.parent)


def _placed(sweep: Sweep, directory: Path) -> Sweep:
    """A sweep whose tasks, where they are files, are found from its directory."""
    grids = []
    for section in sweep.grids:
        grid = section.grid
        if "task" in grid:
            grid = {**grid, "task": [placed_task(task, directory) for task in grid["task"]]}
        grids.append(section.model_copy(update={"set": placed(section.set, directory), "grid": grid}))
    return sweep.model_copy(update={"set": placed(sweep.set, directory), "grids": tuple(grids)})


def plan_runs(path: Path, sweep: Sweep, cores_per_run: int) -> list[PlannedRun]:
    """The runs of a sweep, every configuration with its first seed before any with its second.

    Args:
        path: the sweep file, for the base files beside it.
        sweep: its content.
        cores_per_run: processes that a run may have: one learns, the others step the rooms.

    Raises:
        ConfigError: a combination that is no configuration, or two that would have the same name.
    """
    bases = [Path(os.path.normpath(path.parent / base)) for base in sweep.base]
    # What a sweep sets for all of its runs speaks to the methods that read it, as a file does.
    shared = [*(read_placed(base) for base in bases), unflatten(sweep.set)]
    runs: dict[str, PlannedRun] = {}
    for where, own, seed in _combinations(sweep):
        own |= {"seed": seed, "env.num_workers": 0, "train.threads": 1}
        config = _resolve(shared, own, f"{path}: {where}")
        own["env.num_workers"] = _workers(config.env.num_envs, cores_per_run)
        config = _resolve(shared, own, f"{path}: {where}")
        if any(run.config == config for run in runs.values()):
            continue
        name = _name(_plain_method(shared, config.method.name), config, own)
        idle = idle_keys(config.model_dump())
        keys = {key: value for key, value in sweep.set.items() if key not in idle}
        run = PlannedRun(name, config, _arguments(bases, keys | own))
        if runs.setdefault(run.name, run) is not run:
            raise ConfigError(f"{path}: {where}: another run is called {run.name} too")
    return list(runs.values())


def _combinations(sweep: Sweep) -> Iterator[tuple[str, dict[str, Any], int]]:
    """Where it stands in the file, the keys of its grid, and the seed, for every run."""
    most = max(len(section.seeds or sweep.seeds) for section in sweep.grids)
    for position in range(most):
        for number, section in enumerate(sweep.grids):
            seeds = section.seeds or sweep.seeds
            for values in itertools.product(*section.grid.values()) if position < len(seeds) else ():
                combination = dict(zip(section.grid, values, strict=True))
                yield f"grids.{number}", {**section.set, **combination}, seeds[position]


def _workers(num_envs: int, cores_per_run: int) -> int:
    """One core is the learner's; of the others as many as share the rooms evenly step them."""
    return next(count for count in range(cores_per_run - 1, -1, -1) if count == 0 or num_envs % count == 0)


def _resolve(shared: list[dict[str, Any]], own: Mapping[str, Any], where: str) -> Config:
    try:
        return resolve_config(shared, [unflatten(own)])
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from error


def _plain_method(shared: list[dict[str, Any]], method: str) -> Config | None:
    """A method without the keys of any grid; None where it is none without them."""
    try:
        return resolve_config(shared, [nest("method.name", method)])
    except ConfigError:
        return None


def _name(plain: Config | None, config: Config, own: Iterable[str]) -> str:
    """The keys in which it differs from `plain`; where that is None, all that its grid sets."""
    flat = flat_config(config)
    if plain is None:
        prefixes = tuple(f"{key}." for key in own)
        changed = [key for key in flat if f"{key}.".startswith(prefixes)]
    else:
        changed = differing_keys([flat_config(plain), flat])
    told = {"method.name", *RESERVED}
    keys = [key for key in changed if key not in told and key.partition(".")[0] != "task"]
    return "-".join([config.task_name, config.method.name, *describe_keys(flat, keys), f"seed{config.seed}"])


def _arguments(bases: list[Path], keys: Mapping[str, Any]) -> tuple[str, ...]:
    files = itertools.chain.from_iterable(("--config", str(base)) for base in bases)
    assignments = itertools.chain.from_iterable(
        ("--set", f"{key}={dump_yaml(value, on_one_line=True)}") for key, value in keys.items()
    )
    return (*files, *assignments)
