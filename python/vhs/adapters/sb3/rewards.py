"""How steps under a new goal are rewarded: by the vector's environment, or by a function of the user's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from vhs._core import SparseReward
from vhs.streams import Infos

__all__ = ["Rule", "kept_rule", "restored_rule"]


class Rule:
    """What `sample_transitions(reward=)` calls once a batch."""

    by_step = True
    """Samplers hand ids and steps over too."""

    def __init__(
        self,
        env: VecEnv | None,
        function: Callable[[NDArray[Any], NDArray[Any]], Any] | None,
        infos: dict[int, list[dict[str, Any]]] | None,
        *,
        is_stacked: bool,
    ) -> None:
        """A rule.

        Args:
            env: Whose first environment is asked where there is no function.
            function: Of achieved and desired goals.
            infos: Of the steps of each episode, for `compute_reward`; None: it gets empty ones.
            is_stacked: Whether goals come as stacks of one frame.
        """
        self._env = env
        self._function = function
        self._infos = infos
        self._is_stacked = is_stacked
        self._terminates = function is None and env is not None and env.has_attr("compute_terminated")
        self._takes_batches = True
        """Whether `compute_terminated` answers a batch; seen when it is first asked."""

    def __call__(
        self, achieved: NDArray[Any], goals: NDArray[Any], ids: NDArray[np.int64], steps: NDArray[np.int64]
    ) -> Any:
        """Rewards of n steps, or rewards and terminated, each [n]."""
        if self._is_stacked:
            achieved, goals = achieved[:, 0], goals[:, 0]
        if self._function is not None:
            return self._function(achieved, goals)
        infos = [{}] * len(ids) if self._infos is None else list(Infos(self._infos, ids, steps))
        rewards = self._ask("compute_reward", achieved, goals, infos)
        return (rewards, self._terminated(achieved, goals, infos)) if self._terminates else rewards

    def _terminated(self, achieved: NDArray[Any], goals: NDArray[Any], infos: Any) -> NDArray[np.bool_]:
        """Whether each step ends the task; who cannot say it of a batch is asked a row each."""
        if self._takes_batches:
            try:
                answer = np.asarray(self._ask("compute_terminated", achieved, goals, infos))
            except (TypeError, ValueError):  # such as of the truth of an array
                answer = np.asarray(None)
            if answer.shape == (len(infos),):
                return answer.astype(bool)
            self._takes_batches = len(infos) == 1
        rows = zip(achieved, goals, infos, strict=True)
        return np.array([bool(self._ask("compute_terminated", *row)) for row in rows])

    def _ask(self, method: str, *arguments: Any) -> Any:
        assert self._env is not None
        return self._env.env_method(method, *arguments, indices=[0])[0]


def kept_rule(rule: Any) -> Any:
    """A rule as it can be pickled."""
    if isinstance(rule, SparseReward):
        return _Sparse((rule.reached, rule.otherwise, rule.tolerance, rule.terminates))
    return rule


def restored_rule(kept: Any) -> Any:
    """What `kept_rule` kept."""
    return SparseReward(*kept) if isinstance(kept, _Sparse) else kept


class _Sparse(tuple[float, float, float, bool]):
    """The numbers of a `SparseReward`."""
