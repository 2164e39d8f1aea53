"""A search: Optuna suggests what the trials of a sweep try, by how those before them did.

Its study is a journal in the directory of the sweep, which its holder alone writes. What trial n tries
follows from the seed, n and the trials before: nothing else of the sampler is kept, and a search that was
stopped goes on as if it had not been. A trial whose run failed or was stopped stays open, and is run again.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

import numpy as np

from vhs.config.variants import flat_config
from vhs.config.yaml12 import dump_yaml
from vhs.distribution import pip_install
from vhs.errors import CheckpointError, ConfigError, OutputError
from vhs.runs.directory import fixed_settings
from vhs.runs.files import writing
from vhs.sweep.file import Range, SearchSection, Sweep
from vhs.sweep.plan import PlannedRun, Planner
from vhs.sweep.runs import check

if TYPE_CHECKING:
    from optuna import Study

STUDY_NAME = "study.journal"
_STUDY = "sweep"
_WHERE = "search"


class Search:
    """The runs of a search, each planned when its turn comes."""

    def __init__(
        self, path: Path, sweep: Sweep, section: SearchSection, out: Path, cores_per_run: int
    ) -> None:
        """Check what can be before anything is tried.

        Args:
            path: the sweep file.
            sweep: its content.
            section: its search.
            out: directory of the runs.
            cores_per_run: as for `Planner`.

        Raises:
            ConfigError: no Optuna, or an end of a range or a choice that makes no configuration.
        """
        try:
            import optuna
        except ModuleNotFoundError:
            raise ConfigError(f"{path}: search: optuna is not installed; {pip_install('optuna')}") from None
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self._optuna: Any = optuna
        self._path = path
        self._section = section
        self._seeds = sweep.seeds
        self._out = out
        self._planner = Planner(path, sweep, cores_per_run)
        corners = self._corners()
        self._spaces = {
            key: _Space(optuna, key, range_, [flat_config(run.config).get(key) for run in corners])
            for key, range_ in section.keys.items()
        }
        self._made_with = {
            **fixed_settings(corners[0].config),
            "train.episodes": corners[0].config.train.episodes,
            **{f"search.{name}": value for name, value in section.model_dump(exclude={"trials"}).items()},
            "seeds": sweep.seeds,
            **{f"eval.{name}": value for name, value in sweep.eval.model_dump().items()},
        }
        self._waiting: deque[PlannedRun] = deque()
        self._names: dict[int, list[str]] = {}
        """Of the runs of every open trial."""
        self._found: dict[str, float] = {}
        self._known: set[str] = set()
        """Names of the runs that were handed out: two trials may try the same."""

    def _corners(self) -> list[PlannedRun]:
        """Runs in which every key has each end of its range, or each choice, once."""
        first = {key: range_.samples[0] for key, range_ in self._section.keys.items()}
        others = ({key: value} for key, range_ in self._section.keys.items() for value in range_.samples[1:])
        return [self._planner.plan(_WHERE, first | other, self._seeds[0]) for other in ({}, *others)]

    @property
    def total(self) -> int:
        """Trials times seeds."""
        return self._section.trials * len(self._seeds)

    def begin(self) -> None:
        """Open the study; its open trials come first."""
        self._study = self._open(is_new=_mend(self._out / STUDY_NAME))
        for trial in self._study.get_trials(deepcopy=False):
            if not trial.state.is_finished():
                if trial.params.keys() == self._spaces.keys():
                    self._take(trial.number, trial.params)
                else:  # a kill came before it was told what to try
                    self._study.tell(trial.number, state=self._optuna.trial.TrialState.FAIL)

    def next(self) -> PlannedRun | None:
        """A run of an open trial, or of a new one."""
        count = len(self._study.get_trials(deepcopy=False))
        while not self._waiting and count < self._section.trials:
            self._study.sampler = self._sampler(count)
            trial = self._study.ask({key: space.distribution for key, space in self._spaces.items()})
            self._take(trial.number, trial.params)
            count += 1
        return self._waiting.popleft() if self._waiting else None

    def finish(self, run: PlannedRun, found: Mapping[str, Any]) -> None:
        """Tell the study of every trial whose last run this was."""
        value = found[self._section.maximise]
        if value is None:
            wanted = self._section.maximise
            raise ConfigError(f"{self._path}: search.maximise: the task measures no {wanted}")
        self._found[run.name] = value
        self._tell()

    def conclude(self) -> list[str]:
        """The best trial."""
        try:
            best = self._study.best_trial
        except ValueError:  # none has ended well
            return []
        runs = self._plan(best.params)
        where = " ".join(str(self._out / run.name) for run in runs)
        return [
            f"best of {len(self._study.trials)} trials: {self._section.maximise} {best.value:.1%} in {where}",
            f"compare them:  vhs compare {self._out}",
        ]

    def runs_so_far(self) -> tuple[int, list[PlannedRun]]:
        """How many trials the study has, and their runs; nothing is changed."""
        if not (self._out / STUDY_NAME).exists():
            return 0, []
        trials = self._open().get_trials(deepcopy=False)
        runs = [run for trial in trials if trial.params for run in self._plan(trial.params)]
        return len(trials), list({run.name: run for run in runs}.values())

    def _plan(self, params: Mapping[str, Any]) -> list[PlannedRun]:
        keys = {key: self._spaces[key].value(suggested) for key, suggested in params.items()}
        return [self._planner.plan(_WHERE, keys, seed) for seed in self._seeds]

    def _take(self, number: int, params: Mapping[str, Any]) -> None:
        """Queue the runs of a trial; one that cannot be has failed for good."""
        try:
            runs = self._plan(params)
            for run in runs:
                check(run, self._out)
        except ConfigError:
            self._study.tell(number, state=self._optuna.trial.TrialState.FAIL)
            raise
        self._names[number] = [run.name for run in runs]
        self._waiting += [run for run in runs if run.name not in self._known]
        self._known |= set(self._names[number])
        self._tell()

    def _tell(self) -> None:
        """Tell the study what is known by now."""
        for number, names in list(self._names.items()):
            if self._found.keys() >= set(names):
                del self._names[number]
                self._study.tell(number, fmean(self._found[name] for name in names))

    def _sampler(self, number: int) -> Any:
        """The sampler of one trial."""
        seed = int(np.random.SeedSequence([self._section.seed, number]).generate_state(1)[0])
        samplers = self._optuna.samplers
        return {"tpe": samplers.TPESampler, "random": samplers.RandomSampler}[self._section.sampler](
            seed=seed
        )

    def _open(self, *, is_new: bool = False) -> Study:
        """The study on the disk.

        Raises:
            CheckpointError: it is damaged, or that of another search.
            OutputError: it cannot be read or written.
        """
        from optuna.storages.journal import JournalFileBackend

        path = self._out / STUDY_NAME
        made_with = json.loads(json.dumps(self._made_with, default=str))
        try:
            storage = self._optuna.storages.JournalStorage(JournalFileBackend(str(path)))
            study: Study
            if is_new:
                study = self._optuna.create_study(storage=storage, study_name=_STUDY, direction="maximize")
                study.set_user_attr("made_with", made_with)
            else:
                study = self._optuna.load_study(storage=storage, study_name=_STUDY)
            found = study.user_attrs["made_with"]
        except OSError as error:
            raise OutputError(f"{path}: cannot be used: {error.strerror or error}") from error
        except (ValueError, KeyError, TypeError) as error:
            raise CheckpointError(f"{path}: expected a study of Optuna, found {error}") from error
        changed = sorted(
            key for key in found.keys() | made_with.keys() if found.get(key) != made_with.get(key)
        )
        if changed:
            raise CheckpointError(
                f"{path}: holds a search with other values of {', '.join(changed)}; give another --out, "
                "or the sweep file it was made with"
            )
        return study


class _Space:
    """The values of one key, as Optuna and as a configuration have them."""

    def __init__(self, optuna: Any, key: str, range_: Range, seen: list[Any]) -> None:
        """Take a range of whole numbers where the configuration made whole numbers of its ends.

        Args:
            optuna: the package.
            key: dotted.
            range_: what the file says.
            seen: values of the key in configurations that have its ends.
        """
        self._range = range_
        distributions = optuna.distributions
        self._choices: dict[str, Any] = {}
        low, high = range_.low, range_.high
        if range_.choices is not None:
            # Optuna keeps no lists; of a choice it needs the name alone.
            self._choices = {dump_yaml(value, on_one_line=True): value for value in range_.choices}
            self.distribution = distributions.CategoricalDistribution(list(self._choices))
        elif isinstance(low, int) and isinstance(high, int) and not any(isinstance(v, float) for v in seen):
            self.distribution = distributions.IntDistribution(low, high, log=range_.log)
        else:
            self.distribution = distributions.FloatDistribution(low, high, log=range_.log)

    def value(self, suggested: Any) -> Any:
        """What a configuration takes for a suggestion; numbers are cut to four digits, fit for a name."""
        if self._choices:
            return self._choices[suggested]
        if isinstance(suggested, float):
            low, high = self._range.low, self._range.high
            assert low is not None
            assert high is not None
            return min(max(float(f"{suggested:.4g}"), low), high)
        return suggested


def _mend(journal: Path) -> bool:
    """Take away what a kill left: a line that was not written to its end, and Optuna's own lock.

    Returns:
        Whether there is no study: none was begun, or a kill came before it was told what it is for.
    """
    journal.with_name(f"{journal.name}.lock").unlink(missing_ok=True)
    with writing(journal):
        content = journal.read_bytes() if journal.exists() else b""
        lines = content[: content.rfind(b"\n") + 1]
        if lines.count(b"\n") < 2:
            journal.unlink(missing_ok=True)
            return True
        if lines != content:
            with journal.open("r+b") as file:
                file.truncate(len(lines))
    return False
