"""Crafter, a small Minecraft seen from above: fetch what is told, wood or water, and not the other.

vhs train --task examples/tasks/crafter_fetch.py --config examples/tasks/crafter_fetch.yaml --out runs/crafter
"""

from copy import deepcopy

import crafter
import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict, Discrete

import vhs

GOALS = ("collect_wood", "collect_drink")
BEGUN = {}  # number -> one of 64 worlds, which take a quarter of a second each


class Crafter(gymnasium.Env):
    observation_space = Dict(image=Box(0, 255, (54, 54, 3), np.uint8), goal=Discrete(len(GOALS)))
    action_space = Discrete(5)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.goal, number, fate = self.np_random.integers((len(GOALS), 64, 2**31))
        if number not in BEGUN:
            BEGUN[number] = crafter.Env((32, 32), size=(54, 54), seed=int(number))
            BEGUN[number].reset()
        self.world = deepcopy(BEGUN[number])
        self.world._world.random.seed(fate)
        return {"image": self.world.render(), "goal": self.goal}, {}

    def step(self, action):
        image, _, is_over, info = self.world.step(1 + action)
        fetched = [name for name in GOALS if info["achievements"][name]]
        reward = 10.0 if GOALS[self.goal] in fetched else -1.0 if fetched else -0.01
        return {"image": image, "goal": self.goal}, reward, is_over or bool(fetched), False, {}


task = vhs.Task(make=Crafter, max_steps=50, goals=GOALS, actions=("left", "right", "up", "down", "do"))
