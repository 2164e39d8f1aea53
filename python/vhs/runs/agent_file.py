"""The file of an exported agent: ``agent.safetensors``.

``agent.*`` holds network weights and batch-norm statistics, in float16 where they are floating point: acting
needs no more. A tensor that float16 cannot hold (above 65,504) stays float32. ``prototypes.*`` holds the
state of `vhs.Prototypes`, the table in float32. The metadata says what trained the agent; a SHA-256 over both
tells a damaged file. A stranger may have made the file, and the configuration beside it: both are read
bounded, and checked against each other before anything of the size that they name is made.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from vhs.config import Config
from vhs.config.variants import flat_config
from vhs.errors import CheckpointError, ConfigError
from vhs.learning.goals import Goals
from vhs.models import ExtractorFactory, GoalAgent, make_agent
from vhs.reading import read_bounded
from vhs.runs.checkpoint import fitting
from vhs.task import TaskSpec

FORMAT = "vhs-agent-1"
_AGENT = "agent."
_PROTOTYPES = "prototypes."
_RNG = _PROTOTYPES + "rng"
_DIGEST = "sha256"
CONFIG_DIGEST = "config_sha256"
"""Of the metadata: the digest of the configuration beside the file; vhs up to 0.1.0 wrote none."""
MOST_BYTES = 2**30
"""Of the file of an agent."""
_MOST_HEADER_BYTES = 10_000_000
_LIMITS = {
    "env.num_envs": 4_096,
    "env.room.image_px": 1_024,
    "env.room.horizon_steps": 100_000,
    "model.frame_stack": 64,
    "method.goal_capacity": 10_000_000,
    "train.threads": 1_024,
}
"""What takes memory, time or threads when an agent acts, and is in no shape of a weight."""


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


@dataclass(frozen=True, slots=True)
class AgentFile:
    """What an exported agent holds, whole and unchanged since it was written, but maybe by a stranger."""

    path: Path
    about: Mapping[str, str]
    """What `encode_agent` was told."""
    trained_episodes: int
    tensors: Mapping[str, Tensor]
    """All of them finite."""

    def check(self, config: Config, spec: TaskSpec, extractor: ExtractorFactory | None = None) -> None:
        """Check a configuration and its task against the file before anything of their size is made.

        `extractor` as for `make_agent`.

        Raises:
            CheckpointError: the networks that they describe are not those of the file.
        """
        on_meta = config.model_copy(update={"train": config.train.model_copy(update={"device": "meta"})})
        try:
            with torch.device("meta"):  # shapes alone, no memory
                networks = make_agent(on_meta, spec, extractor).state_dict()
        except ConfigError as error:
            raise CheckpointError(
                f"{self.path}: no network is like the configuration beside it: {error}"
            ) from error
        found = {name: tensor for name, tensor in self.tensors.items() if name.startswith(_AGENT)}
        _check(self.path, found, {_AGENT + name: tensor for name, tensor in networks.items()})

    def check_beside(self, config: bytes) -> None:
        """Check that the file of the configuration is the one that was exported with the agent.

        Raises:
            CheckpointError: it has changed since.
        """
        if self.about.get(CONFIG_DIGEST, found := hashlib.sha256(config).hexdigest()) != found:
            raise CheckpointError(
                f"{self.path}: the configuration beside it is another file than the one that was exported"
            )

    def load(self, agent: GoalAgent, goals: Goals) -> None:
        """Put the content into networks and goals.

        Raises:
            CheckpointError: it does not fit; nothing has changed.
        """
        _check(self.path, self.tensors, _tensors(agent, goals))
        with fitting(self.path):
            goals.load_state_dict(self.prototypes)
            agent.load_state_dict(self.networks)

    @property
    def networks(self) -> dict[str, Tensor]:
        """Weights and batch-norm statistics, by their names in `GoalAgent`."""
        return _below(_AGENT, self.tensors)

    @property
    def prototypes(self) -> dict[str, Tensor]:
        """The state of `vhs.Prototypes`; KeyError of a file without it."""
        return _below(_PROTOTYPES, {**self.tensors, _RNG: self.tensors[_RNG].view(torch.uint64)})


def read_agent(path: Path) -> AgentFile:
    """Read the file of an exported agent; nothing in it is executed.

    Raises:
        CheckpointError: the file is missing, no regular file, too large, damaged or of another kind, or holds
            numbers that are not finite.
    """
    try:
        content = read_bounded(path, MOST_BYTES)
        about, tensors = _header(content).get("__metadata__", {}), load(content)
    except (OSError, SafetensorError, ValueError, RecursionError) as error:
        raise CheckpointError(f"{path}: damaged agent: {error}") from error
    if about.get("format") != FORMAT:
        found = about.get("format", "none")
        raise CheckpointError(f"{path}: expected an exported agent of format {FORMAT}, found {found}")
    if about.pop(_DIGEST, None) != _digest(tensors, about):
        raise CheckpointError(f"{path}: damaged agent: its checksum is another one than that of its content")
    for name, tensor in tensors.items():
        if tensor.is_floating_point() and not torch.isfinite(tensor).all():
            raise CheckpointError(f"{path}: expected finite numbers as `{name}`, found some that are not")
    episodes = about.get("trained_episodes", "0")
    if not re.fullmatch("[0-9]{1,15}", episodes):
        raise CheckpointError(f"{path}: expected a number as trained_episodes, found {episodes[:40]!r}")
    return AgentFile(path, about, int(episodes), tensors)


def check_limits(config: Config) -> None:
    """Check that the configuration of an exported agent asks for no more than an agent may need.

    Raises:
        CheckpointError: it does.
    """
    flat = flat_config(config)
    for key, most in _LIMITS.items():
        value = flat.get(key)
        if isinstance(value, int | float) and value > most:
            raise CheckpointError(f"{key}: expected at most {most:,} in an exported agent, found {value:,}")


def _header(content: bytes) -> dict[str, Any]:
    """The JSON that a safetensors file begins with."""
    size = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + min(size, _MOST_HEADER_BYTES)])
    if not isinstance(header, dict) or not isinstance(header.get("__metadata__", {}), dict):
        raise ValueError("expected a JSON object as header")
    return header


def _tensors(agent: GoalAgent, goals: Goals) -> dict[str, Tensor]:
    """Everything that acting reads, under its name in the file."""
    networks = {_AGENT + name: value for name, value in agent.state_dict().items()}
    named = {_PROTOTYPES + name: value for name, value in goals.state_dict().items()}
    # Generator state is unsigned words, which torch knows little of.
    named[_RNG] = named[_RNG].view(torch.int64)
    return networks | named


def _below(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}


def _check(path: Path, tensors: Mapping[str, Tensor], expected: Mapping[str, Tensor]) -> None:
    for name in sorted(expected.keys() | tensors.keys()):
        wanted = list(expected[name].shape) if name in expected else "none"
        found = list(tensors[name].shape) if name in tensors else "none"
        if wanted == found:
            kind, given = expected[name].dtype, tensors[name].dtype
            if given == kind or (kind.is_floating_point and given == torch.float16):
                continue
            wanted, found = f"{wanted} of {kind}", f"{found} of {given}"
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
