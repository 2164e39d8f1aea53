"""BabyAI-GoToLocal of minigrid: go to one of 18 kinds of things, told in words; the words are classes.

vhs train --task examples/tasks/babyai.py --config examples/tasks/babyai.yaml --out runs/babyai
"""

import gymnasium
import minigrid.wrappers  # minigrid registers the environments
from minigrid.core.constants import COLOR_NAMES

import vhs

GOALS = tuple(f"{colour} {kind}" for colour in COLOR_NAMES for kind in ("ball", "box", "key"))
ACTIONS = ("turn left", "turn right", "forward", "pick up", "drop", "toggle", "done")


def make(**kwargs):
    """The environment, whose observation is the agent's view as a picture, 7 x 7 cells of 4 x 4 pixels."""
    return minigrid.wrappers.RGBImgPartialObsWrapper(
        gymnasium.make("BabyAI-GoToLocal-v0", **kwargs), tile_size=4
    )


def read(observation):
    """The class of "go to the red ball" is "red ball"."""
    return vhs.Seen(observation["image"], label=GOALS.index(" ".join(observation["mission"].split()[-2:])))


task = vhs.Task(
    make=make, read=read, max_steps=64, goals=GOALS, actions=ACTIONS, keys={"Left": 0, "Right": 1, "Up": 2}
)
