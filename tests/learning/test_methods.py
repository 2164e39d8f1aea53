"""The table of methods, what a new row takes, and the combinations that the configuration refuses."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from torch import Tensor
from toy import toy_learner

from vhs import Outcome
from vhs.config import Config, dump_config, known_keys, load_config
from vhs.config.schema import Of
from vhs.errors import ConfigError
from vhs.learning.methods import METHODS, Method
from vhs.learning.terms import TERMS, Forward, Term

from .parts import goals_for, make_batch


def test_every_term_of_a_method_and_of_a_key_is_known() -> None:
    assert {term for method in METHODS.values() for term in method.terms} == set(TERMS)
    named = {
        part
        for section in (Config.model_fields["method"], Config.model_fields["train"])
        for field in section.annotation.model_fields.values()
        for of in field.metadata
        if isinstance(of, Of)
        for part in of.parts
    }
    assert named == {*TERMS, "prototype"}


def test_every_weight_is_a_key_that_its_term_reads() -> None:
    keys = set(known_keys())
    for name, term in TERMS.items():
        if isinstance(term.weight, str):
            assert term.weight in keys
            section, _, leaf = term.weight.partition(".")
            marks = Config.model_fields[section].annotation.model_fields[leaf].metadata
            assert any(isinstance(of, Of) and name in of.parts for of in marks)


def test_a_sixth_method_is_one_row_and_one_function(monkeypatch: pytest.MonkeyPatch) -> None:
    def calm(x: Forward) -> Tensor:
        """Values near 0."""
        assert x.lived is not None
        return (x.lived.values.square() * x.lived.valid).sum() / x.steps

    monkeypatch.setitem(TERMS, "calm", Term(calm, "lived", weight=0.1))
    monkeypatch.setitem(METHODS, "calm-pg", Method((*METHODS["pg"].terms, "calm")))
    # The overlay of PG comes before, the new name over it.
    learner = toy_learner("pg", "method.name=calm-pg")
    batch = make_batch([Outcome.SUCCESS, Outcome.FAILURE])
    goals = goals_for(batch, 16)
    found = learner.update(batch, goals)
    assert set(found) == {"policy", "value", "entropy", "calm", "grad_norm"}
    plain = toy_learner("pg").update(batch, goals)
    assert {name: found[name] for name in ("policy", "value")} == {
        name: plain[name] for name in ("policy", "value")
    }
    assert found["grad_norm"] != plain["grad_norm"], "the term is learned from"


def test_the_configuration_needs_no_torch() -> None:
    code = "import sys, vhs.config; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(
    ("assignments", "message"),
    [
        (["method.name=a3c", "method.supcon_weight=0.5"], "supcon_weight: expected none .* a3c.* no supcon"),
        (
            ["method.name=gdan", "method.supcon_temperature=0.1"],
            "supcon_temperature: .* no supcon, found 0.1",
        ),
        (
            ["method.discriminator_weight=1"],
            "expected none for method.name = vhs, which has no discriminator",
        ),
        (["method.name=pg", "method.relabel_on=[timeout]"], "relabel_on: .* no imitation_policy and no imit"),
        (["method.name=pg", "method.embedding=word", "method.prototype=exact"], "prototype: .* no prototype"),
        (["method.name=gcsl", "method.value_target=behaviour"], "value_target: .* no imitation_value"),
        (
            ["method.name=gcsl", "method.hindsight_discount=0.7"],
            "expected 1.0 for method.name = gcsl, found 0.7",
        ),
        (["method.name=gcsl", "train.entropy_weight_end=0.1"], "train.entropy_weight_end: .* no entropy"),
    ],
)
def test_a_key_that_does_nothing_is_refused_and_named(assignments: list[str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_config([], assignments)


def test_every_key_that_does_nothing_is_named_at_once() -> None:
    with pytest.raises(ConfigError) as caught:
        load_config([], ["method.name=a3c", "method.warmup=5", "method.vhs_weight=1"])
    assert [line.partition(":")[0] for line in str(caught.value).splitlines()] == [
        "method.warmup",
        "method.vhs_weight",
    ]


def test_a_file_that_names_no_method_speaks_to_all(tmp_path: Path) -> None:
    shared, own = tmp_path / "shared.yaml", tmp_path / "own.yaml"
    shared.write_text("method: {supcon_weight: 0.25, hindsight_discount: 0.5, goal_capacity: 300}")
    found = {name: load_config([shared], [f"method.name={name}"]).method for name in METHODS}
    assert [found[name].supcon_weight for name in ("vhs", "pg", "gcsl")] == [0.25] * 3
    assert [found[name].hindsight_discount for name in ("vhs", "gcsl")] == [0.5, 1.0]
    assert {section.goal_capacity for section in found.values()} == {300}
    assert found["a3c"] == load_config([], ["method.name=a3c", "method.goal_capacity=300"]).method
    own.write_text("method: {name: a3c, supcon_weight: 0.25}")
    with pytest.raises(ConfigError, match=r"supcon_weight: expected none for method\.name = a3c"):
        load_config([own])


@pytest.mark.parametrize("name", METHODS)
def test_a_configuration_is_saved_with_the_keys_that_are_read(name: str, tmp_path: Path) -> None:
    config, path = load_config([], [f"method.name={name}"]), tmp_path / "config.yaml"
    path.write_text(dump_config(config))
    assert load_config([path]) == config
    assert ("supcon_weight" in path.read_text()) == ("supcon" in METHODS[name].terms)


@pytest.mark.parametrize("name", METHODS)
def test_a_saved_configuration_may_hold_every_key(name: str, tmp_path: Path) -> None:
    """As earlier versions wrote them, values that did nothing included."""
    config, path = load_config([], [f"method.name={name}"]), tmp_path / "config.yaml"
    tree = config.model_dump(mode="json")
    tree["method"]["hindsight_discount"] = config.method.hindsight_discount if name == "vhs" else 0.7
    path.write_text(yaml.safe_dump(tree))
    assert load_config([path]) == config


@pytest.mark.parametrize("name", METHODS)
def test_a_name_alone_is_a_whole_configuration(name: str) -> None:
    config = load_config([], [f"method.name={name}"])
    assert config.method.embedding == ("word" if name in ("a3c", "gdan") else "prototype")
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
