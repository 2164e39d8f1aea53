"""A state comes back as it was: values, types, the order of its memory; and nothing else is read as one."""

import json
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from vhs.runs.state import decode_state, encode_state

plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text() | st.integers(), inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(st.text() | st.integers(), plain, max_size=4))
def test_plain_values_come_back(state: dict[Any, Any]) -> None:
    assert decode_state(*encode_state(state)) == state


@pytest.mark.parametrize(
    "dtype", [torch.float32, torch.bfloat16, torch.uint64, torch.int64, torch.uint8, torch.bool]
)
def test_tensors_come_back_bit_for_bit(dtype: torch.dtype) -> None:
    tensor = torch.randint(0, 2, (3, 2), generator=torch.Generator().manual_seed(0)).to(dtype)
    state = {"a": {1: tensor, "1": tensor[0], "scalar": tensor[0, 0]}, "a.1": tensor, "empty": tensor[:0]}
    found = decode_state(*encode_state(state))
    assert found["a"].keys() == state["a"].keys()
    for got, saved in ((found["a"][1], tensor), (found["a"]["1"], tensor[0]), (found["a.1"], tensor)):
        assert got.dtype == dtype
        assert torch.equal(got, saved)
    assert found["a"]["scalar"].shape == ()
    assert found["empty"].shape == (0, 2)


def test_the_order_in_memory_comes_back() -> None:
    image = torch.rand(2, 3, 5, 7).contiguous(memory_format=torch.channels_last)
    state = {"last": image, "transposed": image[0, 0].T, "plain": torch.rand(2, 3)}
    found = decode_state(*encode_state(state))
    for name, tensor in state.items():
        assert torch.equal(found[name], tensor), name
    assert found["last"].is_contiguous(memory_format=torch.channels_last)
    assert found["transposed"].T.is_contiguous()
    assert found["plain"].is_contiguous()


@pytest.mark.parametrize(
    "tree",
    [
        {"tensor": "missing", "order": []},
        {"tensor": "a", "order": [0, 0]},
        {"tensor": "a", "order": [7]},
        {"tensor": "a"},
        {"tensor": ["a"], "order": [0]},
        {"map": [[["a"], 1]]},
        {"map": 3},
        {},
    ],
)
def test_another_tree_is_no_state(tree: Any) -> None:
    _, tensors = encode_state({"a": torch.zeros(2)})
    with pytest.raises(ValueError, match=r"expected a state, found"):
        decode_state(json.dumps(tree).encode(), tensors)
    with pytest.raises(ValueError):  # noqa: PT011 (of json or of safetensors)
        decode_state(b"[" * 100_000, tensors)
    with pytest.raises(ValueError, match="expected a state"):
        decode_state(b"{}", b"\x00" * 8)
