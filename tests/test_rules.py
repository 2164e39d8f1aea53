"""Rules that a configuration says in words: what they mean, what they refuse; nothing of them is run."""

import pickle

import pytest

from vhs import ArgumentError
from vhs.rules import Rule

NAMED = {"reward": 1.5, "terminated": True, "truncated": False, "info": {"distance": 0.2, "is_success": True}}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("reward > 0", True),
        ("reward > 0 and not terminated", False),
        ("is_success", True),
        ("info['distance'] < 0.1", False),
        ("0 < distance <= 0.2", True),
        ("'distance' in info", True),
        ("'lost' in info or reward == 1.5", True),
        ("reward - 1 > distance + 0.2", True),
        ("-reward < -1", True),
        ("terminated != truncated", True),
    ],
)
def test_a_rule_means_what_python_would(text: str, expected: bool) -> None:
    rule = pickle.loads(pickle.dumps(Rule(text)))
    assert rule.holds(NAMED, NAMED["info"]) is expected


def test_a_name_that_an_environment_also_uses_means_the_step() -> None:
    assert Rule("reward > 1").holds(NAMED, {"reward": -1.0})


@pytest.mark.parametrize(
    "text",
    [
        "print('run')",
        "().__class__",
        "[reward]",
        "lambda: 1",
        "reward if terminated else 0",
        "reward ** 9 ** 9",
        "reward := 1",
        "",
        "reward >",
        "reward > 0; 1",
        "(" * 150 + ")" * 150,
        "reward " * 100,
    ],
)
def test_anything_else_is_refused_when_it_is_read(text: str) -> None:
    with pytest.raises(ArgumentError, match="expected"):
        Rule(text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lost > 0", "'lost > 0': expected one of reward, .*is_success, found 'lost'"),
        ("info['lost']", "found 'lost'"),
        ("info > 0", "expected values that compare"),
    ],
)
def test_what_is_not_there_is_named(text: str, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        Rule(text).holds(NAMED, NAMED["info"])
