"""An `EpisodeBuffer` as the replay buffer of stable-baselines3's off-policy algorithms.

Each observation is stored once, not once as `obs` and once as `next_obs`, and as what its space says: images
as bytes. What it hands out is what `HerReplayBuffer` would: goals of the same distribution, and under them
rewards and, unlike there, ends of the task.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.buffers import BaseBuffer
from stable_baselines3.common.type_aliases import DictReplayBufferSamples
from stable_baselines3.common.vec_env import VecEnv, VecNormalize
from stable_baselines3.her.goal_selection_strategy import GoalSelectionStrategy

from vhs._core import ArgumentError, EmptyError, EpisodeBuffer, ProtocolError, SparseReward, TransitionBatch
from vhs.adapters.sb3.rewards import Rule, kept_rule, restored_rule
from vhs.adapters.sb3.told import KEYS, check_algorithm, recipe_of, shapes_of, strategy_of
from vhs.streams import copied
from vhs.task import Outcome, default_outcome

__all__ = ["HindsightBuffer"]


class HindsightBuffer(HerReplayBuffer):
    """`replay_buffer_class=` for DQN, SAC, TD3 and others that learn off-policy, with "MultiInputPolicy".

    The environment is goal-conditioned: its observations are dictionaries of `observation`, `achieved_goal`
    and `desired_goal`, each of any shape, images too. Arguments of `HerReplayBuffer` mean here what they mean
    there.

    It derives from that class because stable-baselines3 gives an environment to such buffers alone; of its
    storage nothing is used. The episodes are in `episodes`, whose methods may all be called.

    An episode ends where the environment says so, where a reset comes before, and where the desired goal
    changes (the task goes on there: cut off, not terminated). Episodes that are open when the buffer is saved
    are not in the file; after loading, the rest of one is an episode of its own.
    """

    def __init__(
        self,
        buffer_size: int,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        env: VecEnv | None = None,
        device: torch.device | str = "auto",
        n_envs: int = 1,
        optimize_memory_usage: bool = False,
        handle_timeout_termination: bool = True,
        n_sampled_goal: int = 4,
        goal_selection_strategy: GoalSelectionStrategy | str = "future",
        copy_info_dict: bool = False,
        *,
        max_episode_steps: int | None = None,
        goals: Literal["vectors", "observations"] = "vectors",
        reward: SparseReward | Callable[[NDArray[Any], NDArray[Any]], Any] | None = None,
        backing: str | PathLike[str] = "memory",
        seed: int | None = None,
        **others: Any,
    ) -> None:
        """An empty buffer; the algorithm passes what stands before `n_sampled_goal` itself.

        Args:
            buffer_size: Steps kept over all environments.
            observation_space: Of dictionaries, see above.
            action_space: `Discrete` or `Box`.
            env: The vector that is trained on; it is asked for `compute_reward`.
            device: Of the tensors in a batch.
            n_envs: Environments of the vector.
            optimize_memory_usage: Must be False: observations are stored once in any case.
            handle_timeout_termination: Whether an episode that a limit of time ended goes on for the learner.
            n_sampled_goal: Relabelled steps to each that keeps its goal; 0: none.
            goal_selection_strategy: "final", "future", "episode", as there, or "random": any stored
                episode's.
            copy_info_dict: Whether `compute_reward` gets the infos of the steps, which are then kept in
                memory.
            max_episode_steps: Of the longest episode; None: that of the environment's registration.
            goals: "vectors": what was reached is stored beside each observation. "observations": it is the
                observation itself, as where all three are images, and stored once.
            reward: How relabelled steps are rewarded and whether they end the task: a rule, or a function of
                achieved and desired goals, [n, *goal] each, that returns rewards [n], or rewards and
                terminated (bool [n]). None: the environment's `compute_reward`, and `compute_terminated`
                where it has one; without the latter steps stay terminated as they were recorded.
            backing: As for `EpisodeBuffer`.
            seed: Of the generator behind sampling; None: drawn from numpy's global one, which the algorithm
                seeds.
            others: Of an algorithm that this buffer cannot serve.

        Raises:
            ArgumentError: For an algorithm, a space, an environment or a number that does not fit.
        """
        check_algorithm(others, optimize_memory_usage)
        self._shapes = shapes_of(observation_space, action_space)
        BaseBuffer.__init__(self, buffer_size, observation_space, action_space, device, n_envs)
        self.buffer_size = max(buffer_size // n_envs, 1)
        self.handle_timeout_termination = handle_timeout_termination
        self.optimize_memory_usage = False
        self.n_sampled_goal = n_sampled_goal
        self.copy_info_dict = copy_info_dict
        self._strategy = strategy_of(goal_selection_strategy) if n_sampled_goal else None
        self._reward = reward
        self._is_stacked = goals == "observations"
        self._backing = backing
        self._told: list[NDArray[Any] | None] = [None] * n_envs
        """The desired goal of each open episode."""
        self.infos_by_episode: dict[int, list[dict[str, Any]]] = {}
        self._open_infos: list[list[dict[str, Any]]] = [[] for _ in range(n_envs)]
        self.env = None
        self._rule = self._rule_of()
        if env is not None:
            self.set_env(env)
        if seed is None:
            seed = int(np.random.randint(2**63, dtype=np.int64))  # noqa: NPY002 - as said above
        self._recipe = {
            **recipe_of(observation_space, action_space, self._shapes, goals),
            "num_streams": n_envs,
            "capacity_steps": buffer_size,
            "max_episode_steps": self._limit(max_episode_steps, buffer_size),
            "seed": seed,
        }
        self.episodes = self._made()

    def _made(self) -> EpisodeBuffer:
        return EpisodeBuffer(**self._recipe, backing=self._backing)

    def _limit(self, told: int | None, buffer_size: int) -> int:
        limit = told
        if limit is None and self.env is not None:
            limit = getattr(self.env.get_attr("spec", indices=[0])[0], "max_episode_steps", None)
        if limit is None:
            raise ArgumentError(
                "`max_episode_steps`: expected a number for an environment that is registered without a "
                "limit, such as replay_buffer_kwargs={'max_episode_steps': 50}, got None"
            )
        if buffer_size < limit * self.n_envs:
            raise ArgumentError(
                f"`buffer_size`: expected at least {limit * self.n_envs}, an episode of {limit} steps for "
                f"each of {self.n_envs} environments, got {buffer_size}"
            )
        return limit

    def set_env(self, env: VecEnv) -> None:
        """Set the vector whose `compute_reward` is asked, as after loading.

        Raises:
            ArgumentError: For one without, where no `reward` was given.
            ValueError: Where there is one already.
        """
        if self._reward is None and not env.has_attr("compute_reward"):
            raise ArgumentError(
                "`env`: expected a goal-conditioned environment, with compute_reward(achieved_goal, "
                "desired_goal, info), or a `reward` of this buffer, got neither"
            )
        super().set_env(env)
        self._rule = self._rule_of()

    def reset(self) -> None:
        """Forget all episodes."""
        super().reset()
        state = self.episodes.rng_state
        self.episodes = self._made()
        self.episodes.rng_state = state
        self.infos_by_episode.clear()

    def size(self) -> int:
        """Steps stored, an environment on average."""
        return self.episodes.num_steps // self.n_envs

    # -- recording

    def add(  # type: ignore[override] # as `HerReplayBuffer`
        self,
        obs: dict[str, NDArray[Any]],
        next_obs: dict[str, NDArray[Any]],
        action: NDArray[Any],
        reward: NDArray[Any],
        done: NDArray[Any],
        infos: list[dict[str, Any]],
    ) -> None:
        """Record a step of every environment.

        Args:
            obs: Before the step, each entry [n_envs, ...].
            next_obs: After it: of an episode that ended its last one, as the algorithms pass it.
            action: [n_envs] or [n_envs, ...].
            reward: [n_envs].
            done: Whether each episode ended, bool [n_envs].
            infos: Of the step; "TimeLimit.truncated" says that a limit ended the episode. An episode with
                "cut", as `PoolVecEnv` says of one that was lost, is dropped.

        Raises:
            VhsError: As `EpisodeBuffer.append_batch`, such as for an episode of too many steps.
        """
        before, after = self._seen(obs), self._seen(next_obs)
        self._begin(before)
        lost = np.array([bool(info.get("cut")) for info in infos])
        kept = np.flatnonzero(~lost)
        actions = action.reshape(self.n_envs, self.action_dim)
        if not self.episodes.action_dim:
            actions = actions[:, 0].astype(np.int64)
        if len(kept):
            self.episodes.append_batch(
                kept,
                actions[kept],
                np.asarray(reward)[kept],
                None,
                after.frames[kept],
                achieved_goals=None if after.achieved is None else after.achieved[kept],
                fields={key: entry[kept] for key, entry in after.fields.items()},
            )
        for stream in np.flatnonzero(lost).tolist():
            self.episodes.abort(stream)
        for stream in kept.tolist():
            self._note(stream, float(reward[stream]), bool(done[stream]), infos[stream])
        self.pos = (self.pos + 1) % self.buffer_size
        self.full |= self.pos == 0

    def _note(self, stream: int, reward: float, done: bool, info: dict[str, Any]) -> None:
        """What follows a step that was stored."""
        if self.copy_info_dict:
            self._open_infos[stream].append(copied(info))
        if done:
            cut = bool(info.get("TimeLimit.truncated", False))
            self._finish(stream, default_outcome(reward, not cut, cut, info), not cut)

    def _finish(self, stream: int, outcome: Outcome, terminated: bool) -> None:
        number = self.episodes.finish(stream, outcome, terminated)
        if self.copy_info_dict:
            self.infos_by_episode[number] = self._open_infos[stream]
            oldest = int(self.episodes.ids[0])
            for evicted in [old for old in self.infos_by_episode if old < oldest]:
                del self.infos_by_episode[evicted]

    def _seen(self, observations: dict[str, NDArray[Any]]) -> _Seen:
        n = self.n_envs
        frames, achieved, desired, *others = (
            np.asarray(observations[key]).reshape(n, *shape) for key, shape in self._shapes.items()
        )
        fields = dict(zip(list(self._shapes)[len(KEYS) :], others, strict=True))
        if not self._is_stacked:
            return _Seen(frames, achieved, desired, fields)
        if not np.array_equal(frames, achieved):
            raise ArgumentError(
                "`achieved_goal`: expected what `observation` has, as goals='observations' says, got another"
            )
        return _Seen(frames, None, desired[:, None], fields)

    def _begin(self, seen: _Seen) -> None:
        """Open an episode where there is none, and where what is shown does not go on with the open one."""
        opened = np.flatnonzero(self.episodes.open)
        if len(opened):
            shown = self.episodes.observe(opened)[:, 0]
            for frame, stream in zip(shown, opened.tolist(), strict=True):
                if not (
                    _same(frame, seen.frames[stream]) and _same(self._told[stream], seen.desired[stream])
                ):
                    self._leave(stream)
        for stream in np.flatnonzero(~self.episodes.open).tolist():
            self.episodes.begin(
                stream,
                seen.frames[stream],
                desired_goal=seen.desired[stream],
                achieved_goal=None if seen.achieved is None else seen.achieved[stream],
                fields={key: entry[stream] for key, entry in seen.fields.items()},
            )
            self._told[stream], self._open_infos[stream] = seen.desired[stream].copy(), []

    def _leave(self, stream: int) -> None:
        try:
            self._finish(stream, Outcome.TIMEOUT, False)
        except ProtocolError:  # not a step of it was stored
            self.episodes.abort(stream)

    def truncate_last_trajectory(self) -> None:
        """End the open episodes, as cut off; a buffer that was loaded has none."""
        for stream in np.flatnonzero(self.episodes.open).tolist():
            self._leave(stream)

    # -- drawing

    def sample(  # type: ignore[override] # as `HerReplayBuffer`
        self, batch_size: int, env: VecNormalize | None = None
    ) -> DictReplayBufferSamples:
        """Draw steps of finished episodes.

        Args:
            batch_size: Steps, n.
            env: Normalises observations and rewards; None: as they are.

        Returns:
            Observations and next observations, each entry [n, ...] in the type of its space; actions, int64
            [n, 1] or float32 [n, action_dim]; dones and rewards, float32 [n, 1].

        Raises:
            EmptyError: Before the first episode has ended.
        """
        if self._rule is None:
            raise ProtocolError("`sample`: expected an environment to ask for rewards: call `set_env` first")
        how: dict[str, Any] = {}
        if self._strategy is not None:
            how = {"relabel": self._strategy, "ratio": self.n_sampled_goal, "reward": self._rule}
        try:
            steps = self.episodes.sample_transitions(batch_size, **how)
        except EmptyError:
            raise EmptyError(
                "`sample`: expected an episode that has ended, found none; a `learning_starts` above "
                f"{self.episodes.max_episode_steps * self.n_envs}, the longest episode of each environment, "
                "waits for one"
            ) from None
        return self._samples(steps, env)

    def _samples(self, steps: TransitionBatch, env: VecNormalize | None) -> DictReplayBufferSamples:
        before: Any = steps.observations[:, 0]
        after: Any = steps.next_observations[:, 0]
        was, reached, goals = steps.previous_achieved_goals, steps.achieved_goals, steps.goals
        if self._is_stacked:
            assert goals is not None
            was, reached, goals = before, after, goals[:, 0]
        ended = steps.terminated if self.handle_timeout_termination else steps.terminated | steps.truncated
        rewards = self._normalize_reward(steps.rewards[:, None], env)
        return DictReplayBufferSamples(
            observations=self._tensors((before, was, goals), steps.fields, env),
            actions=self.to_torch(steps.actions.reshape(len(steps), -1), copy=False),
            next_observations=self._tensors((after, reached, goals), steps.next_fields, env),
            dones=self.to_torch(ended[:, None].astype(np.float32), copy=False),
            rewards=self.to_torch(rewards, copy=False),
        )

    def _tensors(
        self, entries: tuple[Any, ...], fields: dict[str, NDArray[Any]], env: VecNormalize | None
    ) -> dict[str, torch.Tensor]:
        shown = self._normalize_obs({**dict(zip(KEYS, entries, strict=True)), **fields}, env)
        assert isinstance(shown, dict)
        return {key: self.to_torch(entry, copy=False) for key, entry in shown.items()}

    def _rule_of(self) -> SparseReward | Rule | None:
        """What rewards relabelled steps; None as long as nobody is there to be asked."""
        if isinstance(self._reward, SparseReward):
            return self._reward
        if self._reward is None and self.env is None:
            return None
        infos = self.infos_by_episode if self.copy_info_dict else None
        return Rule(self.env, self._reward, infos, is_stacked=self._is_stacked)

    # -- saving

    def __getstate__(self) -> dict[str, Any]:
        """All but the environment; finished episodes as the bytes of what `EpisodeBuffer.save` writes."""
        state = super().__getstate__()
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "episodes.vhs"
            self.episodes.save(path)
            state["episodes"] = path.read_bytes()
        state["_reward"] = kept_rule(self._reward)
        del state["_rule"]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Go on from what `__getstate__` gave; `set_env` gives it an environment."""
        saved = state.pop("episodes")
        super().__setstate__(state)
        self._reward = restored_rule(self._reward)
        self._rule = self._rule_of()
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "episodes.vhs"
            path.write_bytes(saved)
            self.episodes = EpisodeBuffer.load(path, backing=self._backing)


class _Seen(NamedTuple):
    """Observations of all environments; `achieved` is None where the frames are that."""

    frames: NDArray[Any]
    achieved: NDArray[Any] | None
    desired: NDArray[Any]
    fields: dict[str, NDArray[Any]]
    """What there is beside the entries of a goal."""


def _same(one: NDArray[Any] | None, other: NDArray[Any]) -> bool:
    return one is not None and np.array_equal(one, other, equal_nan=other.dtype.kind == "f")
