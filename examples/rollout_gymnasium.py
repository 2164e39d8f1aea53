"""A third-party environment in worker processes: random play of gymnasium's own FrozenLake.

python examples/rollout_gymnasium.py
"""

import gymnasium as gym

from vhs import RolloutPool

if __name__ == "__main__":
    with RolloutPool(lambda: gym.make("FrozenLake-v1"), num_workers=2, envs_per_worker=4, seed=0) as pool:
        pool.single_action_space.seed(0)
        pool.reset()
        wins = 0.0
        while pool.stats.episodes < 2000:
            batch = pool.recv(4)  # at least 4 of 8, whichever are ready first
            wins += batch.rewards.sum()
            pool.send([pool.single_action_space.sample() for _ in batch.env_ids], batch.env_ids)
        print(
            f"{pool.stats.episodes} episodes, {pool.stats.steps} steps, {wins / pool.stats.episodes:.1%} won"
        )
