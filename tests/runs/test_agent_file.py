"""An exported agent from a stranger: executes nothing, hangs nothing, fills no memory, ends in a sentence."""

import json
import os
import resource
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch
from debug import debug_config
from safetensors.torch import save

from vhs import VhsError
from vhs.acting.policy import load_agent, make_policy
from vhs.cli import main
from vhs.config import dump_config
from vhs.errors import CheckpointError
from vhs.runs import agent_file
from vhs.runs.agent_file import encode_agent

linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="pipes and limits of Linux")

BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [{','.join([f'*{chr(97 + i)}'] * 9)}]\n" for i in range(9)
)


@pytest.fixture(scope="module")
def shipped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("shipped") / "agent"
    directory.mkdir()
    policy = make_policy(debug_config("env.num_workers=0"))
    content = encode_agent(policy.agent, policy.goals, {"trained_episodes": "7"})
    (directory / "agent.safetensors").write_bytes(content)
    (directory / "config.yaml").write_text(dump_config(policy.config))
    (directory / "run.json").write_text("{}")
    return directory


@pytest.fixture
def agent(shipped: Path, tmp_path: Path) -> Path:
    return shutil.copytree(shipped, tmp_path / "agent")


@pytest.fixture
def little_memory() -> Iterator[None]:
    """4 GB more than now: a hang or a fill becomes a failure instead of a dead machine."""
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (now + 4 * 2**30, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


def test_a_whole_one_is_loaded(agent: Path) -> None:
    assert load_agent(agent).trained_episodes == 7


def by_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def by_endless_device(path: Path) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


def by_hole(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(2**40)


def by_nothing(path: Path) -> None:
    path.write_bytes(b"")


def by_header_without_end(path: Path) -> None:
    path.write_bytes((2**63).to_bytes(8, "little") + b"{")


def by_deep_header(path: Path) -> None:
    header = b'{"__metadata__": ' + b"[" * 100_000
    path.write_bytes(len(header).to_bytes(8, "little") + header)


@pytest.mark.slow
@linux
@pytest.mark.usefixtures("little_memory")
@pytest.mark.parametrize("name", ["agent.safetensors", "config.yaml"])
@pytest.mark.parametrize(
    "replace", [by_pipe, by_endless_device, by_hole, by_nothing, by_header_without_end, by_deep_header]
)
def test_a_file_of_another_kind_is_refused_in_moments(
    replace: Callable[[Path], None], name: str, agent: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    replace(agent / name)
    for command in (["eval"], ["play", "--out", str(agent.parent / "film.gif")]):
        began = time.monotonic()
        assert main([*command, str(agent), "--episodes", "1"]) == 1
        assert time.monotonic() - began < 30
        told = capsys.readouterr().err
        assert told.startswith("vhs: ")
        assert len(told) < 1_000


@linux
@pytest.mark.usefixtures("little_memory")
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("hidden_dim: 32", "hidden_dim: 1000000000"),
        ("hidden_dim: 32", f"hidden_dim: {10**30}"),
        ("head_dim: 16", "head_dim: 200000000000"),
        ("feature_dim: 32", "feature_dim: 2000000000"),
        ("interaction_dim: 16", "interaction_dim: 9000000000"),
        ("frame_stack: 2", "frame_stack: 1000000"),
        ("num_envs: 4", "num_envs: 100000000"),
        ("room: {}", "room: {image_px: 200000}"),
        ("room: {}", "room: {horizon_steps: 100000000000}"),
        ("room: {}", "room: {image_px: [84]}"),
        ("goal_capacity: 20", "goal_capacity: 1000000000000000"),
        ("threads: 1", "threads: 1000000000"),
        ("episodes: 240", "episodes:\n    " + BOMB.replace("\n", "\n    ").rstrip()),
        ("task: task2", "task: [task2]"),
        ("task: task2", "task: !!python/object/apply:os.system [touch executed]"),
        ("seed: 0", "seed: true"),
    ],
)
def test_a_configuration_that_asks_for_the_impossible_is_refused_in_moments(
    old: str, new: str, agent: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (agent / "config.yaml").read_text()
    assert old in text
    (agent / "config.yaml").write_text(text.replace(old, new))
    began = time.monotonic()
    assert main(["eval", str(agent), "--episodes", "1"]) == 1
    assert time.monotonic() - began < 30
    told = capsys.readouterr().err
    assert told.startswith("vhs: ")
    assert len(told) < 1_000
    assert "frame #" not in told
    assert not Path("executed").exists()


def remade(path: Path, about: dict[str, str], **changed: torch.Tensor) -> None:
    """Write a file whose checksum is right, as whoever means harm does."""
    tensors = dict(agent_file.read_agent(path).tensors) | changed
    about = {"trained_episodes": "7", **about, "format": agent_file.FORMAT}
    digest = agent_file._digest(tensors, about)
    path.write_bytes(save(tensors, {**about, "sha256": digest}))


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
@pytest.mark.parametrize("name", ["agent.lstm.weight_hh_l0", "prototypes.table"])
def test_numbers_that_are_not_finite_are_refused(value: float, name: str, agent: Path) -> None:
    path = agent / "agent.safetensors"
    tensor = agent_file.read_agent(path).tensors[name].clone()
    tensor.view(-1)[3] = value
    remade(path, {}, **{name: tensor})
    with pytest.raises(CheckpointError, match=f"expected finite numbers as `{name}`"):
        load_agent(agent)


@pytest.mark.parametrize(
    ("name", "dtype"),
    [
        ("agent.lstm.weight_hh_l0", torch.int8),
        ("agent.lstm.weight_hh_l0", torch.bool),
        ("agent.extractor.convolutions.1.num_batches_tracked", torch.float32),
        ("prototypes.seen", torch.float16),
        ("prototypes.rng", torch.uint8),
        ("prototypes.table", torch.float64),
    ],
)
def test_a_tensor_of_another_type_is_refused(name: str, dtype: torch.dtype, agent: Path) -> None:
    path = agent / "agent.safetensors"
    remade(path, {}, **{name: agent_file.read_agent(path).tensors[name].to(dtype)})
    with pytest.raises(CheckpointError, match=rf"`{name}`: expected shape .*, found \[.*\] of {dtype}"):
        load_agent(agent)


@pytest.mark.parametrize("episodes", ["", "-1", "many", "9" * 5_000, "1e9", "٣"])
def test_episodes_that_are_no_number_are_refused(episodes: str, agent: Path) -> None:
    remade(agent / "agent.safetensors", {"trained_episodes": episodes})
    with pytest.raises(CheckpointError, match="expected a number as trained_episodes, found"):
        load_agent(agent)


@pytest.mark.parametrize("about", [3, [], {"format": 3}, {"format": None}])
def test_a_header_of_wrong_types_is_refused(about: object, agent: Path) -> None:
    path = agent / "agent.safetensors"
    content = path.read_bytes()
    size = int.from_bytes(content[:8], "little")
    header = json.dumps(json.loads(content[8 : 8 + size]) | {"__metadata__": about}).encode()
    path.write_bytes(len(header).to_bytes(8, "little") + header + content[8 + size :])
    with pytest.raises(CheckpointError, match=r"agent\.safetensors: "):
        load_agent(agent)


def test_every_flipped_byte_is_refused_or_changes_nothing(agent: Path) -> None:
    path, expected = agent / "agent.safetensors", load_agent(agent).agent.state_dict()
    content, generator = path.read_bytes(), torch.Generator().manual_seed(0)
    refused = 0
    for position in torch.randint(len(content), (30,), generator=generator).tolist():
        flipped = bytearray(content)
        flipped[position] ^= 1 << position % 8
        path.write_bytes(flipped)
        try:
            found = load_agent(agent).agent.state_dict()
        except VhsError:
            refused += 1
        else:
            assert all(torch.equal(found[name], tensor) for name, tensor in expected.items()), position
    assert refused > 25
