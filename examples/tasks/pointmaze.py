"""PointMaze, seen from above: two real numbers push a ball through the maze to where a picture shows it.

vhs train --task examples/tasks/pointmaze.py --config examples/tasks/pointmaze.yaml --out runs/pointmaze
"""

import gymnasium
import mujoco
from gymnasium.spaces import Box, Dict

import vhs


class Pictures(gymnasium.ObservationWrapper):
    def __init__(self, **kwargs):
        super().__init__(gymnasium.make("gymnasium_robotics:PointMaze_UMaze-v3", **kwargs))
        self.observation_space = Dict({name: Box(0, 255, (36, 36, 3), "uint8") for name in ("image", "goal")})
        self.unwrapped.point_env.frame_skip = 10  # steps of physics an action
        model = self.unwrapped.point_env.model.__copy__()
        model.site("particle_site").size, model.site("target").rgba = 0.3, 0  # a large ball, and no mark
        self.data, self.camera = mujoco.MjData(model), mujoco.MjvCamera()
        self.camera.azimuth, self.camera.elevation, self.camera.distance = 90, -90, 4
        self.renderer = vhs.RasterRenderer(model, 36, 36)

    def picture(self, place):
        self.data.qpos = place
        mujoco.mj_forward(self.data.model, self.data)
        self.renderer.update_scene(self.data, self.camera)
        return self.renderer.render()

    def reset(self, **kwargs):
        observation, info = self.env.reset(**kwargs)
        self.goal = self.picture(observation["desired_goal"])
        return self.observation(observation), info

    def observation(self, observation):
        return {"image": self.picture(observation["achieved_goal"]), "goal": self.goal}


task = vhs.Task(make=Pictures, kwargs={"continuing_task": False}, reward=vhs.OutcomeReward(), max_steps=20)
