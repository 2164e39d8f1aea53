"""Batches as TensorDicts, laid out as TorchRL's losses want them: what follows a step stands under "next"."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict

from vhs._core import ArgumentError, EpisodeBatch, TransitionBatch, WindowBatch
from vhs.adapters.torch import tensors_of

__all__ = ["tensordict_of"]


def tensordict_of(
    batch: TransitionBatch | WindowBatch | EpisodeBatch, device: torch.device | str | None = None
) -> TensorDict:
    """A batch as a TensorDict, on the CPU in the batch's own memory.

    Its entries are "observation", "action", "label" (the class told), "desired_goal" and "achieved_goal"
    where goals are arrays, "mask" of windows and episodes (the steps to learn from), fields by their names,
    and under "next" what there is after the step: "observation", "achieved_goal", "desired_goal" and "label"
    (the same), fields of observations, "reward" float32 [..., 1], and "terminated", "truncated" and "done",
    bool [..., 1].

    Args:
        batch: Of `sample_transitions`, which becomes a TensorDict of [n]; of `sample_windows`, [n, W], where
            a window's goal stands at each step; or, with `padded=True`, of `sample_episodes` or `gather`, [B,
            T].
        device: Where it goes; None: it stays.

    Raises:
        ArgumentError: For episodes that are packed.
    """
    part = tensors_of(batch)
    if isinstance(batch, TransitionBatch):
        entries, shape = _of_transitions(part), part["rewards"].shape
    else:
        entries, shape = _of_sequences(part if isinstance(batch, WindowBatch) else _as_windows(part))
    made = TensorDict(entries, batch_size=shape)
    return made if device is None else made.to(device)


def _of_transitions(part: dict[str, Any]) -> dict[str, Any]:
    told = {"label": part["labels"]}
    if "goals" in part:
        told["desired_goal"] = part["goals"]
    before = {**part["fields"], **told, "observation": part["observations"]}
    after = {**part["next_fields"], **told, "observation": part["next_observations"]}
    if "achieved_goals" in part:
        before["achieved_goal"] = part["previous_achieved_goals"]
        after["achieved_goal"] = part["achieved_goals"]
    return before | {"action": part["actions"], "next": after | _outcomes(part)}


def _as_windows(part: dict[str, Any]) -> dict[str, Any]:
    """Whole episodes under the names that windows have."""
    lengths, rewards = part["lengths"], part["rewards"]
    if len(part["observations"]) != len(lengths):
        raise ArgumentError("`batch`: expected episodes that are padded (padded=True), got packed ones")
    is_last = torch.arange(rewards.shape[1]) == lengths[:, None] - 1
    ends = part["terminated"][:, None]
    part |= {"terminated": is_last & ends, "truncated": is_last & ~ends, "labels": part["goals"]}
    del part["goals"]
    if "desired_goals" in part:
        part["goals"] = part["desired_goals"]
    return part


def _of_sequences(part: dict[str, Any]) -> tuple[dict[str, Any], torch.Size]:
    """Entries of n sequences of W steps, whose observations are W + 1 each: seen twice, stored once."""
    shape = part["rewards"].shape
    shown = {"observation": part["observations"]}
    if "achieved_goals" in part:
        shown["achieved_goal"] = part["achieved_goals"]
    before: dict[str, Any] = {}
    for name, field in part["fields"].items():
        (shown if field.shape[1] > shape[1] else before)[name] = field
    before |= {name: entry[:, :-1] for name, entry in shown.items()}
    after = {name: entry[:, 1:] for name, entry in shown.items()}
    told = {"label": _at_each_step(part["labels"], shape)}
    if "goals" in part:
        told["desired_goal"] = _at_each_step(part["goals"], shape)
    before |= {**told, "action": part["actions"], "mask": part["mask"]}
    return before | {"next": {**after, **told, **_outcomes(part)}}, shape


def _at_each_step(entry: torch.Tensor, shape: torch.Size) -> torch.Tensor:
    return entry[:, None].expand(*shape, *entry.shape[1:])


def _outcomes(part: dict[str, Any]) -> dict[str, Any]:
    terminated, truncated = part["terminated"][..., None], part["truncated"][..., None]
    ends = {"terminated": terminated, "truncated": truncated, "done": terminated | truncated}
    return ends | {"reward": part["rewards"][..., None]}
