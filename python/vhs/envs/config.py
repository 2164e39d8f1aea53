"""Every number of the room, once, with its unit and where it comes from.

Owns `RoomConfig` (the room, the robot's motion, the camera, the rewards) and `RoomTask` (what sets the
three tasks apart). Both are frozen: an environment never changes its own rules.

"paper" marks numbers given by the paper's experiments section; "chosen" marks numbers that the paper leaves
open.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

OBJECT_NAMES = ("mustard", "barbecue_sauce", "salad_dressing", "orange_juice", "milk")
"""Class label -> object (paper: five objects of the HOPE set; the order is chosen)."""

MOVE_FORWARD, TURN_LEFT, TURN_RIGHT = 0, 1, 2
FIRST_INTERACTION = 3
"""Actions from here on are interactions: action 3 is interaction 0."""

HEADINGS = 8
"""Headings the robot can hold: multiples of the 45 degree turn, so eight of them close the circle."""


@dataclass(frozen=True, slots=True)
class RoomTask:
    """What sets one task apart from the others (paper: section "Task Details")."""

    name: str
    """Name in the gymnasium id, without namespace and version."""
    title: str
    """Name in the paper."""
    interactions: int
    """Interaction actions on offer; 0 means that reaching an object ends the episode by itself."""

    @property
    def env_id(self) -> str:
        """What `gymnasium.make` takes."""
        return f"vhs/{self.name}-v0"

    @property
    def num_actions(self) -> int:
        """Three movements and the interactions."""
        return FIRST_INTERACTION + self.interactions


OBJECT_NAV = RoomTask("ObjectNav", "Task 1", interactions=0)
INTERACTIVE_OBJECT_NAV = RoomTask("InteractiveObjectNav", "Task 2", interactions=1)
MULTI_INTERACTION_OBJECT_NAV = RoomTask("MultiInteractionObjNav", "Task 3", interactions=3)
TASKS = (OBJECT_NAV, INTERACTIVE_OBJECT_NAV, MULTI_INTERACTION_OBJECT_NAV)
"""Task 1, 2 and 3 of the paper."""


@dataclass(frozen=True, slots=True)
class RoomConfig:
    """Numbers of the room; lengths in metres, angles in degrees, times in seconds, masses in kilograms."""

    # Rewards (paper: success 10, failure -1, timeout -0.1; the step penalty is added on every step).
    reward_success: float = 10.0
    """Instructed object reached, with the instructed interaction where the task has any (paper)."""
    reward_failure: float = -1.0
    """Another object reached, or another interaction used (paper)."""
    reward_timeout: float = -0.1
    """No success and no failure within the horizon (paper)."""
    reward_step: float = -0.01
    """Added to every step, the last one included (paper)."""

    # Episode.
    horizon_steps: int = 20
    """Steps until the episode is cut off (chosen)."""
    goals: Sequence[str] = OBJECT_NAMES
    """Names of the objects that instructions ask for, all unless given; the others stand in the room all the
    same. Kept as a tuple, in order of the class labels."""

    # Movement.
    stride_m: float = 0.5
    """Way of one free MoveForward (chosen)."""
    turn_deg: float = 45.0
    """Angle of one turn; must be 360 / 8 so that headings stay on the lattice (chosen)."""

    # Room and reach.
    room_side_m: float = 3.0
    """Inner side of the square room (chosen)."""
    wall_height_m: float = 1.5
    """High enough that the camera never sees over a wall (chosen)."""
    reach_m: float = 0.6
    """Planar distance from the robot's centre to an object's centre that counts as reached (chosen)."""
    reach_half_angle_deg: float = 30.0
    """Largest angle between heading and object that counts as reached, so that it is also seen (chosen)."""
    start_clearance_m: float = 0.1
    """Objects start at least this far outside the reach (chosen)."""
    separation_m: float = 0.8
    """Least distance between two objects' centres: the robot fits between any two (chosen)."""
    object_gap_m: float = 0.02
    """Least gap between an object's bounding circle and a wall, or another's circle (chosen)."""
    object_scale: float = 1.6
    """Object size relative to life: 84 pixels show little of a real 19 cm bottle at 2 m (chosen)."""

    # First-person camera.
    image_px: int = 84
    """Height and width of an observation (paper)."""
    camera_height_m: float = 0.6
    """Height over the floor (chosen)."""
    camera_forward_m: float = 0.04
    """Offset in front of the robot's centre; from here the robot is outside of its own view (chosen)."""
    camera_pitch_deg: float = 25.0
    """Downward pitch (chosen)."""
    camera_vfov_deg: float = 75.0
    """Vertical field of view (chosen)."""

    # Physics.
    physics_dt_s: float = 0.02
    """One `mj_step` (chosen: 2 ms steps cost ten times more and gained nothing)."""
    control_dt_s: float = 0.3
    """One action: 15 physics steps (chosen)."""
    bumper_radius_m: float = 0.25
    """Radius of the base's collision cylinder, a little less than a Fetch base has (chosen)."""
    bumper_clearance_m: float = 0.001
    """A blocked stride ends this far before contact, so that nothing ever has to be pushed apart (chosen)."""
    base_mass_kg: float = 40.0
    """Base and head without the arm (chosen: light for a Fetch, which has no 0.3 s strides)."""
    servo_rate_per_s: float = 50.0
    """Natural frequency of the base servos; stiffness is inertia times its square, about 1e5 N/m (chosen)."""

    def __post_init__(self) -> None:
        """Refuse numbers that cannot make a room, and goals that are not in it."""
        object.__setattr__(self, "goals", _in_order(self.goals))
        self._check_signs()
        self._check_geometry()
        self.physics_steps_per_action  # noqa: B018  raises when the two time steps do not fit

    def _check_signs(self) -> None:
        """Everything but the rewards is a positive, finite number; rewards are finite; counts are whole."""
        for field in fields(self):
            if field.name == "goals":
                continue
            value = getattr(self, field.name)
            expected = "an int" if field.type == "int" else "a number"
            if isinstance(value, bool) or not isinstance(
                value, int if expected == "an int" else (int, float)
            ):
                raise TypeError(f"{field.name}: expected {expected}, found {value!r}")
            if not math.isfinite(value):
                raise ValueError(f"{field.name}: expected a finite number, found {value}")
            if not field.name.startswith("reward_") and value <= 0:
                raise ValueError(f"{field.name}: expected a positive number, found {value}")

    def _check_geometry(self) -> None:
        """Turns close the circle, angles fit a camera, and the start leaves the robot room to stand."""
        if abs(self.turn_deg * HEADINGS - 360.0) > 1e-9:
            raise ValueError(f"turn_deg: expected 360 / {HEADINGS} = 45 degrees, found {self.turn_deg}")
        if self.reach_half_angle_deg > 180.0:
            raise ValueError(
                f"reach_half_angle_deg: expected at most 180 degrees, found {self.reach_half_angle_deg}"
            )
        if self.camera_vfov_deg >= 180.0:
            raise ValueError(f"camera_vfov_deg: expected less than 180 degrees, found {self.camera_vfov_deg}")
        if self.bumper_radius_m >= self.reach_m:
            raise ValueError(
                f"bumper_radius_m: expected less than reach_m = {self.reach_m} m (else nothing is in reach), "
                f"found {self.bumper_radius_m} m"
            )
        free_half_side_m = self.room_side_m / 2 - self.reach_m - self.start_clearance_m
        if free_half_side_m <= 0:
            raise ValueError(
                "room_side_m: expected more than twice reach_m + start_clearance_m = "
                f"{2 * (self.reach_m + self.start_clearance_m):g} m (objects start out of reach), "
                f"found {self.room_side_m} m"
            )

    @property
    def physics_steps_per_action(self) -> int:
        """Physics steps in one action; an error unless the action is an integer multiple of them."""
        ratio = self.control_dt_s / self.physics_dt_s
        steps = round(ratio)
        if steps < 1 or abs(ratio - steps) > 1e-6:
            raise ValueError(
                f"control_dt_s: expected an integer multiple of physics_dt_s = {self.physics_dt_s} s, "
                f"found {self.control_dt_s} s (ratio {ratio:g})"
            )
        return steps

    @property
    def half_side_m(self) -> float:
        """Distance from the room's centre to each wall."""
        return self.room_side_m / 2

    @property
    def goal_labels(self) -> tuple[int, ...]:
        """Class labels of `goals`."""
        return tuple(map(OBJECT_NAMES.index, self.goals))


def _in_order(goals: object) -> tuple[str, ...]:
    """Names of objects in order of their labels; an error unless they are that, each once, one at least."""
    if isinstance(goals, str) or not isinstance(goals, Sequence):
        raise TypeError(f"goals: expected a list of names, found {goals!r}")
    given = list(goals)
    if not given or any(name not in OBJECT_NAMES or given.count(name) > 1 for name in given):
        raise ValueError(f"goals: expected some of {', '.join(OBJECT_NAMES)}, each once, found {given}")
    return tuple(name for name in OBJECT_NAMES if name in given)
