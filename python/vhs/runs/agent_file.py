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

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from vhs.errors import CheckpointError
from vhs.learning.goals import Goals
from vhs.models import GoalAgent
from vhs.runs.checkpoint import fitting

FORMAT = "vhs-agent-1"
_AGENT = "agent."
_PROTOTYPES = "prototypes."
_RNG = _PROTOTYPES + "rng"
_DIGEST = "sha256"


def encode_agent(agent: GoalAgent, goals: Goals, metadata: Mapping[str, str]) -> bytes:
    """The bytes of the file for networks and the goals that they are told."""
    tensors = {
        name: _halved(value) if name.startswith(_AGENT) else value
        for name, value in _tensors(agent, goals).items()
    }
    # A command may name a path that is not UTF-8, which the file has to be.
    described = {key: value.encode(errors="replace").decode() for key, value in metadata.items()}
    described["format"] = FORMAT
    return save(tensors, {**described, _DIGEST: _digest(tensors, described)})


def read_agent(path: Path, agent: GoalAgent, goals: Goals) -> dict[str, str]:
    """Load networks and goals into those of the same configuration.

    Returns:
        The metadata that `encode_agent` was given.

    Raises:
        CheckpointError: the file is missing, damaged, of another kind, or does not fit, and then nothing
            has changed.
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
    _check(path, tensors, _tensors(agent, goals))
    with fitting(path):
        _load(tensors, agent, goals)
    return metadata


def _tensors(agent: GoalAgent, goals: Goals) -> dict[str, Tensor]:
    """Everything that acting reads, under its name in the file."""
    networks = {_AGENT + name: value for name, value in agent.state_dict().items()}
    named = {_PROTOTYPES + name: value for name, value in goals.state_dict().items()}
    # Generator state is unsigned words, which torch knows little of.
    named[_RNG] = named[_RNG].view(torch.int64)
    return networks | named


def _load(tensors: Mapping[str, Tensor], agent: GoalAgent, goals: Goals) -> None:
    named = _below(_PROTOTYPES, {**tensors, _RNG: tensors[_RNG].view(torch.uint64)})
    goals.load_state_dict(named)
    agent.load_state_dict(_below(_AGENT, tensors))


def _below(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}


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
