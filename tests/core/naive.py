"""References that are too simple to be wrong: lists and loops, no rings, no slots, no reuse."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

FRAME_SHAPE = (2, 3)
STACK = 2
INTERACTIONS = {3: 0, 4: 1, 5: 2}


class FrameSource:
    """Frames that are all different: equal bytes mean the same frame."""

    def __init__(self) -> None:
        self.count = 0

    def next(self) -> NDArray[np.uint8]:
        self.count += 1
        digits = [self.count // 256**place % 256 for place in range(6)]
        return np.array(digits, np.uint8).reshape(FRAME_SHAPE)


@dataclass
class Episode:
    """An episode that owns every frame."""

    goal: int
    interaction: int
    frames: list[NDArray[np.uint8]]
    actions: list[int] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    outcome: int = -1

    def __len__(self) -> int:
        return len(self.actions)

    def observation(self, t: int) -> NDArray[np.uint8]:
        return np.stack([self.frames[max(t - back, 0)] for back in reversed(range(STACK))])

    def observations(self) -> NDArray[np.uint8]:
        return np.stack([self.observation(t) for t in range(len(self) + 1)])


class Buffer:
    """The episode buffer: a dictionary of finished episodes, oldest first."""

    def __init__(self, num_streams: int, max_episode_steps: int, capacity_steps: int) -> None:
        self.max_episode_steps = max_episode_steps
        self.capacity_steps = capacity_steps
        self.open: list[Episode | None] = [None] * num_streams
        self.finished: dict[int, Episode] = {}
        self.next_id = 0

    def num_steps(self) -> int:
        return sum(len(episode) for episode in [*self.finished.values(), *self.open] if episode is not None)

    def evict_for(self, steps: int) -> None:
        while self.num_steps() + steps > self.capacity_steps:
            del self.finished[min(self.finished)]

    def append(self, stream: int, action: int, reward: float, value: float, frame: NDArray[np.uint8]) -> None:
        episode = self.open[stream]
        assert episode is not None
        episode.actions.append(action)
        episode.rewards.append(reward)
        episode.values.append(value)
        episode.frames.append(frame)

    def finish(self, stream: int, outcome: int) -> int:
        episode = self.open[stream]
        assert episode is not None
        episode.outcome = outcome
        self.open[stream] = None
        self.finished[self.next_id] = episode
        self.next_id += 1
        return self.next_id - 1


def returns(rewards: NDArray[np.float32], lengths: NDArray[np.int64], gamma: float) -> NDArray[np.float64]:
    """Each return as its own sum, from the definition."""
    out = np.zeros(rewards.shape)
    for row, length in enumerate(lengths):
        for t in range(length):
            out[row, t] = sum(gamma ** (later - t) * float(rewards[row, later]) for later in range(t, length))
    return out
