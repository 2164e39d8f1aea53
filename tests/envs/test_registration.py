"""How gymnasium finds the tasks, alone and in vectors."""

from __future__ import annotations

import subprocess
import sys

import gymnasium
import numpy as np
import pytest

import vhs.envs
from vhs.envs import TASKS, RoomConfig, RoomEnv, register_envs
from vhs.envs.config import OBJECT_NAV, TURN_LEFT


def run_python(code: str) -> str:
    """Run code in a fresh interpreter that turns warnings into errors."""
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False, timeout=60
    )
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    return result.stdout.strip()


@pytest.mark.parametrize("known", [task.name for task in TASKS])
def test_make_works_after_importing_the_package(known: str) -> None:
    made = f"gymnasium.make('vhs/{known}-v0', renderer='none')"
    assert run_python(f"import gymnasium, vhs.envs; print({made}.unwrapped.task.name)") == known


def test_make_works_by_module_prefix_without_an_import() -> None:
    made = "gymnasium.make('vhs.envs:vhs/ObjectNav-v0', renderer='none')"
    assert run_python(f"import gymnasium; print({made}.unwrapped.task.name)") == "ObjectNav"


def test_importing_the_package_loads_no_mujoco() -> None:
    assert run_python("import sys, vhs.envs; print('mujoco' in sys.modules)") == "False"


def test_registering_twice_changes_nothing() -> None:
    register_envs()
    assert sum(name.startswith("vhs/") for name in gymnasium.registry) == 3


def test_the_package_offers_what_it_names() -> None:
    assert all(getattr(vhs.envs, name) is not None for name in vhs.envs.__all__)
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = vhs.envs.nothing  # type: ignore[attr-defined]


@pytest.mark.usefixtures("opengl")
def test_a_vector_of_rooms_hands_out_the_final_image() -> None:
    vector = gymnasium.make_vec("vhs/ObjectNav-v0", num_envs=2, vectorization_mode="sync")
    alone = [RoomEnv(OBJECT_NAV) for _ in range(2)]
    vector.reset(seed=[4, 5])
    for env, seed in zip(alone, (4, 5), strict=True):
        env.reset(seed=seed)
    running = {0, 1}
    rng = np.random.default_rng(0)
    while running:
        actions = rng.integers(3, size=2)
        observations, _, terminated, truncated, info = vector.step(actions)
        for index in sorted(running):
            observation, _, done, late, own = alone[index].step(actions[index])
            assert np.array_equal(observations["image"][index], observation["image"])
            assert (terminated[index], truncated[index]) == (done, late)
            if done or late:
                assert info["outcome"][index] == own["outcome"]
                running.remove(index)
    vector.close()


def test_config_reaches_the_environment_through_make() -> None:
    env = gymnasium.make("vhs/ObjectNav-v0", config=RoomConfig(horizon_steps=2), renderer="none")
    env.reset(seed=0)
    assert [env.step(TURN_LEFT)[3] for _ in range(2)] == [False, True]
    env.close()
