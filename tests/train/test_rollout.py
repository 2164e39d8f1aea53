"""Rollouts on a room of three cells: seeds, goals, final observations, streams that rest."""

from itertools import islice
from typing import Any

import gymnasium
import numpy as np
import torch

from vhs import EpisodeBuffer, Outcome
from vhs.models import FeatureExtractor, GoalAgent
from vhs.train.actor import Actor
from vhs.train.rollout import EndedEpisode, Rollout, episode_seeds
from vhs.train.rooms import LocalRooms

FRAME = (16, 16, 3)


class CountingRoom(gymnasium.Env[Any, Any]):
    """Episode of seed s has length 1 + s % 4; frame t is filled with 10 * (s % 20) + t."""

    observation_space = gymnasium.spaces.Dict(
        {
            "image": gymnasium.spaces.Box(0, 255, FRAME, np.uint8),
            "goal": gymnasium.spaces.Discrete(3),
            "interaction": gymnasium.spaces.Discrete(2),
        }
    )
    action_space = gymnasium.spaces.Discrete(5)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        assert seed is not None
        self.seed, self.t = seed, 0
        return self.observe(), {}

    def observe(self) -> dict[str, Any]:
        value = 10 * (self.seed % 20) + self.t
        return {
            "image": np.full(FRAME, value, dtype=np.uint8),
            "goal": np.int64(self.seed % 3),
            "interaction": np.int64(self.seed % 2),
        }

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        self.t += 1
        done = self.t == 1 + self.seed % 4
        info = {"outcome": "failure", "reached_object": 1, "reached_interaction": 0} if done else {}
        return self.observe(), -0.5, done, False, info


def make_rollout(seeds: list[int], streams: int = 3, greedy: bool = False) -> tuple[Rollout, EpisodeBuffer]:
    torch.manual_seed(0)
    agent = GoalAgent(
        FeatureExtractor(FRAME, 2, (4, 4, 4, 4), 8),
        num_actions=5,
        num_interactions=2,
        hidden_dim=12,
        head_dim=10,
        interaction_dim=4,
    )
    buffer = EpisodeBuffer(
        FRAME,
        num_streams=streams,
        max_episode_steps=5,
        capacity_steps=500,
        frame_stack=2,
        num_goals=3,
        interactions={3: 0, 4: 1},
    )
    actor = Actor(
        agent,
        streams,
        dtype=torch.float32,
        generator=torch.Generator().manual_seed(0),
        greedy=greedy,
    )
    envs = [CountingRoom() for _ in range(streams)]
    return Rollout(
        LocalRooms(envs), streams, actor, buffer, lambda goal: torch.full((8,), float(goal)), iter(seeds)
    ), buffer


def play(rollout: Rollout) -> list[EndedEpisode]:
    ended = []
    while not rollout.is_done:
        ended += rollout.step()
    return ended


def test_every_seed_is_played_exactly_once() -> None:
    rollout, _ = make_rollout(list(range(17)))
    ended = play(rollout)
    assert sorted(episode.seed for episode in ended) == list(range(17))
    assert rollout.begun == 17
    for episode in ended:
        assert episode.steps == 1 + episode.seed % 4
        assert episode.goal == episode.seed % 3
        assert episode.interaction == episode.seed % 2
        assert episode.outcome == Outcome.FAILURE
        assert episode.episode_return == -0.5 * episode.steps
        assert torch.all(episode.goal_embedding == episode.goal)


def test_the_buffer_holds_each_episodes_own_frames_to_the_last() -> None:
    rollout, buffer = make_rollout(list(range(11)))
    for episode in play(rollout):
        batch = buffer.gather(np.array([episode.id]))
        first = 10 * (episode.seed % 20)
        newest = batch.observations[:, 1, 0, 0, 0].tolist()
        older = batch.observations[:, 0, 0, 0, 0].tolist()
        assert newest == [first + t for t in range(episode.steps + 1)]
        assert older == [first, *newest[:-1]]
        assert batch.goals.tolist() == [episode.goal]


def test_fewer_seeds_than_rooms_leave_rooms_at_rest() -> None:
    rollout, _ = make_rollout([4, 5], streams=3)
    assert len(play(rollout)) == 2


def test_same_seeds_same_actions() -> None:
    actions = []
    for _ in range(2):
        rollout, buffer = make_rollout(list(range(9)))
        ids = [episode.id for episode in play(rollout)]
        actions.append(buffer.gather(np.array(ids)).actions)
    np.testing.assert_array_equal(actions[0], actions[1])


def test_episode_seeds_are_distinct_and_can_be_entered_anywhere() -> None:
    seeds = list(islice(episode_seeds(7), 1000))
    assert len(set(seeds)) == 1000
    assert list(islice(episode_seeds(7, first=990), 10)) == seeds[990:]
    assert not set(seeds) & set(islice(episode_seeds(7, purpose=1), 1000))
    assert not set(seeds) & set(islice(episode_seeds(8), 1000))
