from __future__ import annotations

from collections.abc import Callable
from itertools import product

import gymnasium
import numpy as np
import pytest

from vhs.envs import RoomEnv, RoomTask, optimal_steps, plan
from vhs.envs.config import INTERACTIVE_OBJECT_NAV, OBJECT_NAV, TURN_LEFT
from vhs.envs.kinematics import Pose
from vhs.envs.oracle import NoPlanError
from vhs.envs.scene import ObjectPose

Arrange = Callable[..., None]
EPISODES = 1000


@pytest.mark.slow
def test_the_oracle_solves_every_episode_and_replans_to_the_same_end(task: RoomTask) -> None:
    env = RoomEnv(task, renderer="none")
    lengths = []
    for seed in range(EPISODES):
        env.reset(seed=seed)
        best = optimal_steps(env)
        info: dict[str, object] = {}
        while not info:
            *_, info = env.step(plan(env)[0])
        assert info["outcome"] == "success", f"seed {seed}"
        assert env.steps == best, f"seed {seed}"
        lengths.append(best)
    steps = f"mean {np.mean(lengths):.2f}, max {max(lengths)} steps"
    print(f"oracle, {task.name}: {EPISODES} of {EPISODES}, {steps}")
    assert max(lengths) <= env.config.horizon_steps


def test_every_object_of_a_room_can_be_the_goal() -> None:
    env = RoomEnv(OBJECT_NAV, renderer="none")
    for seed, goal in product(range(200), range(5)):
        env.reset(seed=seed, options={"goal": goal})
        assert 1 <= optimal_steps(env) <= env.config.horizon_steps


def test_no_shorter_sequence_succeeds() -> None:
    env = RoomEnv(INTERACTIVE_OBJECT_NAV, renderer="none")
    checked = 0
    for seed in range(40):
        env.reset(seed=seed)
        best = optimal_steps(env)
        if best > 5:
            continue
        checked += 1
        poses, start = env.world.object_poses, env.world.start_pose
        for actions in product(range(4), repeat=best - 1):
            env.arrange(start, poses)
            info: dict[str, object] = {}
            for action in actions:
                *_, info = env.step(action)
                if info:
                    break
            assert info.get("outcome") != "success", f"seed {seed}: {actions} beats the oracle's {best} steps"
    assert checked >= 10


def test_the_optimum_does_not_depend_on_what_was_done() -> None:
    env = RoomEnv(INTERACTIVE_OBJECT_NAV, renderer="none")
    env.reset(seed=3)
    best = optimal_steps(env)
    env.step(TURN_LEFT)
    assert optimal_steps(env) == best
    assert len(plan(env)) in (best - 1, best, best + 1)


def test_in_task_1_a_plan_goes_round_other_objects(arrange: Arrange) -> None:
    env = RoomEnv(OBJECT_NAV, renderer="none")
    env.reset(seed=0, options={"goal": 1})
    arrange(
        env,
        Pose(-1.0, 0.0, 0),
        {0: ObjectPose(0.0, 0.0, 0.0, False), 1: ObjectPose(1.0, 0.0, 0.0, False)},
    )
    info: dict[str, object] = {}
    for action in plan(env):
        assert not info
        *_, info = env.step(action)
    assert info["outcome"] == "success"


def test_a_goal_that_cannot_be_reached_is_named(arrange: Arrange) -> None:
    env = RoomEnv(INTERACTIVE_OBJECT_NAV, renderer="none")
    env.reset(seed=0, options={"goal": 2})
    arrange(env, Pose(0.0, 0.0, 0))
    with pytest.raises(NoPlanError, match="expected a plan to object 2 within 20 steps"):
        plan(env)


def test_the_oracle_wants_a_room_that_has_been_reset() -> None:
    with pytest.raises(gymnasium.error.ResetNeeded, match="has been reset"):
        plan(RoomEnv(OBJECT_NAV, renderer="none"))
    with pytest.raises(TypeError, match="env: expected a RoomEnv, wrapped or not, found CartPoleEnv"):
        plan(gymnasium.make("CartPole-v1"))


def test_the_oracle_sees_through_wrappers() -> None:
    env = gymnasium.make("vhs/InteractiveObjectNav-v0", renderer="none")
    env.reset(seed=0)
    assert len(plan(env)) == optimal_steps(env)
