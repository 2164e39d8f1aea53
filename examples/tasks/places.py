"""Goals that are pictures: a map of coloured cells seen through a window; go to where the picture was taken.

vhs train --task examples/tasks/places.py --config examples/tasks/places.yaml --out runs/places
"""

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict, Discrete

import vhs

PLACES, WINDOW = 4, 5
MAP = np.random.default_rng(0).choice(np.array([40, 220], np.uint8), (PLACES + WINDOW - 1,) * 2 + (3,))
PICTURE = Box(0, 255, (4 * WINDOW, 4 * WINDOW, 3), np.uint8)


class Places(gymnasium.Env):
    observation_space = Dict(image=PICTURE, goal=PICTURE)
    action_space = Discrete(4)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.me, self.there = self.np_random.integers(0, PLACES, (2, 2))
        return self.seen(), {}

    def picture(self, place):
        row, column = place
        return MAP[row : row + WINDOW, column : column + WINDOW].repeat(4, 0).repeat(4, 1)

    def seen(self):
        return {"image": self.picture(self.me), "goal": self.picture(self.there)}

    def step(self, action):
        self.me = np.clip(self.me + [(-1, 0), (1, 0), (0, -1), (0, 1)][action], 0, PLACES - 1)
        is_there = bool((self.me == self.there).all())
        return self.seen(), 10.0 if is_there else -0.01, is_there, False, {}


task = vhs.Task(make=Places, max_steps=8, actions=("up", "down", "left", "right"))
