"""Which device computes, with and without a GPU in sight."""

import numpy as np
import pytest
import torch

from vhs.models import pick_device, to_device


@pytest.mark.parametrize(("has_gpu", "expected"), [(True, "cuda"), (False, "cpu")])
def test_auto_takes_the_gpu_where_there_is_one(
    monkeypatch: pytest.MonkeyPatch, has_gpu: bool, expected: str
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: has_gpu)
    assert pick_device("auto").type == expected


def test_a_named_device_is_taken_at_its_word() -> None:
    assert pick_device("cuda:1") == torch.device("cuda", 1)


def test_a_device_that_torch_does_not_know_is_refused() -> None:
    with pytest.raises(RuntimeError, match="tpu9000"):
        pick_device("tpu9000")


def test_an_array_reaches_the_cpu_without_a_copy() -> None:
    array = np.arange(3)
    tensor = to_device(array, torch.device("cpu"))
    array[0] = 7
    assert tensor.tolist() == [7, 1, 2]


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_an_array_reaches_the_gpu() -> None:
    assert to_device(np.arange(3), torch.device("cuda")).cpu().tolist() == [0, 1, 2]
