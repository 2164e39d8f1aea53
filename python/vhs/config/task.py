"""The key `task` of a configuration: the name of a room, where a `Task` of one's own is, or its words.

A task of one's own is the object called ``task`` in a Python file, ``mine.py``, or one of another name,
``mine.py:name`` or ``package.module:name``. An environment whose parts go by other names than ours needs no
Python: a section of the configuration says the words (`TaskSection`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Discriminator, Field, Tag
from pydantic_core import PydanticCustomError

from vhs.errors import VhsError
from vhs.rules import Rule

ROOM_NAMES = ("task1", "task2", "task3")
TAGS = ("<name>", "<section>")
"""Of the two kinds of values, where pydantic names the place of an error."""
_FILE = re.compile(r"(?P<path>.+\.py)(:(?P<name>\w+))?")
_MODULE = re.compile(r"(?P<module>\w+(\.\w+)*):(?P<name>[\w.-]+)")
GIVEN = "given:"
"""Begins the name of a task that was given from Python: only who has it can find it."""


def _is_rule(text: str) -> str:
    try:
        Rule(text)
    except VhsError as error:
        raise ValueError(str(error)) from None
    return text


class _Words(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class RewardWords(_Words):
    """`vhs.OutcomeReward`."""

    success: float = 10.0
    failure: float = -1.0
    timeout: float = -0.1
    step: float = -0.01


class MotionWords(_Words):
    """`vhs.Move`, or `vhs.Turn` where `deg` is given."""

    forward_m: float = 0.0
    left_m: float = 0.0
    deg: float | None = None


Action = Annotated[int, Field(ge=0)]


class TaskSection(_Words):
    """A `vhs.Task` in words; what is not said here is as there."""

    make: Annotated[str, Field(min_length=1)]
    """``EnvId``, or ``module:EnvId`` where importing the module registers it."""
    name: str = ""
    max_steps: Annotated[int, Field(ge=1)] | None = None
    max_steps_keyword: Annotated[str, Field(min_length=1)] | None = None
    image: str | None = None
    """Entry of the observation that is the picture; null: by the observation space."""
    goal: str | None = None
    """Entry that is the class of the goal, or its picture."""
    interaction: str | None = None
    beside: tuple[str, ...] = ()
    """Further entries of the observation, arrays or numbers that the agent knows beside the picture."""
    outcome: dict[Literal["success", "failure", "timeout"], Annotated[str, AfterValidator(_is_rule)]] = Field(
        default_factory=dict
    )
    """Conditions over reward, terminated, truncated and the entries of info at the end of an episode. The
    first that holds names its outcome; where none does, it is a failure if terminated, else a timeout."""
    reward: RewardWords | None = None
    interactions: dict[Action, Action] = Field(default_factory=dict)
    goals: tuple[str, ...] | None = None
    moves: dict[Action, MotionWords] | None = None
    touched: Annotated[str, AfterValidator(_is_rule)] | None = None
    """Condition over the entries of info of any step: whether it reached something, right or wrong."""
    replayable: bool = True
    limit_ends: bool = False
    actions: tuple[str, ...] = ()
    keys: dict[str, Action] = Field(default_factory=dict)
    reached: str | None = None
    """Entry of info that is the class that was reached, -1 for none."""
    metrics: tuple[str, ...] = ()


def _place(name: str) -> str:
    if name not in ROOM_NAMES and not _FILE.fullmatch(name) and not _MODULE.fullmatch(name):
        rooms = ", ".join(f"'{room}'" for room in ROOM_NAMES)
        raise PydanticCustomError(
            "literal_error", f"Input should be {rooms}, a file such as mine.py, or package.module:name"
        )
    return name


TaskKey = Annotated[
    Annotated[str, AfterValidator(_place), Tag(TAGS[0])] | Annotated[TaskSection, Tag(TAGS[1])],
    Discriminator(lambda value: TAGS[int(isinstance(value, Mapping | TaskSection))]),
]
"""What the key `task` of a configuration holds."""


def task_name(task: str | TaskSection) -> str:
    """What a task is called in file names and tables, as far as its place says it."""
    if isinstance(task, TaskSection):
        return re.sub(r"\W+", "-", task.name or task.make.rpartition(":")[2].rpartition("/")[2])
    if found := _FILE.fullmatch(task):
        return found["name"] or Path(found["path"]).stem
    return task.rpartition(":")[2]


def file_of(task: Any) -> tuple[Path, str] | None:
    """The file of a task and the name in it; None for a task of another kind."""
    found = _FILE.fullmatch(task) if isinstance(task, str) else None
    return None if found is None else (Path(found["path"]), found["name"] or "task")


def placed(tree: Mapping[str, Any], directory: Path) -> dict[str, Any]:
    """A configuration whose task, where it is a file, is one below `directory`, whoever reads it where."""
    return {key: placed_task(value, directory) if key == "task" else value for key, value in tree.items()}


def placed_task(task: Any, directory: Path) -> Any:
    """The key `task` itself, as `placed` has it."""
    return str((directory / task).absolute()) if file_of(task) else task
