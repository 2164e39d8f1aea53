"""The sweep file: its schema, and how it is read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from vhs.config import known_keys
from vhs.config.load import parse_assignment, read_yaml, validate
from vhs.config.task import placed, placed_task
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
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


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


class Range(_Section):
    """The values that a search may give a key: a range, or some choices."""

    low: int | float | None = None
    high: int | float | None = None
    """The end of the range, which belongs to it; whole numbers where the key takes no others."""
    log: bool = False
    """Whether equal ratios are equally far apart, as for a learning rate."""
    choices: Annotated[list[Any], Field(min_length=2)] | None = None
    """In place of a range."""

    @property
    def samples(self) -> list[Any]:
        """The ends of the range, or the choices."""
        return [self.low, self.high] if self.choices is None else self.choices

    @model_validator(mode="after")
    def _one_of_both(self) -> Range:
        if self.choices is not None:
            if self.model_fields_set != {"choices"}:
                raise ValueError("expected `low` and `high`, or `choices`, found both")
        elif self.low is None or self.high is None:
            raise ValueError("expected `low` and `high`, or `choices`, found neither")
        elif not self.low < self.high:
            raise ValueError(f"expected low < high, found low {self.low} and high {self.high}")
        elif self.log and self.low <= 0:
            raise ValueError(f"expected low > 0 for log, found {self.low}")
        return self


class SearchSection(_Section):
    """What a study of Optuna looks for, and where."""

    trials: Annotated[int, Field(ge=1)]
    """Trials, each with every seed of the sweep."""
    keys: Annotated[dict[str, Range], Field(min_length=1), AfterValidator(_free)]
    """Dotted key to the values that it may take."""
    maximise: Literal["success", "spl"] = "success"
    """Of the evaluation; of several seeds the mean."""
    sampler: Literal["tpe", "random"] = "tpe"
    """`tpe` learns from the trials before, `random` does not."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Of the sampler."""
    pruner: Literal["median"] | None = None
    """`median` ends a training whose best rate of success so far is below the median that others had after as
    many rows of the log, once a quarter of it is done and five trials have ended; null ends none."""


class Sweep(_Section):
    """The content of a sweep file."""

    base: tuple[str, ...] = ()
    """Configuration files, relative to the sweep file, later ones over earlier ones."""
    set: Keys = Field(default_factory=dict)
    """Dotted keys over the base, as ``vhs train --set`` takes them."""
    seeds: Seeds = (0,)
    eval: EvalSection = Field(default_factory=EvalSection)
    grids: tuple[GridSection, ...] = ()
    search: SearchSection | None = None
    """In place of grids."""

    @model_validator(mode="after")
    def _grids_or_search(self) -> Sweep:
        if self.grids and self.search:
            raise ValueError("search: expected none beside `grids`, found both")
        if self.search and self.search.pruner and len(self.seeds) > 1:
            raise ValueError(f"search.pruner: expected one seed, found {len(self.seeds)}")
        if not self.grids and not self.search:
            raise ValueError("grids: expected at least one, or a `search` in their place, found nothing")
        return self


def read_sweep(path: Path, overrides: Iterable[str] = ()) -> Sweep:
    """Read a sweep file; each ``key=value`` of the overrides goes over its `set`, and under its grids.

    Raises:
        ConfigError: a file that cannot be read, an unknown key (the nearest one is named), a wrong value.
    """
    tree = read_yaml(path, like="configs/sweeps/*.yaml")
    assigned = placed(dict(map(parse_assignment, overrides)), Path())
    if assigned and isinstance(tree.setdefault("set", {}), dict):
        tree["set"] |= assigned
    known = [*known_keys(Sweep), *known_keys(GridSection, "grids."), *known_keys(SearchSection, "search.")]
    try:
        content = validate(Sweep, tree, known)
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
    search = sweep.search
    if search is not None and "task" in search.keys and search.keys["task"].choices is not None:
        choices = [placed_task(task, directory) for task in search.keys["task"].choices]
        task = search.keys["task"].model_copy(update={"choices": choices})
        search = search.model_copy(update={"keys": search.keys | {"task": task}})
    return sweep.model_copy(
        update={"set": placed(sweep.set, directory), "grids": tuple(grids), "search": search}
    )
