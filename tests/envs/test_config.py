from __future__ import annotations

import dataclasses
import math

import pytest

from vhs.envs import OBJECT_NAMES, TASKS, RoomConfig


def test_defaults_are_those_of_the_paper_and_the_design() -> None:
    config = RoomConfig()
    assert (config.reward_success, config.reward_failure, config.reward_timeout, config.reward_step) == (
        10.0,
        -1.0,
        -0.1,
        -0.01,
    )
    assert config.horizon_steps == 20
    assert config.image_px == 84
    assert config.physics_steps_per_action == 15


def test_tasks_offer_three_movements_and_their_interactions() -> None:
    assert [(task.name, task.num_actions) for task in TASKS] == [
        ("ObjectNav", 3),
        ("InteractiveObjectNav", 4),
        ("MultiInteractionObjNav", 6),
    ]


def test_labels_are_in_the_order_of_the_paper() -> None:
    assert OBJECT_NAMES == ("mustard", "barbecue_sauce", "salad_dressing", "orange_juice", "milk")


def test_config_is_frozen() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        RoomConfig().stride_m = 1.0  # type: ignore[misc]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"stride_m": 0.0}, r"stride_m: expected a positive number, found 0\.0"),
        ({"stride_m": -1.0}, r"stride_m: expected a positive number, found -1\.0"),
        ({"reach_m": math.nan}, r"reach_m: expected a finite number, found nan"),
        ({"reward_success": math.inf}, r"reward_success: expected a finite number, found inf"),
        ({"horizon_steps": 0}, r"horizon_steps: expected a positive number, found 0"),
        ({"turn_deg": 30.0}, r"turn_deg: expected 360 / 8 = 45 degrees, found 30\.0"),
        (
            {"reach_half_angle_deg": 181.0},
            r"reach_half_angle_deg: expected at most 180 degrees, found 181\.0",
        ),
        ({"camera_vfov_deg": 180.0}, r"camera_vfov_deg: expected less than 180 degrees, found 180\.0"),
        ({"bumper_radius_m": 0.7}, r"bumper_radius_m: expected less than reach_m = 0\.6 m"),
        (
            {"room_side_m": 1.2},
            r"room_side_m: expected more than twice reach_m \+ start_clearance_m = 1\.4 m",
        ),
        ({"control_dt_s": 0.31}, r"control_dt_s: expected an integer multiple of physics_dt_s = 0\.02 s"),
        ({"control_dt_s": 0.01}, r"control_dt_s: expected an integer multiple of physics_dt_s = 0\.02 s"),
    ],
)
def test_impossible_numbers_are_refused(change: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(RoomConfig(), **change)


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("stride_m", "1e-1", "a number, found '1e-1'"),
        ("stride_m", None, "a number, found None"),
        ("reach_m", True, "a number, found True"),
        ("horizon_steps", True, "an int, found True"),
    ],
)
def test_what_is_no_number_is_refused_by_name(name: str, value: object, expected: str) -> None:
    with pytest.raises(TypeError, match=f"^{name}: expected {expected}$"):
        RoomConfig(**{name: value})  # type: ignore[arg-type]


def test_counts_must_be_integers() -> None:
    with pytest.raises(TypeError, match=r"horizon_steps: expected an int, found 20\.5"):
        RoomConfig(horizon_steps=20.5)  # type: ignore[arg-type]


@pytest.mark.parametrize("goals", [["milk", "mustard"], ("mustard", "milk")])
def test_goals_are_names_in_order_of_the_labels(goals: list[str]) -> None:
    config = RoomConfig(goals=goals)
    assert (config.goals, config.goal_labels) == (("mustard", "milk"), (0, 4))
    assert config == RoomConfig(goals=("mustard", "milk"))


@pytest.mark.parametrize("goals", [[], ["tea"], ["milk", "milk"], [4]])
def test_goals_that_are_not_in_the_room_are_refused(goals: list[str]) -> None:
    with pytest.raises(ValueError, match=r"^goals: expected some of mustard, .* milk, each once, found \["):
        RoomConfig(goals=goals)


@pytest.mark.parametrize("goals", ["milk", 4, None])
def test_goals_are_a_list(goals: object) -> None:
    with pytest.raises(TypeError, match=r"^goals: expected a list of names, found "):
        RoomConfig(goals=goals)  # type: ignore[arg-type]
