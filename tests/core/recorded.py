"""Episodes that buffers and references share: every frame and goal is different, so equal means the same."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

import vhs

GOAL_DIM, ACTION_DIM, MAX_STEPS = 3, 2, 6


@dataclass
class Recorded:
    """An episode of T steps: T + 1 frames and goals reached, T of everything else."""

    frames: NDArray[np.uint8]
    achieved: NDArray[np.float32]
    desired: NDArray[np.float32]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float32]
    outcome: vhs.Outcome
    terminated: bool
    label: int

    def __len__(self) -> int:
        return len(self.rewards)

    def observation(self, t: int, stack: int) -> NDArray[np.uint8]:
        return np.stack([self.frames[max(t - back, 0)] for back in reversed(range(stack))])


@dataclass
class Recording:
    """Episodes by id, and the buffer that holds them."""

    buffer: vhs.EpisodeBuffer
    episodes: list[Recorded] = field(default_factory=list)

    @property
    def stored(self) -> list[int]:
        return self.buffer.ids.tolist()

    def goal(self, episode: int, step: int) -> NDArray[np.float32] | NDArray[np.uint8]:
        """What observation `step` reached."""
        if self.buffer.goals == "vectors":
            return self.episodes[episode].achieved[step]
        return self.episodes[episode].observation(step, self.buffer.frame_stack)

    def told(self, episode: int) -> NDArray[np.float32] | NDArray[np.uint8]:
        if self.buffer.goals == "vectors":
            return self.episodes[episode].desired
        if self.buffer.goals == "observations":
            return self.episodes[episode].observation(1, self.buffer.frame_stack)
        return np.zeros(self.buffer.goal_shape, np.uint8)


def record(
    lengths: list[int],
    goals: str = "vectors",
    stack: int = 2,
    seed: int = 3,
    capacity: int = 60,
    **more: object,
) -> Recording:
    """Episodes of these lengths, the oldest evicted where they are too many."""
    vector = {"goal_shape": (GOAL_DIM,), "goal_dtype": "float32"} if goals == "vectors" else {}
    buffer = vhs.EpisodeBuffer(
        (5,),
        num_streams=1,
        max_episode_steps=MAX_STEPS,
        capacity_steps=capacity,
        frame_stack=stack,
        num_goals=4,
        action_dim=ACTION_DIM,
        goals=goals,
        seed=seed,
        **vector,
        **more,
    )
    recording = Recording(buffer)
    for number, length in enumerate(lengths):
        recording.episodes.append(episode := make_episode(number, length))
        play(recording, episode)
    return recording


def make_episode(number: int, length: int) -> Recorded:
    rng = np.random.default_rng(number)
    outcome = vhs.Outcome(number % 3)
    return Recorded(
        frames=rng.integers(0, 256, (length + 1, 5), dtype=np.uint8),
        achieved=rng.normal(size=(length + 1, GOAL_DIM)).astype(np.float32),
        desired=rng.normal(size=GOAL_DIM).astype(np.float32),
        actions=rng.normal(size=(length, ACTION_DIM)).astype(np.float32),
        rewards=rng.normal(size=length).astype(np.float32),
        outcome=outcome,
        terminated=bool(number % 2),
        label=number % 4,
    )


def play(recording: Recording, episode: Recorded) -> None:
    buffer = recording.buffer
    has_vectors = buffer.goals == "vectors"
    told = {} if buffer.goals == "labels" else {"desired_goal": recording.told(len(recording.episodes) - 1)}
    reached = {"achieved_goal": episode.achieved[0]} if has_vectors else {}
    buffer.begin(0, episode.frames[0], episode.label, **told, **reached)
    for t, action in enumerate(episode.actions):
        reached = {"achieved_goal": episode.achieved[t + 1]} if has_vectors else {}
        buffer.append(0, action, episode.rewards[t], 0.5 * t, episode.frames[t + 1], **reached)
    buffer.finish(0, episode.outcome, terminated=episode.terminated)
