"""BabyAI-GoToLocal of minigrid: go to one of 18 kinds of things, told in words; the words are classes.

vhs train --task examples/tasks/babyai.py --config examples/tasks/babyai.yaml --out runs/babyai
"""

from operator import itemgetter

import gymnasium
import minigrid.wrappers  # minigrid registers the environments
from minigrid.core.constants import COLOR_NAMES

import vhs

KINDS = ("ball", "box", "key")
GOALS = tuple(f"{colour} {kind}" for colour in COLOR_NAMES for kind in KINDS)
KEYS = {"Left": 0, "Right": 1, "Up": 2}


class Facing(gymnasium.Wrapper):
    """Says whether the agent stands before a thing, which is all that going to it takes."""

    def step(self, action):
        *step, info = self.env.step(action)
        thing = self.unwrapped.grid.get(*self.unwrapped.front_pos)
        return *step, info | {"faces": thing is not None and thing.type in KINDS}


def make(**kwargs):
    """The environment, whose observation is the agent's view as a picture, 7 x 7 cells of 4 x 4 pixels."""
    env = Facing(gymnasium.make("BabyAI-GoToLocal-v0", **kwargs))
    return minigrid.wrappers.RGBImgPartialObsWrapper(env, tile_size=4)


def read(observation):
    """The class of "go to the red ball" is "red ball"."""
    return vhs.Seen(observation["image"], label=GOALS.index(" ".join(observation["mission"].split()[-2:])))


task = vhs.Task(make=make, read=read, touched=itemgetter("faces"), max_steps=64, goals=GOALS, keys=KEYS)
