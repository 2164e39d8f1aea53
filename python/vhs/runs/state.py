"""A state as two files: `state.safetensors` has the tensors, `state.json` the plain values around them.

Nothing in either is executed when it is read. In the JSON a mapping is ``{"map": [[key, value], ...]}``,
whose keys may be whole numbers, and a tensor is ``{"tensor": NAME, "order": AXES}``: its name in the other
file, and its axes from the one with the widest stride in memory to that with the narrowest. Layout is part of
a state: a fused optimiser walks weights and moments side by side, so moments in another order are those of
others.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor


def encode_state(state: Mapping[str, Any]) -> tuple[bytes, bytes]:
    """The bytes of `state.json` and of `state.safetensors`.

    Args:
        state: mappings with texts or whole numbers as keys, lists, tuples (which come back as lists),
            tensors, numbers, texts, truths and None.

    Raises:
        TypeError: something else is in it; its place is named.
    """
    tensors: dict[str, Tensor] = {}
    tree = _plain(state, "", tensors)
    return json.dumps(tree).encode(), save(tensors)


def decode_state(tree: bytes, tensors: bytes) -> Any:
    """What `encode_state` was given, its tensors on the CPU.

    Raises:
        ValueError: the bytes are no state.
    """
    try:
        return _whole(json.loads(tree), load(tensors))
    except (SafetensorError, LookupError, TypeError, RuntimeError) as error:
        raise ValueError(f"expected a state, found {error!r}") from error


def _plain(value: Any, where: str, tensors: dict[str, Tensor]) -> Any:
    if isinstance(value, Tensor):
        name = where if where not in tensors else f"{where}#{len(tensors)}"
        # A copy: safetensors wants memory in one piece that no other tensor shares.
        tensors[name] = value.detach().cpu().clone(memory_format=torch.contiguous_format)
        strides = value.stride()
        order = sorted(range(value.dim()), key=lambda axis: -strides[axis])
        return {"tensor": name, "order": order}
    if isinstance(value, Mapping):
        if not all(type(key) in (str, int) for key in value):
            raise TypeError(f"state: expected texts or whole numbers as keys of {where or 'the whole'}")
        parts = ((key, f"{where}.{key}" if where else str(key), inner) for key, inner in value.items())
        return {"map": [[key, _plain(inner, place, tensors)] for key, place, inner in parts]}
    if isinstance(value, list | tuple):
        return [_plain(inner, f"{where}.{index}", tensors) for index, inner in enumerate(value)]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"state: expected a tensor or a plain value at {where}, found {type(value).__name__}")


def _whole(tree: Any, tensors: Mapping[str, Tensor]) -> Any:
    if isinstance(tree, list):
        return [_whole(inner, tensors) for inner in tree]
    if isinstance(tree, dict):
        if "tensor" in tree:
            order = tree["order"]
            back = sorted(range(len(order)), key=order.__getitem__)
            return tensors[tree["tensor"]].permute(order).contiguous().permute(back)
        return {key: _whole(inner, tensors) for key, inner in tree["map"]}
    return tree
