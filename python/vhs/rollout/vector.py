"""The gymnasium face: a `VectorEnv` on a pool in lock-step."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any, Self, TypeVar

import gymnasium
import numpy as np
from gymnasium import Space
from gymnasium.error import AlreadyPendingCallError, NoAsyncCallError
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_differing_spaces, batch_space, create_empty_array
from numpy.typing import NDArray

from vhs._core import ArgumentError
from vhs.rollout.batch import Batch
from vhs.rollout.leaves import Nest
from vhs.rollout.options import EnvFn
from vhs.rollout.pool import RolloutPool
from vhs.rollout.worker import Autoreset

Arrays = NDArray[Any]
Step = tuple[Any, Arrays, Arrays, Arrays, dict[str, Any]]
Answer = TypeVar("Answer")


class RolloutVectorEnv(VectorEnv[Any, Any, Arrays]):
    """Steps all environments of a `RolloutPool` together, as `gymnasium.vector.SyncVectorEnv` would.

    Seeds, spaces, autoreset modes, infos, final observations and errors are gymnasium's; a call may be made
    in two parts, as with its `AsyncVectorEnv`. An episode that was cut (its worker died, or it showed a NaN)
    appears as truncated with reward 0 and `infos["cut"]`, its observation being the next episode's first.

    A `step` or `reset` that a signal handler interrupts, as Ctrl-C does, or whose time is over, is still
    pending: `step_wait` or `reset_wait` goes on with it.
    """

    def __init__(
        self,
        env_fn: EnvFn | list[EnvFn],
        num_workers: int,
        envs_per_worker: int = 1,
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        observation_mode: str | tuple[Space[Any], Space[Any]] = "same",
        **pool: Any,
    ) -> None:
        """Start the workers.

        Args:
            env_fn: as for `RolloutPool`.
            num_workers: processes.
            envs_per_worker: environments that each of them steps.
            autoreset_mode: gymnasium's.
            observation_mode: gymnasium's: "same", "different", or the space of all observations together and
                the one that stands for each.
            pool: further arguments of `RolloutPool`; `on_error` may be "raise" or "restart".

        Raises:
            RuntimeError: environments whose spaces are not those of the first one.
            Exception: as `RolloutPool`.
        """
        self.closed = True  # gymnasium closes what was refused, too: until the end there is nothing to close
        if pool.get("on_error") == "drop":
            raise ArgumentError(
                "on_error: expected 'raise' or 'restart', got 'drop': a VectorEnv keeps its size"
            )
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        batched, mode = _observation_mode(observation_mode)
        self.pool = RolloutPool(
            env_fn,
            num_workers,
            envs_per_worker,
            autoreset=Autoreset(self.autoreset_mode.value),
            observation_mode=mode,
            **pool,
        )
        description = self.pool.description
        self.num_envs = self.pool.num_envs
        self.single_observation_space = self.pool.single_observation_space
        self.single_action_space = self.pool.single_action_space
        self.observation_space = self._batched(mode) if batched is None else batched
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.metadata = {**description.metadata, "autoreset_mode": self.autoreset_mode}
        self.render_mode = description.render_mode
        self.spec = None
        self._nest = Nest(self.single_observation_space, "observation")
        self._observation: Any = None
        self._pending: str | None = None
        """The call that was made and not waited for."""
        self._batch: Batch | None = None
        """Its answers, if they were received before an interrupt came."""
        self._asked = np.arange(self.num_envs)
        """Environments of a pending `reset`."""
        self.closed = False

    def _batched(self, mode: Any) -> Space[Any]:
        """The space of all observations together."""
        if mode == "same":
            return batch_space(self.single_observation_space, self.num_envs)
        try:
            return batch_differing_spaces(self.pool.call("observation_space"))
        except BaseException:
            self.pool.close()
            raise

    @property  # type: ignore[misc] # as gymnasium's own vectors
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """Copies of the generators of all environments, as they are now."""
        return self.get_attr("np_random")

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override] # as gymnasium's
        """The seeds of the generators of all environments."""
        return self.get_attr("np_random_seed")

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in every environment, or in those of `options["reset_mask"]`.

        Args:
            seed: one for all (environment i gets `seed + i`), one each, or None for what the pool's own
                `seed` gives, and without one to go on with their generators.
            options: passed to every environment, without "reset_mask".

        Returns:
            Observations, nested, each leaf [num_envs, ...]; infos as gymnasium collects them.

        Raises:
            AlreadyPendingCallError: a call is pending.
        """
        self.reset_async(seed, options)
        return self.reset_wait()

    def reset_async(
        self, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> None:
        """The first part of `reset`."""
        self._expect_none_pending("reset_async")
        seeds = None if seed is None else _seeds(seed, self.num_envs)
        options = None if options is None else dict(options)
        mask = None if options is None else options.pop("reset_mask", None)
        ids = np.arange(self.num_envs) if mask is None else np.flatnonzero(_mask(mask, self.num_envs))
        self._asked = ids
        self._ask(
            "reset",
            lambda: self.pool.reset(ids, seeds=seeds and [seeds[env] for env in ids], options=options),
        )

    def reset_wait(self, timeout: float | None = None) -> tuple[Any, dict[str, Any]]:
        """The second part of `reset`.

        Raises:
            NoAsyncCallError: no `reset` is pending.
            TimeoutError: not all answered within `timeout` seconds; wait again.
        """
        return self._wait("reset", timeout, self._read_reset)

    def _read_reset(self, batch: Batch) -> tuple[Any, dict[str, Any]]:
        infos: dict[str, Any] = {}
        for row, info in batch.infos.items():
            infos = self._add_info(infos, info, int(self._asked[row]))
        self._observation = batch.observation if len(batch) == self.num_envs else self._merged(batch)
        return self._observation, infos

    def step(self, actions: Any) -> Step:
        """One step of every environment.

        Returns:
            Observations, rewards float64 [num_envs], terminated and truncated bool [num_envs], infos.

        Raises:
            AlreadyPendingCallError: a call is pending.
        """
        self.step_async(actions)
        return self.step_wait()

    def step_async(self, actions: Any) -> None:
        """The first part of `step`."""
        self._expect_none_pending("step_async")
        self._ask("step", lambda: self.pool.send(actions))

    def step_wait(self, timeout: float | None = None) -> Step:
        """The second part of `step`.

        Raises:
            NoAsyncCallError: no `step` is pending.
            TimeoutError: not all answered within `timeout` seconds; wait again.
        """
        return self._wait("step", timeout, self._read_step)

    def _read_step(self, batch: Batch) -> Step:
        infos = self._infos(batch)
        truncated = batch.truncated
        if "cut" in infos:
            truncated = truncated | batch.is_cut
        self._observation = batch.observation
        return self._observation, batch.rewards, batch.terminated, truncated, infos

    def _expect_none_pending(self, call: str) -> None:
        if self._pending is not None:
            raise AlreadyPendingCallError(
                f"Calling `{call}` while waiting for a pending call to `{self._pending}` to complete.",
                self._pending,
            )

    def _ask(self, call: str, ask: Callable[[], None]) -> None:
        # Pending before it is asked: an interrupt between the two must not make the answers somebody else's.
        self._pending = call
        try:
            ask()
        except BaseException:
            if self.pool.closed or not self.pool.num_under_way:
                self._pending = None
            raise

    def _wait(self, call: str, timeout: float | None, read: Callable[[Batch], Answer]) -> Answer:
        if self._pending != call:
            raise NoAsyncCallError(f"Calling `{call}_wait` without any prior call to `{call}_async`.", call)
        try:
            if self._batch is None:
                self._batch = self.pool.recv(timeout=timeout)
            answer = read(self._batch)
        except TimeoutError:
            raise
        except Exception:
            # What the other environments answered belongs to no step that anybody can use.
            self._pending = self._batch = None
            self._drain()
            raise
        self._pending = self._batch = None
        return answer

    def _drain(self) -> None:
        """Take what the others answer, as long as they do."""
        left = self.num_envs + 1
        while not self.pool.closed and 0 < self.pool.num_under_way < left:
            left = self.pool.num_under_way
            with contextlib.suppress(Exception):  # the first one is raised already
                self.pool.recv()

    def render(self) -> tuple[Any, ...]:
        """What every environment renders."""
        return self.pool.call("render")

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of every environment, or read an attribute."""
        return self.pool.call(name, *args, **kwargs)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Read an attribute of every environment."""
        return self.pool.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of every environment, to one value or to one each."""
        each = values if isinstance(values, list | tuple) else [values] * self.num_envs
        if len(each) != self.num_envs:
            raise ArgumentError(f"values: expected {self.num_envs} of them, got {len(each)}")
        self.pool.call_each("set_wrapper_attr", [((name, value), {}) for value in each])

    def close_extras(self, *, timeout: float | None = None, terminate: bool = False, **_: Any) -> None:
        """End the workers.

        Args:
            timeout: most seconds for that, as `close_limit_s` of `RolloutPool`, which None means.
            terminate: whether to kill them at once.
        """
        if self._pending is not None:
            gymnasium.logger.warn(
                f"Calling `close` while waiting for a pending call to `{self._pending}` to complete."
            )
            self._pending = self._batch = None
        self.pool.close(0.0 if terminate else timeout)

    def __enter__(self) -> Self:
        """The vector itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def _infos(self, batch: Batch) -> dict[str, Any]:
        infos: dict[str, Any] = {}
        final_rows = batch.final_rows.tolist()
        if final_rows:
            finals = self._nest.split(batch.final_observation)
            for position, row in enumerate(final_rows):
                final = self._nest.join([self._own(leaf[position]) for leaf in finals])
                infos = self._add_info(infos, {"final_obs": final}, row)
        for row, info in batch.infos.items():
            infos = self._add_info(infos, info, row)
        if batch.is_cut.any():
            for row in np.flatnonzero(batch.is_cut).tolist():
                infos = self._add_info(infos, {"cut": True}, row)
        return infos

    @staticmethod
    def _own(value: Any) -> Any:
        """A number as environments of `Discrete` spaces give it; anything else as it is."""
        return int(value) if isinstance(value, np.integer) else value

    def _merged(self, batch: Batch) -> Any:
        """The last observations with those of the batch put in."""
        shown = self._observation
        if shown is None:  # some were never asked
            shown = create_empty_array(self.single_observation_space, self.num_envs)
        merged = []
        for last, new in zip(self._nest.split(shown), self._nest.split(batch.observation), strict=True):
            if isinstance(new, tuple):
                items = list(last)
                for env, item in zip(batch.env_ids.tolist(), new, strict=True):
                    items[env] = item
                merged.append(tuple(items))
            else:
                leaf = last.copy()
                leaf[batch.env_ids] = new
                merged.append(leaf)
        return self._nest.join(merged)


def _seeds(seed: int | list[int | None], num_envs: int) -> list[int | None]:
    if isinstance(seed, int | np.integer):
        return [int(seed) + env for env in range(num_envs)]
    if len(seed) != num_envs:
        raise ValueError(f"seed: expected {num_envs} of them, got {len(seed)}")
    return list(seed)


def _observation_mode(mode: Any) -> tuple[Space[Any] | None, Any]:
    """The space of all observations, if it is given, and the pool's `observation_mode`."""
    if isinstance(mode, tuple) and len(mode) == 2:
        if all(isinstance(space, Space) for space in mode):
            return mode[0], mode[1]
        raise TypeError(f"Expected both elements of observation_mode to be Spaces, got {mode}")
    if mode not in ("same", "different"):
        raise ArgumentError(
            "Invalid `observation_mode`, expected: 'same' or 'different' or tuple of single and batch "
            f"observation space, actual got {mode}"
        )
    return None, mode


def _mask(mask: Any, num_envs: int) -> NDArray[np.bool_]:
    """The mask, checked in gymnasium's words."""
    name = "`options['reset_mask']`"
    if not isinstance(mask, np.ndarray):
        raise TypeError(f"{name} must be a numpy array, got {type(mask)}")
    if mask.shape != (num_envs,):
        raise ValueError(f"{name} must have shape `({num_envs},)`, got {mask.shape}")
    if mask.dtype != np.bool_:
        raise TypeError(f"{name} must have `dtype=np.bool_`, got {mask.dtype}")
    if not mask.any():
        raise ValueError(
            f"{name} must contain a boolean array with at least one True value, got reset_mask={mask}"
        )
    return mask
