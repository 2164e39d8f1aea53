"""Exported agents: what they keep of a run, that they act as it does, and files that cannot be loaded."""

import json
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from vhs.acting.policy import load_agent, make_policy
from vhs.cli import main
from vhs.config import Config, load_config
from vhs.errors import CheckpointError, OutputError
from vhs.runs.agent_file import FORMAT, encode_agent, read_agent
from vhs.runs.checkpoint import load_checkpoint, save_checkpoint
from vhs.train import train
from vhs.train.export import export_agent

pytestmark = pytest.mark.slow

DEBUG = Path(__file__).parents[2] / "configs" / "debug.yaml"


def configured(*overrides: str) -> Config:
    return load_config([DEBUG], ["train.episodes=24", "env.num_workers=0", *overrides])


def encoded(config: Config, **about: str) -> bytes:
    """The file of an agent before any training."""
    policy = make_policy(config)
    return encode_agent(policy.agent, policy.goals, about)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = tmp_path_factory.mktemp("run") / "run"
    train(configured(), run, StringIO())
    state, store = load_checkpoint(run)
    # So few episodes make no prototypes of their own.
    prototypes = state["learner"]["prototypes"]
    prototypes["table"][1], prototypes["seen"][1] = torch.linspace(-1, 1, 32), True
    save_checkpoint(run, 25, state, store, keep=1)
    return run


