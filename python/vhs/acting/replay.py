"""Resuming: what a checkpoint holds of episodes that are not learned from yet, and how they come back.

A checkpoint is made between two moves of the training loop (`Session.advance`: a step of the rooms, or one
update). At that moment every episode that has begun is one of

- learned from: counted in `Progress`, its result in the goal store, in the weights and in a row of the log or
  in the partly filled `Window`;
- waiting: ended, not learned from;
- running: so many actions answered, the next one chosen and under way in its room;
- beginning: its seed given to its room, the first frame under way.

No frames are saved. A room repeats an episode bit for bit from its seed and its actions, so waiting and
running episodes are played again, which fills the episode buffer and brings the rooms to where they were.
What rooms cannot repeat is saved: critic's values, goal embeddings, LSTM states, actions under way.
With the learner (weights, optimiser, prototypes, goal store, their generators), the generator of the actions
and the number of seeds used, that is everything that the next move reads. In lock-step the continued run is
therefore the uninterrupted one, bit for bit, on the same machine, software and number of torch's threads.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import torch

from vhs import EpisodeBuffer, Outcome
from vhs.acting.episodes import EndedEpisode, Rollout, Running
from vhs.acting.stepping import Answers, Rooms
from vhs.errors import CheckpointError


def episodes_state(
    rollout: Rollout, waiting: Iterable[EndedEpisode], buffer: EpisodeBuffer
) -> dict[str, Any]:
    """The waiting, running and beginning episodes, for `resume_episodes`."""
    return {"rollout": rollout.state_dict(), "waiting": [_record(episode, buffer) for episode in waiting]}


def resume_episodes(
    state: Mapping[str, Any],
    rollout: Rollout,
    rooms: Rooms,
    num_streams: int,
    buffer: EpisodeBuffer,
    device: torch.device,
) -> deque[EndedEpisode]:
    """Bring rooms, buffer and rollout back to a state that `episodes_state` gave.

    Args:
        state: what `episodes_state` gave.
        rollout: made with ``begin=False``.
        rooms: those of the rollout, at rest.
        num_streams: how many there are.
        buffer: that of the rollout, without an open episode.
        device: of the goal embeddings.

    Returns:
        The waiting episodes, in their order.

    Raises:
        CheckpointError: a room plays an episode otherwise than it was.
    """
    waiting: deque[EndedEpisode] = deque()
    records = state["waiting"]
    for first in range(0, len(records), num_streams):
        group = records[first : first + num_streams]
        played = [_running(record["played"], device) for record in group]
        replay(rooms, buffer, dict(enumerate(played)))
        for stream, record in enumerate(group):
            waiting.append(_finish(record, stream, played[stream], buffer))
    running = {stream: _running(fields, device) for stream, fields in state["rollout"]["running"].items()}
    replay(rooms, buffer, running)
    rollout.resume(state["rollout"], running)
    return waiting


def replay(rooms: Rooms, buffer: EpisodeBuffer, episodes: Mapping[int, Running]) -> None:
    """Play episodes again, each in the room and stream that it is given for, up to its last answered action.

    Args:
        rooms: at rest in those streams, and at rest again afterwards.
        buffer: takes the frames; its episodes stay open.
        episodes: by stream.

    Raises:
        CheckpointError: a room plays an episode otherwise than it was.
    """
    if not episodes:
        return
    again = {stream: Running(e.seed, -1, -1, e.goal_embedding) for stream, e in episodes.items()}
    rooms.reset(list(episodes), [episode.seed for episode in episodes.values()])
    under_way = len(episodes)
    while under_way:
        answers = rooms.recv()
        _take(answers, buffer, episodes, again)
        streams = [s for s in answers.streams.tolist() if len(again[s].actions) < len(episodes[s].actions)]
        actions = [episodes[stream].actions[len(again[stream].actions)] for stream in streams]
        if streams:
            rooms.send(np.array(streams, dtype=np.int64), np.array(actions, dtype=np.int64))
        under_way += len(streams) - len(answers.streams)
    for stream, episode in episodes.items():
        _check(episode, again[stream])


def _take(
    answers: Answers, buffer: EpisodeBuffer, episodes: Mapping[int, Running], again: Mapping[int, Running]
) -> None:
    """Put one frame of each answering room into the buffer."""
    for row, stream in enumerate(answers.streams.tolist()):
        before, now = episodes[stream], again[stream]
        if answers.is_first[row]:
            now.seed, now.goal = answers.seeds[row], int(answers.goals[row])
            now.interaction = int(answers.interactions[row])
            buffer.begin(stream, answers.images[row], now.goal, now.interaction)
            continue
        step = len(now.actions)
        now.add(before.actions[step], before.values[step], float(answers.rewards[row]))
        buffer.append(stream, now.actions[-1], answers.rewards[row], now.values[-1], answers.images[row])
        is_last = step + 1 == len(before.actions)
        if answers.is_end[row] and not is_last:
            raise _otherwise(before.seed, f"{len(before.actions)} steps or more", f"{step + 1}")


def _check(before: Running, now: Running) -> None:
    for name in ("seed", "goal", "interaction", "episode_return"):
        expected, found = getattr(before, name), getattr(now, name)
        if expected != found:
            raise _otherwise(before.seed, f"{name} {expected}", f"{found}")


def _otherwise(seed: int, expected: str, found: str) -> CheckpointError:
    return CheckpointError(
        f"playing the episode of seed {seed} again: expected {expected}, found {found}; its room is not "
        "the one that the checkpoint was made in: resume with the versions of vhs, mujoco and numpy of then"
    )


def _running(fields: Mapping[str, Any], device: torch.device) -> Running:
    """What `Running.as_dict` gave, on the device that it came from."""
    return Running(**{**fields, "goal_embedding": fields["goal_embedding"].to(device)})


def _record(episode: EndedEpisode, buffer: EpisodeBuffer) -> dict[str, Any]:
    """A waiting episode as it was played, with what only its end told."""
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
    return {
        "played": played.as_dict(),
        "outcome": int(episode.outcome),
        "reached_object": episode.reached_object,
    }


def _finish(record: Mapping[str, Any], stream: int, played: Running, buffer: EpisodeBuffer) -> EndedEpisode:
    """End a waiting episode that has been played again."""
    outcome = Outcome(record["outcome"])
    return played.ended(buffer.finish(stream, outcome), outcome, int(record["reached_object"]))
