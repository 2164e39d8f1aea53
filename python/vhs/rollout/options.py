"""The settings of a pool: what they may be, refused before anything is made."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import gymnasium

from vhs._core import ArgumentError, DtypeError
from vhs.rollout.worker import Autoreset

EnvFn = Callable[[], gymnasium.Env[Any, Any]]
OnError = Literal["raise", "restart", "drop"]

LEAST_INFO_BYTES = 4096
"""A page: less saves nothing, and the bare word that something went wrong must have room."""
MOST_INFO_BYTES = (1 << 32) - 1


@dataclass(frozen=True)
class Settings:
    """The settings of a pool, as `RolloutPool` describes them.

    Raises:
        ArgumentError: out of range, or a word that is not one of those known.
        DtypeError: of another type.
    """

    num_workers: int
    envs_per_worker: int
    seed: int | None
    autoreset: Autoreset
    on_error: OnError
    deadline_s: float | None
    start_limit_s: float
    close_limit_s: float
    pin: bool | None
    info_bytes: int
    observation_mode: Literal["same", "different"] | gymnasium.Space[Any]

    def __post_init__(self) -> None:
        """Check, and make of each value what its type says."""
        made = {
            "num_workers": whole("num_workers", self.num_workers, 1),
            "envs_per_worker": whole("envs_per_worker", self.envs_per_worker, 1),
            "seed": checked_seed(self.seed),
            "autoreset": _autoreset(self.autoreset),
            "on_error": word("on_error", self.on_error, get_args(OnError)),
            "deadline_s": None if self.deadline_s is None else seconds("deadline_s", self.deadline_s),
            "start_limit_s": seconds("start_limit_s", self.start_limit_s),
            "close_limit_s": seconds("close_limit_s", self.close_limit_s, is_zero_allowed=True),
            "pin": word("pin", self.pin, (None, True, False)),
            "info_bytes": whole("info_bytes", self.info_bytes, LEAST_INFO_BYTES, MOST_INFO_BYTES),
        }
        for name, value in made.items():
            object.__setattr__(self, name, value)
        if not isinstance(self.observation_mode, gymnasium.Space):
            word("observation_mode", self.observation_mode, ("same", "different"))

    @property
    def num_envs(self) -> int:
        """All environments."""
        return self.num_workers * self.envs_per_worker

    def space(self, described: gymnasium.Space[Any]) -> gymnasium.Space[Any]:
        """The observation space that stands for all, where this is that of the first environment."""
        mode = self.observation_mode
        return mode if isinstance(mode, gymnasium.Space) else described


def _autoreset(value: Any) -> Autoreset:
    try:
        return Autoreset(value)
    except ValueError:
        known = [mode.value for mode in Autoreset]
        raise ArgumentError(f"autoreset: expected one of {known}, got {value!r}") from None


def whole(name: str, value: Any, least: int, most: int | None = None) -> int:
    """A whole number in a range.

    Raises:
        DtypeError: not a whole number.
        ArgumentError: out of range.
    """
    if isinstance(value, bool):
        raise DtypeError(f"`{name}`: expected an integer, got {value!r}")
    try:
        number = operator.index(value)
    except TypeError:
        raise DtypeError(f"`{name}`: expected an integer, got {value!r}") from None
    if number < least or (most is not None and number > most):
        expected = f"of at least {least}" if most is None else f"in {least}..={most}"
        raise ArgumentError(f"`{name}`: expected a number {expected}, got {number}")
    return number


def seconds(name: str, value: Any, *, is_zero_allowed: bool = False) -> float:
    """A length of time.

    Raises:
        DtypeError: not a number.
        ArgumentError: not finite, or negative, or 0 where that is no length.
    """
    if isinstance(value, bool | str):
        raise DtypeError(f"`{name}`: expected seconds, got {value!r}")
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise DtypeError(f"`{name}`: expected seconds, got {value!r}") from None
    if not math.isfinite(number) or number < 0.0 or (number == 0.0 and not is_zero_allowed):
        least = "at least" if is_zero_allowed else "more than"
        raise ArgumentError(f"`{name}`: expected a finite time of {least} 0 s, got {value!r}")
    return number


def word(name: str, value: Any, known: Sequence[Any]) -> Any:
    """One of the known words, compared by identity of type too: 1 is not True.

    Raises:
        ArgumentError: another one.
    """
    if not any(type(value) is type(one) and value == one for one in known):
        raise ArgumentError(f"{name}: expected one of {tuple(known)}, got {value!r}")
    return value


def checked_seed(value: Any) -> int | None:
    """A seed of 64 bits, or None.

    Raises:
        DtypeError: not a whole number.
        ArgumentError: out of range.
    """
    if value is None:
        return None
    try:
        return whole("seed", value, 0, (1 << 64) - 1)
    except ArgumentError:
        raise ArgumentError(f"seed: expected an integer in 0..2**64, got {value}") from None


def one_each(env_fn: EnvFn | Sequence[EnvFn], num_envs: int) -> list[EnvFn]:
    """A function for each environment.

    Raises:
        ArgumentError: not one function, nor as many as there are environments.
    """
    if callable(env_fn):
        return [env_fn] * num_envs
    if isinstance(env_fn, str) or not isinstance(env_fn, Sequence) or not all(map(callable, env_fn)):
        raise ArgumentError(
            f"env_fn: expected a function that makes an environment, such as lambda: gymnasium.make(...), "
            f"or {num_envs} of them, got {type(env_fn).__name__}"
        )
    if len(env_fn) != num_envs:
        raise ArgumentError(f"env_fn: expected one function or {num_envs} of them, got {len(env_fn)}")
    return list(env_fn)
