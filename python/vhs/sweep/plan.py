"""The runs that a sweep file asks for.

A sweep is base configurations, keys set on top, and grids: every combination of a grid's values, with every
seed, is a run. Combinations that resolve to the same configuration are one run. In place of grids a search
says which keys may have which values (`vhs.sweep.search`).
"""

from __future__ import annotations

import itertools
import os
import shlex
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vhs.config import Config, resolve_config
from vhs.config.load import nest, read_placed, unflatten
from vhs.config.schema import idle_keys
from vhs.config.variants import describe_keys, differing_keys, flat_config
from vhs.config.yaml12 import dump_yaml
from vhs.errors import ConfigError
from vhs.sweep.file import RESERVED, EvalSection, Sweep


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

    def as_line(self, out: Path, section: EvalSection) -> str:
        """A line for a shell that trains or resumes it, in a directory of runs, and then evaluates it."""
        both = self.training(out / self.name), evaluation(out / self.name, section)
        return " && ".join(shlex.join(["vhs", *arguments]) for arguments in both)


def evaluation(directory: Path, section: EvalSection) -> list[str]:
    """Arguments of ``vhs`` that evaluate the run in a directory as a sweep asks for."""
    greedy = ["--greedy"] if section.greedy else []
    return ["eval", str(directory), "--episodes", str(section.episodes), "--seed", str(section.seed), *greedy]


class Planner:
    """Makes the runs of one sweep file."""

    def __init__(self, path: Path, sweep: Sweep, cores_per_run: int) -> None:
        """Read the base files.

        Args:
            path: the sweep file, for the base files beside it.
            sweep: its content.
            cores_per_run: processes that a run may have: one learns, the others step the rooms.

        Raises:
            ConfigError: a base file that cannot be read.
        """
        self._path = path
        self._set = sweep.set
        self._bases = [Path(os.path.normpath(path.parent / base)) for base in sweep.base]
        # What a sweep sets for all of its runs speaks to the methods that read it, as a file does.
        self._shared = [*(read_placed(base) for base in self._bases), unflatten(sweep.set)]
        self._cores_per_run = cores_per_run

    def plan(self, where: str, keys: Mapping[str, Any], seed: int) -> PlannedRun:
        """The run with some dotted keys over those that all share.

        Args:
            where: what in the file asks for it, for errors.
            keys: dotted keys and their values.
            seed: of the run.

        Raises:
            ConfigError: that is no configuration.
        """
        own = {**keys, "seed": seed, "env.num_workers": 0, "train.threads": 1}
        config = self._resolve(own, where)
        own["env.num_workers"] = _workers(config.env.num_envs, self._cores_per_run)
        config = self._resolve(own, where)
        idle = idle_keys(config.model_dump())
        shared = {key: value for key, value in self._set.items() if key not in idle}
        name = _name(self._plain_method(config.method.name), config, own)
        return PlannedRun(name, config, _arguments(self._bases, shared | own))

    def _resolve(self, own: Mapping[str, Any], where: str) -> Config:
        try:
            return resolve_config(self._shared, [unflatten(own)])
        except ConfigError as error:
            raise ConfigError(f"{self._path}: {where}: {error}") from error

    def _plain_method(self, method: str) -> Config | None:
        """A method without the keys of any grid; None where it is none without them."""
        try:
            return resolve_config(self._shared, [nest("method.name", method)])
        except ConfigError:
            return None


def plan_runs(path: Path, sweep: Sweep, cores_per_run: int) -> list[PlannedRun]:
    """The runs of a sweep's grids, every configuration with its first seed before any with its second.

    Args:
        path: the sweep file.
        sweep: its content.
        cores_per_run: as for `Planner`.

    Raises:
        ConfigError: a combination that is no configuration, or two that would have the same name.
    """
    planner = Planner(path, sweep, cores_per_run)
    runs: dict[str, PlannedRun] = {}
    for where, own, seed in _combinations(sweep):
        run = planner.plan(where, own, seed)
        if any(other.config == run.config for other in runs.values()):
            continue
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
