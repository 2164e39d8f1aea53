"""Agents go to the Hub and come back, by a stand-in; what a stranger put there ends in a sentence."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from hub_stand_in import StandIn, stand_in

from vhs.acting.policy import load_agent
from vhs.cli import main
from vhs.distribution import find_agent
from vhs.errors import CheckpointError, ConfigError, OutputError
from vhs.runs.remote import fetch_agent

pytest.importorskip("huggingface_hub", reason="needs vhs-rl[hub]")
AGENT = find_agent("task1")
FILES = ("agent.safetensors", "config.yaml", "run.json")


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[StandIn]:
    """A Hub that answers the client of this process, with a cache of its own."""
    from huggingface_hub import constants

    with stand_in() as found:
        monkeypatch.setattr(constants, "ENDPOINT", found.address)
        template = found.address + "/{repo_id}/resolve/{revision}/{filename}"
        monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", template)
        monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
        monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
        monkeypatch.setenv("HF_TOKEN", "hf_of_nobody")
        yield found


def put(hub: StandIn, **changed: bytes) -> None:
    """Have an agent of ours there, as `somebody/agent`, with some files changed."""
    files = {name: (AGENT / name).read_bytes() for name in FILES}
    hub.repositories["somebody/agent"] = {**files, **{n.replace("__", "."): c for n, c in changed.items()}}


@pytest.mark.slow
def test_what_was_pushed_is_evaluated_and_filmed(
    hub: StandIn, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["push", "task1", "somebody/reacher"]) == 0
    assert "/somebody/reacher/commit/" in capsys.readouterr().out
    pushed = hub.repositories["somebody/reacher"]
    assert set(pushed) == {*FILES, "eval.json", "film.gif", "README.md"}
    assert pushed["agent.safetensors"] == (AGENT / "agent.safetensors").read_bytes()
    card = pushed["README.md"].decode()
    assert card.startswith("---\nlibrary_name: vhs-rl\n")
    for said in (
        "95 % interval",
        "(film.gif)",
        "vhs eval hf://somebody/reacher",
        "vhs train ",
        "frame_stack: 2",
    ):
        assert said in card
    assert main(["eval", "hf://somebody/reacher", "--episodes", "2"]) == 0
    assert "success" in capsys.readouterr().out
    film = tmp_path / "film.gif"
    assert main(["play", "hf://somebody/reacher", "--episodes", "1", "--out", str(film)]) == 0
    assert film.stat().st_size


def test_what_is_cached_is_not_fetched_again(hub: StandIn) -> None:
    put(hub)
    assert load_agent("hf://somebody/agent").trained_episodes > 0
    asked = len(hub.asked)
    fetch_agent("hf://somebody/agent")
    assert not [path for path in hub.asked[asked:] if path.startswith("GET /somebody")]


def test_a_file_that_is_too_large_is_not_fetched(hub: StandIn) -> None:
    put(hub)
    hub.sizes["agent.safetensors"] = 2**40
    with pytest.raises(CheckpointError, match=r"agent.safetensors: expected at most 1,073,741,824 bytes"):
        fetch_agent("hf://somebody/agent")
    assert not [path for path in hub.asked if "/resolve/" in path]


def test_no_other_files_are_fetched(hub: StandIn) -> None:
    put(hub, evil__py=b"raise SystemExit", checkpoints__zip=b"x")
    assert {path.name for path in fetch_agent("hf://somebody/agent").iterdir()} == set(FILES)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"agent__safetensors": b"\xff" * 64}, "damaged agent"),
        ({"agent__safetensors": b""}, "damaged agent"),
        ({"config__yaml": b"task: !!python/object/apply:os.system [true]"}, "damaged configuration"),
        ({"config__yaml": b"task: evil.py"}, "expected to be told the task of an exported agent"),
    ],
)
def test_hostile_files_end_in_a_sentence(
    hub: StandIn, changed: dict[str, bytes], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    put(hub, **changed)
    assert main(["eval", "hf://somebody/agent"]) == 1
    assert said in capsys.readouterr().err


def test_what_is_no_agent_or_not_there_is_said(hub: StandIn) -> None:
    hub.repositories["somebody/else"] = {"model.bin": b"x"}
    with pytest.raises(CheckpointError, match=r"found no agent.safetensors and no config.yaml"):
        fetch_agent("hf://somebody/else")
    with pytest.raises(CheckpointError, match=r"hf://somebody/none: the Hub says: "):
        fetch_agent("hf://somebody/none")


@pytest.mark.parametrize("named", ["hf://agent", "hf://a/b/c", "hf://somebody/agent@", "hf://../agent\n"])
def test_names_that_are_none_are_refused(named: str) -> None:
    with pytest.raises(ConfigError, match="expected hf://user/name"):
        fetch_agent(named)


def test_a_hub_that_does_not_answer_is_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from huggingface_hub import constants

    from vhs.runs.remote import answering

    monkeypatch.setattr(constants, "ENDPOINT", "http://127.0.0.1:9")
    with pytest.raises(CheckpointError, match=r"hf://somebody/agent: the Hub says: "):
        fetch_agent("hf://somebody/agent")
    with pytest.raises(OutputError, match="the Hub says: ValueError"), answering("hf://a/b", OutputError):
        raise ValueError
