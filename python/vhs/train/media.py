"""Films and pictures of a run for its loggers: an episode of the newest checkpoint, and its stored goals."""

from __future__ import annotations

from contextlib import closing
from itertools import islice
from pathlib import Path

import numpy as np

from vhs.acting.policy import Policy, load_agent
from vhs.acting.seeds import episode_seeds
from vhs.acting.setup import make_env
from vhs.models import ExtractorFactory
from vhs.play.command import FPS
from vhs.play.film import write_film
from vhs.png import as_picture, png_bytes
from vhs.runs.files import write_files, writing
from vhs.show.moments import play_moments
from vhs.show.pictures import draw
from vhs.task import Task

MEDIA_NAME = "media"
_A_CLASS = 8
"""Pictures of a goal class."""


def make_media(run: Path, task: Task | None, extractor: ExtractorFactory | None) -> dict[str, Path]:
    """Write a film of an episode, and a picture of the stored goals where there are any, into `media/`.

    Args:
        run: directory of a run with a checkpoint.
        task: as for `load_agent`.
        extractor: as for `load_agent`.

    Returns:
        The files, by what they show: ``media/episode`` (.gif) and ``media/goals`` (.png).

    Raises:
        OutputError: one cannot be written.
    """
    agent, folder = load_agent(run, task, extractor), run / MEDIA_NAME
    with writing(folder):
        folder.mkdir(exist_ok=True)
    film = folder / f"episode-{agent.trained_episodes}.gif"
    with closing(make_env(agent.task, agent.spec, rendering=True)) as env:
        seeds = islice(episode_seeds(agent.config.seed, purpose=1), 1)
        moments = play_moments(agent, env, seeds, agent.config.seed, greedy=False)
        write_film(film, ((draw(moment), moment.outcome is not None) for moment in moments), FPS)
    goals = _goals(agent)
    if goals is None:
        return {"media/episode": film}
    name = f"goals-{agent.trained_episodes}.png"
    write_files(folder, {name: goals})
    return {"media/episode": film, "media/goals": folder / name}


def _goals(agent: Policy) -> bytes | None:
    """A row of stored pictures a goal class, the newest frame of each; None where nothing is stored."""
    store, frame = agent.goals.store, agent.spec.frame_shape
    labels = np.flatnonzero(store.counts)
    if not len(labels) or len(frame) != 3:
        return None
    rows = []
    for label in labels.tolist():
        drawn = store.sample_class(label, _A_CLASS)[..., -frame[-1] :]
        rows.append(np.concatenate(list(as_picture(drawn)), axis=1))
    return png_bytes(np.ascontiguousarray(np.concatenate(rows)))
