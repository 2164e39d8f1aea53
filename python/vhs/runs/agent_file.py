"""The file of an exported agent: ``agent.safetensors``.

``agent.*`` holds network weights and batch-norm statistics, in float16 where they are floating point: acting
needs no more. A tensor that float16 cannot hold (above 65,504) stays float32. ``prototypes.*`` holds the
state of `vhs.Prototypes`, the table in float32. The metadata says what trained the agent; a SHA-256 over both
tells a damaged file.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from vhs.errors import CheckpointError
from vhs.learning.algorithms import VHS
from vhs.runs.checkpoint import fitting

FORMAT = "vhs-agent-1"
_AGENT = "agent."
_PROTOTYPES = "prototypes."
_DIGEST = "sha256"


def encode_agent(learner: VHS, metadata: Mapping[str, str]) -> bytes:
    """The bytes of the file for the networks and prototypes of a learner."""
    tensors = {
        name: _halved(value) if name.startswith(_AGENT) else value
        for name, value in _tensors(learner).items()
    }
    # A command may name a path that is not UTF-8, which the file has to be.
    described = {key: value.encode(errors="replace").decode() for key, value in metadata.items()}
    described["format"] = FORMAT
    return save(tensors, {**described, _DIGEST: _digest(tensors, described)})


def read_agent(path: Path, learner: VHS) -> dict[str, str]:
    """Load networks and prototypes into a learner of the same configuration.

    Returns:
        The metadata that `encode_agent` was given.

    Raises:
        CheckpointError: the file is missing, damaged, of another kind, or does not fit the learner, which is
            then as it was.
    """
    try:
        with safe_open(path, framework="pt") as file:
            metadata = dict(file.metadata() or {})
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (no mapping)
    except (OSError, SafetensorError) as error:
        raise CheckpointError(f"{path}: damaged agent: {error}") from error
    if metadata.get("format") != FORMAT:
        found = metadata.get("format", "none")
        raise CheckpointError(f"{path}: expected an exported agent of format {FORMAT}, found {found}")
    if metadata.pop(_DIGEST, None) != _digest(tensors, metadata):
        raise CheckpointError(f"{path}: damaged agent: its checksum is another one than that of its content")
    _check(path, tensors, _tensors(learner))
    with fitting(path):
        _load(tensors, learner)
    return metadata


def _tensors(learner: VHS) -> dict[str, Tensor]:
    """Everything that acting reads, under its name in the file."""
    networks, prototypes = learner.agent.state_dict(), learner.prototypes.state_dict()
    return {_AGENT + name: value for name, value in networks.items()} | {
        _PROTOTYPES + "table": torch.from_numpy(prototypes["table"]),
        _PROTOTYPES + "seen": torch.from_numpy(prototypes["seen"]),
        # Generator state is unsigned words, which torch knows little of.
        _PROTOTYPES + "rng": torch.from_numpy(prototypes["rng"].view(np.int64)),
    }


def _load(tensors: Mapping[str, Tensor], learner: VHS) -> None:
    table, seen, rng = (tensors[_PROTOTYPES + name].numpy() for name in ("table", "seen", "rng"))
    learner.prototypes.load_state_dict({"table": table, "seen": seen, "rng": rng.view(np.uint64)})
    networks = {name: tensor for name, tensor in tensors.items() if name.startswith(_AGENT)}
    learner.agent.load_state_dict({name.removeprefix(_AGENT): tensor for name, tensor in networks.items()})


def _check(path: Path, tensors: Mapping[str, Tensor], expected: Mapping[str, Tensor]) -> None:
    for name in sorted(expected.keys() | tensors.keys()):
        wanted = list(expected[name].shape) if name in expected else "none"
        found = list(tensors[name].shape) if name in tensors else "none"
        if wanted != found:
            raise CheckpointError(
                f"{path}: does not fit the configuration beside it: `{name}`: expected shape {wanted}, "
                f"found {found}"
            )


def _halved(tensor: Tensor) -> Tensor:
    """As float16 where that can hold it."""
    tensor = tensor.detach().cpu().contiguous()
    if not tensor.is_floating_point():
        return tensor
    half = tensor.half()
    return half if torch.isfinite(half).all() else tensor


def _digest(tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> str:
    digest = hashlib.sha256(json.dumps(sorted(metadata.items())).encode())
    for name in sorted(tensors):
        tensor = tensors[name]
        digest.update(f"{name} {tensor.dtype} {list(tensor.shape)}".encode())
        digest.update(tensor.numpy().tobytes())
    return digest.hexdigest()
