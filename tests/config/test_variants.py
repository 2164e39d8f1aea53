"""The names that tell runs of one method apart."""

from vhs.config import load_config
from vhs.config.variants import Label, flat_config, label


def test_a_method_with_its_own_defaults_is_called_by_its_name() -> None:
    plain, faster, pg, faster_pg = (
        flat_config(load_config([], assignments))
        for assignments in (
            ["method.name=gdan"],
            ["method.name=gdan", "train.learning_rate=5e-4"],
            ["method.name=pg"],
            ["method.name=pg", "train.learning_rate=1e-3"],
        )
    )
    variants = [plain, faster, pg, faster_pg]
    assert [str(label(variant, variants)) for variant in variants] == [
        "gdan",
        "gdan learning_rate=0.0005",
        "pg",
        "pg learning_rate=0.001",
    ]
    assert label(faster, [faster]) == Label("gdan")


def test_a_value_with_spaces_stays_one_change() -> None:
    odd, plain = ({"method.name": "vhs", "env.room": room} for room in ({"a b": 1}, {}))
    assert len(label(odd, [odd, plain]).changes) == 1
