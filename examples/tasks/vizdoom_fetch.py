"""ViZDoom: four things lie in the room of its scenario "basic"; fetch the one told, and no other.

vhs train --task examples/tasks/vizdoom_fetch.py --config examples/tasks/vizdoom_fetch.yaml --out runs/vizdoom
"""

import gymnasium
from gymnasium.spaces import Discrete

import vhs

THINGS = {"RadSuit": "-310 -80", "BlueArmor": "-310 144", "Soulsphere": "-70 -80", "BlueSkull": "-70 144"}
KWARGS = {"available_buttons": ["TURN_LEFT_RIGHT_DELTA", "MOVE_FORWARD"], "objects_info_enabled": True}
KWARGS |= {"game_args": "-nomonsters +sv_cheats 1", "render_hud": False, "render_weapon": False}
MOVES = {0: vhs.Turn(deg=32), 1: vhs.Turn(deg=-32), 2: vhs.Move(forward_m=1.3)}


class Fetch(gymnasium.Wrapper):
    def __init__(self, **kwargs):
        super().__init__(gymnasium.make("vizdoom.gymnasium_wrapper:VizdoomBasic-v1", **kwargs))
        self.action_space = Discrete(len(MOVES))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed, options=options)
        self.goal, angle = self.np_random.integers((len(THINGS), 360))
        for thing, place in THINGS.items():  # it lies a step before the place, in whatever direction
            self.unwrapped.game.send_game_command(f"warp {place}; summon {thing}; warp -190 32")
            self.unwrapped.game.make_action([angle, 0])
        return self.step(0)[0], {}

    def step(self, action):
        before = self.unwrapped.state
        self.unwrapped.game.make_action([(-4, 0), (4, 0), (0, 1)][action], 8)  # degrees a tic, walking
        after = self.unwrapped.state = self.unwrapped.game.get_state()
        taken = {thing.name for thing in before.objects} - {thing.name for thing in after.objects}
        reward = 10.0 if list(THINGS)[self.goal] in taken else -1.0 if taken else -0.01
        image = (before if taken else after).screen_buffer[::4, ::4]  # what was taken is no longer in view
        return vhs.Seen(image, self.goal), reward, bool(taken), False, {}


task = vhs.Task(make=Fetch, kwargs=KWARGS, read=lambda it: it, max_steps=30, goals=(*THINGS,), moves=MOVES)
