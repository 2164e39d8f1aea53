"""Episodes of an environment that counts: seeds, goals, final observations, streams that rest."""

from itertools import islice
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from vhs import Outcome, Task
from vhs.acting.actor import Actor
from vhs.acting.episodes import EndedEpisode, Episodes, Running
from vhs.acting.players import AgentPlayer, RandomPlayer
from vhs.acting.resume import play_again
from vhs.acting.seeds import episode_seeds
from vhs.acting.setup import make_env
from vhs.acting.stepping import LocalStepping
from vhs.buffer import make_buffer
from vhs.errors import CheckpointError
from vhs.models import Categorical, FeatureExtractor, GoalAgent
from vhs.task import TaskSpec

FRAME = (16, 16, 3)


class Counting(gymnasium.Env[Any, Any]):
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
        info = {"outcome": "failure"} if done else {}
        return self.observe(), -0.5, done, False, info


TASK = Task(name="counting", make=lambda: Counting(), max_steps=5, interactions={3: 0, 4: 1})
SPEC = TASK.spec()


def make_episodes(seeds: list[int], streams: int = 3, greedy: bool = False) -> Episodes:
    torch.manual_seed(0)
    agent = GoalAgent(
        FeatureExtractor(FRAME, 2, (4, 4, 4, 4), 8),
        head=Categorical(5),
        num_interactions=2,
        hidden_dim=12,
        head_dim=10,
        interaction_dim=4,
    )
    buffer = make_buffer(SPEC, num_streams=streams, capacity_steps=500, frame_stack=2)
    actor = Actor(
        agent,
        streams,
        dtype=torch.float32,
        generator=torch.Generator().manual_seed(0),
        greedy=greedy,
    )
    stepping = LocalStepping([make_env(TASK, SPEC) for _ in range(streams)])
    player = AgentPlayer(actor, buffer, lambda goal: torch.full((8,), float(goal)))
    episodes = Episodes(stepping, player, buffer, seeds)
    episodes.start()
    return episodes


def play(episodes: Episodes) -> list[EndedEpisode]:
    ended = []
    while not episodes.is_done:
        ended += episodes.step()
    return ended


def test_every_seed_is_played_exactly_once() -> None:
    episodes = make_episodes(list(range(17)))
    ended = play(episodes)
    assert sorted(episode.seed for episode in ended) == list(range(17))
    assert episodes.steps == sum(episode.steps for episode in ended)
    for episode in ended:
        assert episode.steps == 1 + episode.seed % 4
        assert episode.goal == episode.seed % 3
        assert episode.interaction == episode.seed % 2
        assert episode.outcome == Outcome.FAILURE
        assert episode.episode_return == -0.5 * episode.steps
        assert torch.all(episode.goal_embedding == episode.goal)


def test_the_buffer_holds_each_episodes_own_frames_to_the_last() -> None:
    episodes = make_episodes(list(range(11)))
    for episode in play(episodes):
        batch = episodes.buffer.gather(np.array([episode.id]))
        first = 10 * (episode.seed % 20)
        newest = batch.observations[:, 1, 0, 0, 0].tolist()
        older = batch.observations[:, 0, 0, 0, 0].tolist()
        assert newest == [first + t for t in range(episode.steps + 1)]
        assert older == [first, *newest[:-1]]
        assert batch.goals.tolist() == [episode.goal]


def test_fewer_seeds_than_environments_leave_environments_at_rest() -> None:
    episodes = make_episodes([4, 5], streams=3)
    assert sorted(episode.stream for episode in play(episodes)) == [0, 1]


def test_same_seeds_same_actions() -> None:
    actions = []
    for _ in range(2):
        episodes = make_episodes(list(range(9)))
        ids = [episode.id for episode in play(episodes)]
        actions.append(episodes.buffer.gather(np.array(ids)).actions)
    np.testing.assert_array_equal(actions[0], actions[1])


def test_episode_seeds_are_distinct_and_can_be_entered_anywhere() -> None:
    seeds = list(islice(episode_seeds(7), 1000))
    assert len(set(seeds)) == 1000
    assert list(islice(episode_seeds(7, first=990), 10)) == seeds[990:]
    assert not set(seeds) & set(islice(episode_seeds(7, purpose=1), 1000))
    assert not set(seeds) & set(islice(episode_seeds(8), 1000))


def test_episodes_are_played_again_to_where_they_were() -> None:
    episodes = make_episodes([3, 0, 7])  # of 4, 1 and 4 steps
    for _ in range(3):
        episodes.step()
    before = {stream: Running(**running.as_dict()) for stream, running in episodes.running.items()}
    assert {stream: len(running.actions) for stream, running in before.items()} == {0: 2, 2: 2}
    fresh = make_episodes([])
    running, ended = play_again(fresh.stepping, fresh.buffer, before)
    assert not ended
    assert {stream: again.as_dict() for stream, again in running.items()} == {
        stream: again.as_dict() for stream, again in before.items()
    }
    streams = np.array([0, 2])
    np.testing.assert_array_equal(fresh.buffer.observe(streams), episodes.buffer.observe(streams))


def test_an_environment_that_plays_otherwise_is_refused() -> None:
    other = Running(seed=4, goal=1, interaction=1, goal_embedding=None, actions=[0], values=[0.0])
    fresh = make_episodes([])
    with pytest.raises(CheckpointError, match="of seed 4 again: expected interaction 1, found 0"):
        play_again(fresh.stepping, fresh.buffer, {1: other})


def test_chance_plays_without_an_agent() -> None:
    buffer = make_buffer(SPEC, num_streams=2, capacity_steps=100)
    stepping = LocalStepping([make_env(TASK, SPEC) for _ in range(2)])
    episodes = Episodes(
        stepping,
        RandomPlayer(TaskSpec((1,), num_actions=5, max_episode_steps=1), np.random.default_rng(0)),
        buffer,
        range(40),
    )
    episodes.start()
    ended = play(episodes)
    assert len(ended) == 40
    assert all(episode.goal_embedding is None for episode in ended)
    newest = buffer.gather(np.array([ended[-1].id])).actions
    assert ((newest >= 0) & (newest < 5)).all()
