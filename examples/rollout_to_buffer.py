"""Worker processes step, one buffer records: random play in the rooms of Task 2, then a batch in hindsight.

A `HindsightRecorder` in the workers would record nothing here: each process would fill a copy of the buffer.

    python examples/rollout_to_buffer.py
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

import vhs
import vhs.envs  # registers the rooms
from vhs.recorder import GoalReader, default_outcome, make_buffer, reader_of
from vhs.rollout import Batch


def entry(observations: dict[str, Any], row: int) -> dict[str, Any]:
    """One environment's observation out of a batch of them."""
    return {name: values[row] for name, values in observations.items()}


def record(buffer: vhs.EpisodeBuffer, read: GoalReader, batch: Batch, actions: Any) -> None:
    """Record what a pool answered.

    Args:
        buffer: With a stream for each environment of the pool.
        read: Turns an observation into what the buffer stores of it.
        batch: Of `recv`, from a pool with autoreset "SameStep".
        actions: Sent last to each environment, [num_envs].
    """
    final = {row: place for place, row in enumerate(batch.final_rows.tolist())}
    for row, env in enumerate(batch.env_ids.tolist()):
        seen = read(entry(batch.observation, row))
        if batch.is_cut[row] and buffer.open[env]:
            buffer.abort(env)  # its worker died, it raised or showed a NaN: the episode is lost
        elif buffer.open[env]:
            # Where the episode has ended, `observation` is the first of the next one.
            last = read(entry(batch.final_observation, final[row])) if row in final else seen
            reward = float(batch.rewards[row])
            buffer.append(env, actions[env], reward, 0.0, last.frame, achieved_goal=last.achieved_goal)
            if row in final:
                terminated, truncated = bool(batch.terminated[row]), bool(batch.truncated[row])
                info = batch.infos.get(row, {}).get("final_info", {})
                outcome = default_outcome(reward, terminated, truncated, info)
                buffer.finish(env, outcome, terminated=terminated)
        if batch.is_first[row]:
            # A pictured goal is told as a stack of frames: `seen.desired_goal[None]`.
            goals = {"desired_goal": seen.desired_goal, "achieved_goal": seen.achieved_goal}
            buffer.begin(env, seen.frame, seen.label, seen.interaction, **goals)


def collect(make_env: Callable[[], Any], episodes: int, **sizes: Any) -> vhs.EpisodeBuffer:
    """Random episodes of environments in two workers; `sizes` are those of `make_buffer`."""
    with vhs.RolloutPool(make_env, num_workers=2, envs_per_worker=4, seed=0) as pool:
        with make_env() as env:
            buffer = make_buffer(env, num_streams=pool.num_envs, **sizes)
        read = reader_of(pool.single_observation_space)
        actions = np.zeros(pool.num_envs, np.int64)
        pool.single_action_space.seed(0)
        pool.reset()
        while pool.stats.episodes < episodes:
            batch = pool.recv(4)  # at least 4 of 8, whichever are ready first
            record(buffer, read, batch, actions)
            for env in batch.env_ids:  # here a policy would look at `buffer.observe(batch.env_ids)`
                actions[env] = pool.single_action_space.sample()
            pool.send(actions[batch.env_ids], batch.env_ids)
    return buffer


if __name__ == "__main__":
    buffer = collect(
        lambda: gymnasium.make("vhs/InteractiveObjectNav-v0"),
        episodes=200,
        capacity_steps=10_000,
        max_episode_steps=20,
        frame_stack=2,
        interactions={3: 0},
    )
    # As the rooms reward the step that reaches a goal, and any other.
    reward = vhs.SparseReward(9.99, -0.01)
    batch = buffer.sample_transitions(256, "future", ratio=4, reward=reward)
    reached = (batch.rewards[batch.relabelled] > 0).mean()
    print(f"{len(buffer)} episodes, {buffer.num_steps} steps; {reached:.0%} of relabelled steps get there")
