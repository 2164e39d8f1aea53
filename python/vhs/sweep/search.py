"""A search: Optuna suggests what the trials of a sweep try, by how those before them did.

Its study is a journal in the directory of the sweep, which its holder alone writes. What trial n tries
follows from the seed, n and the trials before: nothing else of the sampler is kept, and a search that was
stopped goes on as if it had not been. A trial whose run failed or was stopped stays open, and is run again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

import numpy as np

from vhs.acting.setup import check_runnable
from vhs.config.variants import flat_config
from vhs.distribution import pip_install
from vhs.errors import ConfigError
from vhs.runs.directory import fixed_settings
from vhs.runs.files import writing
from vhs.sweep.file import SearchSection, Sweep
from vhs.sweep.plan import PlannedRun, Planner
from vhs.sweep.runs import check
from vhs.sweep.study import STUDY_NAME, Space, Watched, load_study, open_study

if TYPE_CHECKING:
    from optuna import Trial
    from optuna.trial import TrialState

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
        self._states = optuna.trial.TrialState
        self._path = path
        self._section = section
        self._seeds = sweep.seeds
        self._out = out
        self._planner = Planner(path, sweep, cores_per_run)
        corners = self._corners()
        try:
            for run in corners:
                check_runnable(run.config)
        except ConfigError as error:
            raise ConfigError(f"{path}: {_WHERE}: {error}") from error
        self._spaces = {
            key: Space(range_, [flat_config(run.config).get(key) for run in corners])
            for key, range_ in section.keys.items()
        }
        self._made_with = {
            **fixed_settings(corners[0].config),
            "train.episodes": corners[0].config.train.episodes,
            **{
                f"search.{name}": value
                for name, value in section.model_dump(mode="json", exclude={"trials"}).items()
            },
            "seeds": list(sweep.seeds),
            **{f"eval.{name}": value for name, value in sweep.eval.model_dump().items()},
        }
        train = corners[0].config.train
        self._warmup_rows = train.episodes // train.log_every // 4
        self._waiting: deque[PlannedRun] = deque()
        self._names: dict[int, list[str]] = {}
        """Of the runs of every open trial."""
        self._found: dict[str, float] = {}
        self._known: set[str] = set()
        """Names of the runs that were handed out: two trials may try the same."""
        self._watched: dict[str, Watched] = {}
        """Open trials that a pruner may end, by the name of their run."""

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
        self._study = open_study(self._out, self._made_with)
        self._study.pruner = self._optuna.pruners.MedianPruner(n_warmup_steps=self._warmup_rows)
        for trial in self._study.get_trials(deepcopy=False):
            if not trial.state.is_finished():
                if trial.params.keys() == self._spaces.keys():
                    # Optuna makes a trial of its own again, to report to, by this name of it alone.
                    self._take(self._optuna.trial.Trial(self._study, trial._trial_id))
                else:  # a kill came before it was told what to try
                    self._tell(trial.number, state=self._states.FAIL)

    def next(self) -> PlannedRun | None:
        """A run of an open trial, or of a new one."""
        count = len(self._study.get_trials(deepcopy=False))
        while not self._waiting and count < self._section.trials:
            self._study.sampler = self._sampler(count)
            with self._writing():
                trial = self._study.ask({key: space.distribution for key, space in self._spaces.items()})
            self._take(trial)
            count += 1
        return self._waiting.popleft() if self._waiting else None

    def finish(self, run: PlannedRun, found: Mapping[str, Any]) -> None:
        """Tell the study of every trial whose last run this was."""
        value = found[self._section.maximise]
        if value is None:
            wanted = self._section.maximise
            raise ConfigError(f"{self._path}: search.maximise: the task measures no {wanted}")
        if self.is_hopeless(run):  # what its last rows say counts as if it had been seen in time
            self.abandon(run)
        self._found[run.name] = value
        self._tell_found()

    def is_hopeless(self, run: PlannedRun) -> bool:
        """Report the new rows of its log to the pruner, if there is one, until it says so."""
        watched = self._watched.get(run.name)
        with self._writing():
            return watched is not None and watched.look(self._out / run.name)

    def abandon(self, run: PlannedRun) -> None:
        """Its trials were pruned; one that tries the same again is judged by the rows that are there."""
        self._known.discard(run.name)
        for number, names in list(self._names.items()):
            if run.name in names:
                del self._names[number]
                self._tell(number, state=self._states.PRUNED)

    def conclude(self) -> list[str]:
        """The best trial."""
        try:
            best = self._study.best_trial
        except ValueError:  # none has ended well
            return []
        runs = self._plan(best.params)
        where = " ".join(str(self._out / run.name) for run in runs)
        wanted = self._section.maximise
        value = f"{best.value:.1%}" if wanted == "success" else f"{best.value:.3f}"
        return [
            f"best of {len(self._study.trials)} trials: {wanted} {value} in {where}",
            f"compare them:  vhs compare {self._out}",
        ]

    def runs_so_far(self) -> tuple[int, list[PlannedRun]]:
        """How many trials the study has, and their runs; nothing is changed."""
        if not (self._out / STUDY_NAME).exists():
            return 0, []
        trials = load_study(self._out, self._made_with).get_trials(deepcopy=False)
        is_over = {self._states.FAIL, self._states.PRUNED}
        wanted = [trial for trial in trials if trial.params and trial.state not in is_over]
        runs = [run for trial in wanted for run in self._plan(trial.params)]
        return len(trials), list({run.name: run for run in runs}.values())

    def _plan(self, params: Mapping[str, Any]) -> list[PlannedRun]:
        keys = {key: self._spaces[key].value(suggested) for key, suggested in params.items()}
        return [self._planner.plan(_WHERE, keys, seed) for seed in self._seeds]

    def _take(self, trial: Trial) -> None:
        """Queue the runs of a trial; one that cannot be has failed for good."""
        number = trial.number
        try:
            runs = self._plan(trial.params)
            for run in runs:
                check(run, self._out)
        except ConfigError:
            self._tell(number, state=self._states.FAIL)
            raise
        self._names[number] = [run.name for run in runs]
        self._waiting += [run for run in runs if run.name not in self._known]
        self._known |= set(self._names[number])
        if self._section.pruner is not None:
            self._watched[runs[0].name] = Watched(trial)
        self._tell_found()

    def _tell_found(self) -> None:
        """Tell the study what is known by now."""
        for number, names in list(self._names.items()):
            if self._found.keys() >= set(names):
                del self._names[number]
                self._tell(number, fmean(self._found[name] for name in names))

    def _tell(self, number: int, value: float | None = None, state: TrialState | None = None) -> None:
        with self._writing():
            self._study.tell(number, value, state)

    def _writing(self) -> AbstractContextManager[None]:
        return writing(self._out / STUDY_NAME)

    def _sampler(self, number: int) -> Any:
        """The sampler of one trial."""
        seed = int(np.random.SeedSequence([self._section.seed, number]).generate_state(1)[0])
        samplers = self._optuna.samplers
        return {"tpe": samplers.TPESampler, "random": samplers.RandomSampler}[self._section.sampler](
            seed=seed
        )
