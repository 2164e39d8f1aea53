"""Actions: what an action space is to a buffer and to a policy, and how a stored action is done.

Stored are a number, counted from 0, or real numbers. A space of several choices (`MultiDiscrete`,
`MultiBinary`) is stored as one number, that of `numpy.ravel_multi_index`: whatever holds, saves or names an
action (`interactions`) then knows one kind of number, and the policy alone takes it apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vhs._core import ArgumentError

if TYPE_CHECKING:
    from gymnasium import spaces

__all__ = ["ActionSizes", "action_array", "action_sizes", "doer", "shown_space", "stored_action"]

_MOST_NUMBERS = 2**31
"""Of a space of several choices; more than any policy can learn apart by number."""


class ActionSizes(NamedTuple):
    """Sizes of an action, as `TaskSpec` has them."""

    num_actions: int
    """1, which nobody takes, where actions are continuous."""
    action_parts: tuple[int, ...] = ()
    """Options of each of several choices at once; empty where there is one."""
    action_dim: int = 0


def action_sizes(space: spaces.Space[Any]) -> ActionSizes:
    """What a space asks of buffers and policies.

    Raises:
        ArgumentError: For a space of another kind, or of more combinations than can be numbered.
    """
    from gymnasium import spaces

    match space:
        case spaces.Discrete():
            return ActionSizes(int(space.n))
        case spaces.MultiDiscrete() | spaces.MultiBinary():
            parts = _parts(space)
            if math.prod(parts) >= _MOST_NUMBERS:
                raise ArgumentError(
                    f"`env`: expected fewer than {_MOST_NUMBERS} combinations of actions, "
                    f"got {math.prod(parts)} of {space}"
                )
            return ActionSizes(math.prod(parts), parts)
        case spaces.Box():
            return ActionSizes(1, action_dim=int(np.prod(space.shape)))
    raise ArgumentError(f"`env`: expected Discrete, MultiDiscrete, MultiBinary or Box actions, got {space}")


def shown_space(space: spaces.Space[Any]) -> spaces.Space[Any]:
    """The space of stored actions: numbers from 0, or real numbers in -1..1."""
    from gymnasium import spaces

    sizes = action_sizes(space)
    if sizes.action_dim:
        return spaces.Box(-1.0, 1.0, (sizes.action_dim,), np.float32)
    return spaces.Discrete(sizes.num_actions)


def action_array(actions: Sequence[Any], action_dim: int) -> NDArray[Any]:
    """Stored actions as a buffer takes them: int64 [n], or float32 [n, action_dim]."""
    if action_dim:
        return np.array(actions, np.float32).reshape(-1, action_dim)
    return np.array(actions, np.int64)


def doer(space: spaces.Space[Any]) -> Callable[[Any], Any]:
    """From an action of `shown_space` to what an environment of this space takes.

    Raises:
        ArgumentError: As for `action_sizes`; for real numbers without bounds.
    """
    from gymnasium import spaces

    sizes = action_sizes(space)
    if isinstance(space, spaces.Box):
        low, high = np.asarray(space.low, np.float64), np.asarray(space.high, np.float64)
        if not (np.isfinite(low).all() and np.isfinite(high).all()):
            raise ArgumentError(f"`env`: expected continuous actions between finite bounds, got {space}")

        def scaled(action: Any) -> Any:
            share = (np.asarray(action, np.float64).reshape(space.shape) + 1) / 2
            return np.clip(low + share * (high - low), low, high).astype(space.dtype)

        return scaled
    if sizes.action_parts:
        return lambda action: _take_apart(int(action), space)
    first = int(getattr(space, "start", 0))
    return lambda action: int(action) + first


def stored_action(action: Any, space: spaces.Space[Any]) -> Any:
    """From what an environment of this space was given to what is stored; real numbers as they are."""
    sizes = action_sizes(space)
    if sizes.action_dim:
        return np.asarray(action, np.float32).ravel()
    if sizes.action_parts:
        options = np.asarray(action).ravel() - _first(space)
        return int(np.ravel_multi_index(tuple(options), sizes.action_parts))
    return int(action) - int(getattr(space, "start", 0))


def _parts(space: Any) -> tuple[int, ...]:
    from gymnasium import spaces

    if isinstance(space, spaces.MultiBinary):
        return (2,) * int(np.prod(space.shape))
    return tuple(int(options) for options in space.nvec.ravel())


def _first(space: Any) -> Any:
    """Number of the first option of each choice."""
    start = getattr(space, "start", None)
    return 0 if start is None else np.asarray(start).ravel()


def _take_apart(number: int, space: spaces.Space[Any]) -> Any:
    options = np.array(np.unravel_index(number, _parts(space))) + _first(space)
    return options.reshape(space.shape).astype(space.dtype)
