"""MiniWorld-Sign: six things in a U-shaped maze, seen by who walks in it; go to the one told, touch no other.

vhs train --task examples/tasks/miniworld_sign.py --config examples/tasks/miniworld_sign.yaml --out runs/sign
"""

import gymnasium
import numpy as np
import pyglet
from gymnasium.spaces import Dict, Discrete

import vhs

pyglet.options["headless"] = True  # no window; to be said before miniworld is imported
ACTIONS = ("turn left", "turn right", "forward")
GOALS = tuple(f"{colour} {kind}" for kind in ("box", "key") for colour in ("blue", "red", "green"))
KWARGS = {"obs_width": 64, "obs_height": 48, "view": "top"}  # what films show beside is seen from above


class Asked(gymnasium.Wrapper):
    """The level asks for one thing for ever; here each episode asks for another."""

    def __init__(self, **kwargs):
        super().__init__(gymnasium.make("miniworld:MiniWorld-Sign-v0", **kwargs))
        self.observation_space = Dict(image=self.env.observation_space["obs"], goal=Discrete(len(GOALS)))
        self.action_space = Discrete(len(ACTIONS))  # without the action that gives up

    def reset(self, *, seed=None, options=None):
        self.goal = int(np.random.default_rng(seed).integers(len(GOALS)))
        self.unwrapped._goal, self.unwrapped._color_index = divmod(self.goal, 3)
        observation, info = super().reset(seed=seed, options=options)
        return {"image": observation["obs"], "goal": self.goal}, info

    def step(self, action):
        observation, *rest = super().step(action)
        return {"image": observation["obs"], "goal": self.goal}, *rest


task = vhs.Task(
    make=Asked, kwargs=KWARGS, reward=vhs.OutcomeReward(), max_steps=20, goals=GOALS, actions=ACTIONS
)
