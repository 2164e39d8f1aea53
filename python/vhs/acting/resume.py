"""Resuming: what a checkpoint holds of episodes that are not learned from yet, and how they come back.

A checkpoint is made between two moves of the training loop (`Session.advance`: a step of the environments, or
one update). At that moment every episode that has begun is one of

- learned from: counted in `Progress`, its result in the goal store, in the weights and in a row of the log or
  in the partly filled `Window`;
- waiting: ended, not learned from;
- running: so many actions answered, the next one chosen and under way in its environment;
- beginning: its seed given to its environment, the first frame under way.

Where a task says that its episodes cannot be repeated, and where another number of ranks goes on, the last
three are dropped instead.

No frames of these are saved. An environment repeats an episode bit for bit from its seed and its actions,
so waiting and running episodes are played again, which fills the episode buffer and brings the environments
to where they were. What they cannot repeat is saved: critic's values, goal embeddings, LSTM states, actions
under way. With the learner (weights, optimiser, prototypes, goal store, kept episodes, their generators),
the generator of the actions, the number of seeds used and those that were missed, that is everything that
the next move reads. In lock-step the continued run is therefore the uninterrupted one, bit for bit, on the
same machine, software and number of torch's threads.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vhs import EpisodeBuffer, Outcome
from vhs.acting.actor import Actor
from vhs.acting.episodes import EndedEpisode, Episodes, Running
from vhs.acting.players import Choice
from vhs.acting.stepping import Stepping
from vhs.actions import action_array
from vhs.errors import CheckpointError
from vhs.learning.goals import Told


def episodes_state(episodes: Episodes, actor: Actor, waiting: Iterable[EndedEpisode]) -> dict[str, Any]:
    """The waiting, running and beginning episodes, for `resume_episodes`."""
    return {
        "rollout": episodes.state_dict() | {"actor": actor.state_dict()},
        "waiting": [_record(episode, episodes.buffer) for episode in waiting],
    }


def resume_episodes(
    state: Mapping[str, Any], episodes: Episodes, actor: Actor, device: torch.device
) -> deque[EndedEpisode]:
    """Bring environments, buffer and actor back to a state that `episodes_state` gave.

    Args:
        state: what `episodes_state` gave.
        episodes: not started, its buffer without an open episode.
        actor: of their player.
        device: of the goal embeddings.

    Returns:
        The waiting episodes, in their order.

    Raises:
        CheckpointError: an environment plays an episode otherwise than it was.
    """
    stepping, buffer, saved = episodes.stepping, episodes.buffer, state["rollout"]
    waiting: deque[EndedEpisode] = deque()
    records = state["waiting"]
    for first in range(0, len(records), buffer.num_streams):
        group = records[first : first + buffer.num_streams]
        played = dict(enumerate(_running(record["played"], device) for record in group))
        _, ended = play_again(stepping, buffer, played)
        for stream, record in enumerate(group):
            expected, found = Outcome(record["outcome"]), ended.get(stream)
            if found is None or found.outcome != expected:
                raise _otherwise(played[stream].seed, f"a {expected.name.lower()}", _name(found))
            waiting.append(found)
    running = {stream: _running(fields, device) for stream, fields in saved["running"].items()}
    _, ended = play_again(stepping, buffer, running)
    for stream, found in ended.items():
        raise _otherwise(running[stream].seed, "no end yet", _name(found))
    actor.load_state_dict(saved["actor"])
    episodes.resume(saved, running)
    return waiting


def count_episodes(state: Mapping[str, Any]) -> int:
    """How many waiting, running and beginning episodes a state has that `episodes_state` gave."""
    saved = state["rollout"]
    return len(state["waiting"]) + len(saved["running"]) + len(saved["beginning"])


def play_again(
    stepping: Stepping, buffer: EpisodeBuffer, episodes: Mapping[int, Running]
) -> tuple[Mapping[int, Running], dict[int, EndedEpisode]]:
    """Play episodes again, each in the stream that it is given for, up to its last answered action.

    Args:
        stepping: at rest in those streams, and at rest again afterwards.
        buffer: takes the frames; episodes that do not end stay open.
        episodes: by stream.

    Returns:
        Those that run on and those that ended, by stream.

    Raises:
        CheckpointError: an environment plays an episode otherwise than it was.
    """
    again = Episodes(stepping, _Script(episodes, buffer.action_dim), buffer)
    again.begin({stream: episode.seed for stream, episode in episodes.items()})
    ended: dict[int, EndedEpisode] = {}
    while again.under_way:
        ended |= {found.stream: found for found in again.step()}
    for stream, expected in episodes.items():
        _check(expected, ended.get(stream) or again.running[stream])
    return again.running, ended


class _Script:
    """Plays episodes as they were played, and rests where they stopped."""

    def __init__(self, episodes: Mapping[int, Running], action_dim: int) -> None:
        self._action_dim = action_dim
        self._episodes = episodes
        self._taken = dict.fromkeys(episodes, 0)

    def begin(self, stream: int, goal: Told, interaction: int) -> Tensor | None:
        self._taken[stream] = 0
        return self._episodes[stream].goal_embedding

    def act(self, streams: NDArray[np.int64]) -> Choice:
        ready = [s for s in streams.tolist() if self._taken[s] < len(self._episodes[s].actions)]
        actions = [self._episodes[s].actions[self._taken[s]] for s in ready]
        values = [self._episodes[s].values[self._taken[s]] for s in ready]
        self._taken |= {stream: self._taken[stream] + 1 for stream in ready}
        taken = action_array(actions, self._action_dim)
        return np.array(ready, np.int64), taken, np.array(values, np.float32)


def _check(before: Running, now: Running | EndedEpisode) -> None:
    steps = now.steps if isinstance(now, EndedEpisode) else len(now.actions)
    if steps != len(before.actions):
        raise _otherwise(before.seed, f"{len(before.actions)} steps", f"{steps}")
    for name in ("seed", "goal", "interaction", "episode_return"):
        expected, found = getattr(before, name), getattr(now, name)
        if expected != found:
            raise _otherwise(before.seed, f"{name} {expected}", f"{found}")


def _name(ended: EndedEpisode | None) -> str:
    return "no end" if ended is None else f"a {ended.outcome.name.lower()}"


def _otherwise(seed: int, expected: str, found: str) -> CheckpointError:
    return CheckpointError(
        f"playing the episode of seed {seed} again: expected {expected}, found {found}; its environment is "
        "not the one that the checkpoint was made in: resume with the versions of vhs, the environment and "
        "numpy of then"
    )


def _running(fields: Mapping[str, Any], device: torch.device) -> Running:
    """What `Running.as_dict` gave, on the device that it came from."""
    return Running(**{**fields, "goal_embedding": fields["goal_embedding"].to(device)})


def _record(episode: EndedEpisode, buffer: EpisodeBuffer) -> dict[str, Any]:
    """A waiting episode as it was played."""
    batch = buffer.gather(np.array([episode.id], dtype=np.int64))
    played = Running(
        seed=episode.seed,
        goal=episode.goal,
        interaction=episode.interaction,
        goal_embedding=episode.goal_embedding,
        actions=batch.actions[0].tolist(),
        values=batch.values[0].tolist(),
        episode_return=episode.episode_return,
    )
    return {"played": played.as_dict(), "outcome": int(episode.outcome)}
