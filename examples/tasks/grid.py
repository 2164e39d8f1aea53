"""The smallest task: four coloured squares on a grid, seen from above; go to the one told, and pick it.

vhs train --task examples/tasks/grid.py --config examples/tasks/grid.yaml --out runs/grid
"""

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict, Discrete

import vhs

COLOURS = np.array([(255, 40, 40), (40, 220, 40), (60, 90, 255), (250, 220, 30)], np.uint8)


class Grid(gymnasium.Env):
    observation_space = Dict(image=Box(0, 255, (36, 36, 3), np.uint8), goal=Discrete(4))
    action_space = Discrete(5)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.me, *self.squares = np.argwhere(np.ones((5, 5)))[self.np_random.permutation(25)[:5]]
        self.goal = self.np_random.integers(4)
        return self.seen(), {}

    def seen(self):
        world = np.pad(np.zeros((5, 5, 3), np.uint8), ((4, 4), (4, 4), (0, 0)), constant_values=60)
        world[tuple(4 + np.transpose(self.squares))] = COLOURS
        view = world[self.me[0] : self.me[0] + 9, self.me[1] : self.me[1] + 9]  # the agent is in its middle
        return {"image": view.repeat(4, 0).repeat(4, 1), "goal": self.goal}

    def step(self, action):
        if action < 4:
            self.me = np.clip(self.me + [(-1, 0), (1, 0), (0, -1), (0, 1)][action], 0, 4)
        on = [label for label, place in enumerate(self.squares) if action == 4 and (place == self.me).all()]
        reward = 10.0 if on == [self.goal] else -1.0 if on else -0.01
        return self.seen(), reward, bool(on), False, {"reached": on[0] if on else -1}


task = vhs.Task(make=Grid, max_steps=20, interactions={4: 0}, reached=lambda info: info["reached"])
