"""The smallest task: a grid with four coloured squares, seen as a picture; go to the one told and pick it.

vhs train --task examples/tasks/grid.py --config examples/tasks/grid.yaml --out runs/grid
"""

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict, Discrete

import vhs

COLOURS = np.array([(255, 40, 40), (40, 220, 40), (60, 90, 255), (250, 220, 30)], np.uint8)


class Grid(gymnasium.Env):
    observation_space = Dict(image=Box(0, 255, (20, 20, 3), np.uint8), goal=Discrete(4))
    action_space = Discrete(5)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.me, *self.squares = np.argwhere(np.ones((5, 5)))[self.np_random.permutation(25)[:5]]
        self.goal = self.np_random.integers(4)
        return self.seen(), {}

    def seen(self):
        picture = np.zeros((5, 5, 3), np.uint8)
        picture[tuple(np.transpose(self.squares))] = COLOURS
        picture[tuple(self.me)] = 100 + picture[tuple(self.me)] // 2
        return {"image": picture.repeat(4, 0).repeat(4, 1), "goal": self.goal}

    def step(self, action):
        if action < 4:
            self.me = np.clip(self.me + [(-1, 0), (1, 0), (0, -1), (0, 1)][action], 0, 4)
        on = [label for label, place in enumerate(self.squares) if action == 4 and (place == self.me).all()]
        reward, info = 10.0 if on == [self.goal] else -0.01, {"reached": on[0] if on else -1}
        return self.seen(), reward, bool(on), False, info


task = vhs.Task(make=Grid, max_steps=20, interactions={4: 0}, reached=lambda info: info["reached"])