@pytest.fixture(scope="module")
def exported(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("exported") / "agent"
    export_agent(run, directory)
    return directory


def test_weights_are_halved_and_prototypes_are_not(run: Path, exported: Path) -> None:
    before, after = load_agent(run), load_agent(exported)
    weights = after.agent.state_dict()
    for name, value in before.agent.state_dict().items():
        expected = value.half().float() if value.is_floating_point() else value
        assert torch.equal(weights[name], expected), name
    tensors = load_file(exported / "agent.safetensors")
    assert tensors["agent.lstm.weight_ih_l0"].dtype == torch.float16
    assert tensors["agent.extractor.convolutions.1.running_var"].dtype == torch.float16
    assert tensors["prototypes.table"].dtype == torch.float32
    assert before.goals.prototypes.seen.any(), "something to compare"
    for name in ("table", "seen", "rng"):
        states = [trained.goals.prototypes.state_dict()[name] for trained in (before, after)]
        np.testing.assert_array_equal(*states)


def test_the_head_that_localises_travels_along(tmp_path: Path) -> None:
    config = configured("method.localisation_weight=1")
    (tmp_path / "agent").write_bytes(encoded(config))
    other = make_policy(config.model_copy(update={"seed": 1}))
    read_agent(tmp_path / "agent").load(other.agent, other.goals)
    first, second = make_policy(config).agent.sight, other.agent.sight
    assert first is not None
    assert second is not None
    for name, weight in first.state_dict().items():
        assert torch.equal(second.state_dict()[name], weight.half().float()), name
    without = make_policy(configured("method.localisation_weight=0"))
    with pytest.raises(CheckpointError, match=r"`agent\.sight\.0\.bias`: expected shape none"):
        read_agent(tmp_path / "agent").load(without.agent, without.goals)


def test_the_directory_says_what_trained_the_agent(run: Path, exported: Path) -> None:
    assert sorted(path.name for path in exported.iterdir()) == [
        "agent.safetensors",
        "config.yaml",
        "run.json",
    ]
    trained, meta = (
        json.loads((run / "run.json").read_text()),
        json.loads((exported / "run.json").read_text()),
    )
    assert meta["trained_episodes"] == 24
    assert meta["command"] == trained["command"]
    assert meta["exported"]["version"]
    metadata = read_agent(exported / "agent.safetensors").about
    assert metadata["trained_episodes"] == "24"
    assert (metadata["command"], metadata["commit"]) == (trained["command"], trained["commit"] or "")


def test_eval_takes_an_exported_agent_as_it_takes_a_run(
    run: Path, exported: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told, before = [], sorted(path.name for path in exported.iterdir())
    for path in (run, exported, exported):
        assert main(["eval", str(path), "--episodes", "12", "--seed", "3", "--json"]) == 0
        told.append(json.loads(capsys.readouterr().out))
    assert told[1] == told[2]
    assert sorted(path.name for path in exported.iterdir()) == before, "a shipped agent stays as it is"
    assert (run / "eval.json").exists()
    assert told[0].keys() == told[1].keys()
    for name in ("episodes", "seed", "trained_episodes", "optimal_steps"):
        assert told[0][name] == told[1][name], name


def test_an_exported_agent_acts_as_the_one_in_the_run(run: Path, exported: Path) -> None:
    rng, outputs = np.random.default_rng(0), []
    observations = torch.from_numpy(rng.integers(0, 256, (6, 2, 84, 84, 3), dtype=np.uint8))
    for path in (run, exported):
        policy = load_agent(path)
        agent = policy.agent.eval()
        goals = torch.stack([policy.goals.begin(label) for label in range(3)])
        with torch.inference_mode():
            features = agent.extractor(observations).unflatten(0, (3, 2))
            outputs.append(agent(features, goals, torch.zeros(3, dtype=torch.int64))[:2])
    for before, after in zip(*outputs, strict=True):
        torch.testing.assert_close(before, after, atol=2e-3, rtol=0.0)


def test_the_default_agent_fits_into_4_mb() -> None:
    config = load_config()
    assert len(encoded(config)) <= 4_000_000


def test_what_float16_cannot_hold_stays_as_it_is(run: Path, tmp_path: Path) -> None:
    policy, again = load_agent(run), load_agent(run)
    policy.agent.state_dict()["extractor.convolutions.1.running_var"][0] = 1e6
    path = tmp_path / "agent.safetensors"
    path.write_bytes(encode_agent(policy.agent, policy.goals, {}))
    read_agent(path).load(again.agent, again.goals)
    assert again.agent.state_dict()["extractor.convolutions.1.running_var"][0] == 1e6


def test_exact_prototypes_are_embedded_when_exporting(tmp_path: Path) -> None:
    run = tmp_path / "run"
    train(configured("train.episodes=4", "method.prototype=exact"), run, StringIO())
    state, store = load_checkpoint(run)
    rng = np.random.default_rng(0)
    for _ in range(6):
        store.push(rng.integers(0, 256, store.observation_shape, dtype=np.uint8), 2)
    save_checkpoint(run, 8, state, store, keep=1)
    export_agent(run, tmp_path / "agent")
    prototypes = load_agent(tmp_path / "agent").goals.prototypes
    assert prototypes.seen[2]
    assert np.linalg.norm(prototypes.table[2]) > 0.1


def test_an_agent_trained_elsewhere_acts_on_the_cpu(tmp_path: Path, run: Path) -> None:
    copy = shutil.copytree(run, tmp_path / "run")
    text = (copy / "config.yaml").read_text()
    (copy / "config.yaml").write_text(text.replace("device: auto", "device: cpu:0"))
    export_agent(copy, tmp_path / "agent")
    assert load_agent(tmp_path / "agent").config.train.device == "cpu"


def test_a_run_of_a_device_that_is_not_here_acts_on_the_cpu(tmp_path: Path, run: Path) -> None:
    copy = shutil.copytree(run, tmp_path / "run")
    text = (copy / "config.yaml").read_text()
    (copy / "config.yaml").write_text(text.replace("device: auto", "device: cuda:99"))
    loaded = load_agent(copy)
    assert loaded.config.train.device == "cpu"
    assert not loaded.agent.training


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("lambda: 0.75", "lambda: 0.74", "train.return_lambda"),
        ("renderer: raster", "renderer: mujoco", "env.renderer"),
    ],
)
def test_a_configuration_that_changed_since_the_checkpoint_is_refused(
    old: str, new: str, key: str, run: Path, tmp_path: Path
) -> None:
    copy = shutil.copytree(run, tmp_path / "run")
    text = (copy / "config.yaml").read_text()
    assert old in text
    (copy / "config.yaml").write_text(text.replace(old, new))
    with pytest.raises(
        CheckpointError, match=rf"config\.yaml: has other values of {key} than the checkpoint"
    ):
        load_agent(copy)


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def flip_the_header(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(bytes(byte ^ 0xFF for byte in content[:64]) + content[64:])


def flip_a_weight(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[-1000] ^= 0x01
    path.write_bytes(bytes(content))


def replace_by_another_kind(path: Path) -> None:
    save_file({"weight": torch.zeros(2)}, path)


def replace_by_another_network(path: Path) -> None:
    config = configured("model.head_dim=12")
    path.write_bytes(encoded(config, trained_episodes="1"))


def replace_by_a_directory(path: Path) -> None:
    path.unlink()
    path.mkdir()


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (truncate, "agent.safetensors: damaged agent: "),
        (flip_the_header, "agent.safetensors: damaged agent: "),
        (flip_a_weight, "agent.safetensors: damaged agent: its checksum"),
        (replace_by_a_directory, "agent.safetensors: damaged agent: "),
        (replace_by_another_kind, f"expected an exported agent of format {FORMAT}, found none"),
        (replace_by_another_network, r"`agent.bearing.0.bias`: expected shape \[16\], found \[12\]"),
    ],
)
def test_a_file_that_cannot_be_loaded_is_a_clear_error(
    damage: Callable[[Path], None], message: str, exported: Path, tmp_path: Path
) -> None:
    copy = shutil.copytree(exported, tmp_path / "agent")
    damage(copy / "agent.safetensors")
    with pytest.raises(CheckpointError, match=message):
        load_agent(copy)


