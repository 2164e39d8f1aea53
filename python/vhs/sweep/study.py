"""The study of a search: Optuna's journal on the disk, the values it suggests, the trials it may end."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vhs.config.yaml12 import dump_yaml
from vhs.errors import CheckpointError, OutputError
from vhs.runs.files import writing
from vhs.sweep.file import Range
from vhs.sweep.state import rows_so_far

if TYPE_CHECKING:
    from optuna import Study, Trial
    from optuna.storages import JournalStorage

STUDY_NAME = "study.journal"
_NAME = "sweep"


def open_study(directory: Path, made_with: Mapping[str, Any]) -> Study:
    """The study of a sweep whose directory is held, or a new one.

    Args:
        directory: of the sweep.
        made_with: what the values of its trials depend on, and what JSON can hold.

    Raises:
        CheckpointError: it is damaged, or that of another search.
        OutputError: it cannot be read or written.
    """
    import optuna

    path = directory / STUDY_NAME
    _mend(path)
    if not path.exists():
        with _storage(path) as storage:
            study = optuna.create_study(storage=storage, study_name=_NAME, direction="maximize")
            study.set_user_attr("made_with", dict(made_with))
    return load_study(directory, made_with)


def load_study(directory: Path, made_with: Mapping[str, Any]) -> Study:
    """The study that is there, for reading alone unless the directory is held.

    Arguments and errors are those of `open_study`.
    """
    import optuna

    path = directory / STUDY_NAME
    with _storage(path) as storage:
        study = optuna.load_study(storage=storage, study_name=_NAME)
        found = study.user_attrs["made_with"]
        wanted = json.loads(json.dumps(made_with))
        changed = sorted(key for key in found.keys() & wanted.keys() if found[key] != wanted[key])
    if changed:
        raise CheckpointError(
            f"{path}: holds a search with other values of {', '.join(changed)}; give another --out, "
            "or the sweep file it was made with"
        )
    return study


@contextmanager
def _storage(path: Path) -> Iterator[JournalStorage]:
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend

    try:
        yield JournalStorage(JournalFileBackend(str(path)))
    except OSError as error:
        raise OutputError(f"{path}: cannot be used: {error.strerror or error}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise CheckpointError(f"{path}: expected a study of Optuna, found {error}") from error


def _mend(journal: Path) -> None:
    """Take away what a kill left: a line that was not written to its end, and Optuna's own lock.

    A journal that does not say yet what it is for goes altogether.
    """
    with writing(journal):
        journal.with_name(f"{journal.name}.lock").unlink(missing_ok=True)
        content = journal.read_bytes() if journal.exists() else b""
        whole = content[: content.rfind(b"\n") + 1]
        if whole.count(b"\n") < 2:
            journal.unlink(missing_ok=True)
        elif whole != content:
            with journal.open("r+b") as file:
                file.truncate(len(whole))


class Space:
    """The values of one key, as Optuna and as a configuration have them."""

    def __init__(self, range_: Range, seen: Sequence[Any]) -> None:
        """Take a range of whole numbers where the configuration made whole numbers of its ends.

        Args:
            range_: what the file says.
            seen: values of the key in configurations that have its ends.
        """
        from optuna.distributions import (
            BaseDistribution,
            CategoricalDistribution,
            FloatDistribution,
            IntDistribution,
        )

        self._choices: dict[str, Any] = {}
        self.distribution: BaseDistribution
        if range_.choices is not None:
            # Optuna keeps no lists; of a choice it needs the name alone.
            self._choices = {dump_yaml(value, on_one_line=True): value for value in range_.choices}
            self.distribution = CategoricalDistribution(list(self._choices))
            return
        low, high = range_.samples
        self._low, self._high = low, high
        if isinstance(low, int) and isinstance(high, int) and not any(isinstance(v, float) for v in seen):
            self.distribution = IntDistribution(low, high, log=range_.log)
        else:
            self.distribution = FloatDistribution(low, high, log=range_.log)

    def value(self, suggested: Any) -> Any:
        """What a configuration takes for a suggestion; fractions are cut to four digits, fit for a name."""
        if self._choices:
            return self._choices[suggested]
        if isinstance(suggested, float):
            return min(max(float(f"{suggested:.4g}"), self._low), self._high)
        return suggested


class Watched:
    """A trial whose run may be ended early."""

    def __init__(self, trial: Trial) -> None:
        """Go on from the rows that were reported before."""
        self._trial = trial
        self._rows = len(trial.study.trials[trial.number].intermediate_values)
        self._is_hopeless = self._rows > 0 and trial.should_prune()

    def look(self, directory: Path) -> bool:
        """Report new rows one by one, as far as it is not hopeless by then."""
        for row in [] if self._is_hopeless else rows_so_far(directory)[self._rows :]:
            self._rows += 1
            self._trial.report(row["rate/success"], self._rows)
            if self._trial.should_prune():
                self._is_hopeless = True
                break
        return self._is_hopeless
