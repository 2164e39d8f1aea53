"""The table of methods, and the combinations that the configuration refuses."""

from typing import get_args

import pytest

from vhs.config import dump_config, load_config
from vhs.errors import ConfigError
from vhs.learning.methods import METHODS, MethodName


def test_every_name_has_its_parts() -> None:
    assert set(METHODS) == set(get_args(MethodName))


@pytest.mark.parametrize("name", METHODS)
def test_a_name_alone_is_a_whole_configuration(name: str) -> None:
    config = load_config([], [f"method.name={name}"])
    assert config.method.embedding == METHODS[name].embedding
    assert f"embedding: {config.method.embedding}" in dump_config(config)


def test_a_method_has_its_own_learning_rate_unless_one_is_given() -> None:
    assert load_config([], ["method.name=gdan"]).train.learning_rate == 3e-4
    assert load_config([], ["method.name=gdan", "train.gamma=0.9"]).train.learning_rate == 3e-4
    assert load_config([], ["train.learning_rate=5e-4", "method.name=gdan"]).train.learning_rate == 5e-4
    assert load_config([], ["method.name=pg"]).train.learning_rate == load_config().train.learning_rate


@pytest.mark.parametrize(
    ("assignments", "message"),
    [
        (
            ["method.name=a3c", "method.embedding=prototype"],
            "method.embedding: expected word for method.name = a3c, found prototype",
        ),
        (
            ["method.name=gdan", "method.embedding=prototype"],
            "method.embedding: expected word for method.name = gdan, found prototype",
        ),
        (
            ["method.name=gcsl", "method.embedding=word"],
            "method.embedding: expected prototype for method.name = gcsl, found word",
        ),
        (
            ["method.embedding=word", "method.relabel_probability=0.4"],
            "method.relabel_probability: expected 0 with method.embedding = word, which has no word for what "
            "was reached by mistake, found 0.4",
        ),
        (
            ["method.name=gcsl", "method.relabel_probability=0"],
            "method.relabel_probability: expected above 0 for method.name = gcsl, which learns from "
            "relabelled episodes alone, found 0.0",
        ),
        (
            ["method.name=gcsl", "method.relabel_on=[]"],
            "method.relabel_on: expected an outcome for method.name = gcsl, which learns from relabelled "
            "episodes alone, found none",
        ),
        (
            ["method.name=gcsl", "method.vhs_weight=0"],
            "method.vhs_weight: expected above 0 for method.name = gcsl, which learns from relabelled "
            "episodes alone, found 0.0",
        ),
    ],
)
def test_parts_that_do_not_fit_are_refused(assignments: list[str], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config([], assignments)
    assert str(caught.value) == message


@pytest.mark.parametrize(
    "assignments",
    [
        ["method.name=pg", "method.embedding=word"],
        ["method.embedding=word", "method.relabel_probability=0"],
        ["method.relabel_on=[success, failure]"],
    ],
)
def test_ablations_are_allowed(assignments: list[str]) -> None:
    load_config([], assignments)
