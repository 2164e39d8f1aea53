"""Scalars as YAML 1.2 reads them, and files that are small on the disk and large in memory."""

import os
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from vhs.config import load_config
from vhs.config.yaml12 import dump_yaml, parse_yaml
from vhs.errors import ConfigError
from vhs.sweep.file import read_sweep


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("007", 7),
        ("08", 8),
        ("010", 10),
        ("0o10", 8),
        ("0x1f", 31),
        ("-3", -3),
        ("1e4", 1e4),
        ("1E-4", 1e-4),
        (".5", 0.5),
        ("5.", 5.0),
        ("-.inf", float("-inf")),
        ("1:30", "1:30"),
        ("1_000", "1_000"),
        ("0b11", "0b11"),
        ("yes", "yes"),
        ("off", "off"),
        ("2024-01-01", "2024-01-01"),
        ("true", True),
        ("~", None),
        ("", None),
        ("'08'", "08"),
    ],
)
def test_a_scalar_is_what_version_1_2_says(text: str, value: Any) -> None:
    found = parse_yaml(f"a: {text}")["a"]
    assert (found, type(found)) == (value, type(value))


def test_zero_padded_seeds_are_the_numbers_that_a_person_reads() -> None:
    assert [load_config([], [f"seed={text}"]).seed for text in ("007", "08", "010", "012")] == [7, 8, 10, 12]


@pytest.mark.parametrize("text", ["true", "1:30", "0b11"])
def test_what_is_no_number_is_no_seed(text: str) -> None:
    with pytest.raises(ConfigError, match=rf"^seed: expected (a number|integer), found '?{text}'?$"):
        load_config([], [f"seed={text}"])


@pytest.mark.parametrize(
    ("assignment", "where"),
    [
        ("train.gamma=true", "train.gamma"),
        ("model.channels=[8, 8, true, 8]", "model.channels.2"),
        ("train.keep_checkpoints=false", "train.keep_checkpoints"),
    ],
)
def test_true_and_false_are_no_numbers_anywhere(assignment: str, where: str) -> None:
    with pytest.raises(ConfigError, match=rf"^{where}: expected"):
        load_config([], [assignment])


def test_true_is_no_seed_of_a_sweep(tmp_path: Path) -> None:
    (tmp_path / "sweep.yaml").write_text("seeds: [0, true]\ngrids: [{}]\n")
    with pytest.raises(ConfigError, match=r"sweep\.yaml: seeds\.1: expected a number, found true"):
        read_sweep(tmp_path / "sweep.yaml")


def test_a_power_of_ten_is_a_number_of_episodes(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text("train: {episodes: 1e4, learning_rate: 1e-4}\n")
    train = load_config([tmp_path / "c.yaml"], ["train.log_every=1e2"]).train
    assert (train.episodes, train.log_every, train.learning_rate) == (10_000, 100, 1e-4)


plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(plain | st.sampled_from(["1e4", "08", "0o7", "true", "null", "~", "1:30", "<<", "=", "yes", ".inf"]))
def test_what_is_dumped_is_read_back(value: Any) -> None:
    for on_one_line in (False, True):
        assert parse_yaml(dump_yaml({"a": value}, on_one_line=on_one_line)) == {"a": value}


BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [{','.join([f'*{chr(97 + i)}'] * 9)}]\n" for i in range(9)
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BOMB, "more than 100,000 values, aliases written out"),
        ("a: &a [*a]", "an alias of something that it is in"),
        ("a: &a {b: *a}", "an alias of something that it is in"),
        ("a: " + "[" * 5_000, "too many to follow"),
        ("a: " + "9" * 5_000, "integer string conversion"),
        ("a: !!timestamp 2024-99-99", "month must be in"),
        ("a: !!python/object/apply:os.system [true]", "could not determine a constructor"),
        ("? {a: b}\n: c", "unhashable key"),
    ],
)
def test_a_text_that_would_hang_or_execute_is_refused_at_once(text: str, message: str) -> None:
    began = time.monotonic()
    with pytest.raises(yaml.YAMLError, match=message):
        parse_yaml(text)
    assert time.monotonic() - began < 20


def test_a_long_wrong_value_is_shown_in_a_line(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(f"train: {{episodes: {list(range(5_000))}, gamma: {'g' * 5_000}}}")
    with pytest.raises(ConfigError) as caught:
        load_config([tmp_path / "c.yaml"])
    assert len(str(caught.value)) < 500


def test_a_file_that_is_too_large_is_refused_unread(tmp_path: Path) -> None:
    with (tmp_path / "c.yaml").open("wb") as file:
        file.truncate(10**10)
    with pytest.raises(ConfigError, match=r"expected at most 200,000 bytes, found 10,000,000,000"):
        load_config([tmp_path / "c.yaml"])


@pytest.mark.skipif(sys.platform == "win32", reason="no named pipes")
def test_a_pipe_is_read_where_the_user_named_it_and_refused_elsewhere(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ConfigError, match="expected a regular file, found a pipe"):
        load_config([tmp_path / "pipe"], may_be_pipe=False)
    writer = threading.Thread(target=lambda: (tmp_path / "pipe").write_text("seed: 7"))
    writer.start()
    assert load_config([tmp_path / "pipe"]).seed == 7
    writer.join()
