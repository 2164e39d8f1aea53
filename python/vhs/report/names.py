"""How the page writes what runs are called."""

from __future__ import annotations

from vhs.runs.reader import Group


def group_title(group: Group) -> str:
    """``VHS, relabel_on=timeout (copy)``: the method as the paper writes it, and what sets it apart."""
    label = group.label
    method = label.method if group.task is None else label.method.upper()
    copy = f" ({label.copy})" if label.copy else ""
    return ", ".join([method, *label.changes]) + copy


def task_title(task: str | None) -> str:
    """``Task 2`` for ``task2``; other tasks by their own name."""
    if task is None:
        return "unknown task"
    number = task.removeprefix("task")
    return f"Task {number}" if number.isdecimal() else task