@pytest.mark.parametrize("missing", ["agent.value.0.bias", "prototypes.seen"])
def test_a_missing_tensor_is_named(missing: str, run: Path, tmp_path: Path) -> None:
    policy, path = load_agent(run), tmp_path / "agent.safetensors"
    part, _, name = missing.partition(".")
    fewer = {"agent": policy.agent.state_dict(), "prototypes": policy.goals.state_dict()}
    del fewer[part][name]
    lacking = (SimpleNamespace(state_dict=lambda it=fewer[key]: it) for key in ("agent", "prototypes"))
    path.write_bytes(encode_agent(*lacking, {}))
    with pytest.raises(CheckpointError, match=rf"`{missing}`: expected shape \[\d+\], found none"):
        read_agent(path).load(policy.agent, policy.goals)


def test_no_run_no_directory(run: Path, exported: Path, tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"expected the directory of a run, found no config\.yaml"):
        export_agent(tmp_path, tmp_path / "agent")
    with pytest.raises(CheckpointError, match="expected the directory of a run, found an exported agent"):
        export_agent(exported, tmp_path / "agent")
    assert not list(tmp_path.iterdir())


def test_nothing_is_written_over(run: Path, exported: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    for taken, found in (
        (exported, "other files in it"),
        (run, "other files"),
        (tmp_path / "file", "a file"),
    ):
        with pytest.raises(CheckpointError, match=f"expected a new or an empty directory, found {found}"):
            export_agent(run, taken)
    with pytest.raises(OutputError, match="agent: cannot write: Not a directory"):
        export_agent(run, tmp_path / "file" / "agent")
    assert (tmp_path / "file").read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_an_exported_agent_is_no_run_to_train_on(exported: Path) -> None:
    before = (exported / "run.json").read_bytes()
    with pytest.raises(CheckpointError, match="holds an exported agent, which cannot train on"):
        train(configured(), exported, StringIO())
    assert (exported / "run.json").read_bytes() == before


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="namespaces are of Linux")
def test_an_agent_goes_into_a_mounted_volume(exported: Path, tmp_path: Path) -> None:
    code = (
        "import os, sys; from pathlib import Path; from vhs.runs.files import write_files; "
        "device = os.stat(sys.argv[1]).st_dev; assert device != os.stat(sys.argv[1] + '/..').st_dev; "
        "write_files(Path(sys.argv[1]), {'agent.safetensors': b'1', 'config.yaml': '2'}); "
        "print(sorted(os.listdir(sys.argv[1])), os.stat(sys.argv[1]).st_dev == device)"
    )
    command = shlex.join([sys.executable, "-c", code, str(tmp_path)])
    mounted = f"mount -t tmpfs tmpfs {tmp_path} && exec {command}"
    done = subprocess.run(
        ["unshare", "-rm", "sh", "-c", mounted], capture_output=True, text=True, timeout=120
    )
    if "unshare" in done.stderr or "mount" in done.stderr:
        pytest.skip("no user namespaces here")
    assert done.stdout == "['agent.safetensors', 'config.yaml'] True\n", done.stderr


def test_export_tells_where_and_how_large(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "agent").mkdir()
    assert main(["export", str(run), str(tmp_path / "agent")]) == 0
    assert "(24 episodes, 0." in capsys.readouterr().out
    assert main(["export", str(tmp_path / "nothing"), str(tmp_path / "other")]) == 1
    assert "found no config.yaml" in capsys.readouterr().err
