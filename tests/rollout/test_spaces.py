"""Every space of gymnasium's travels, numbers never wrap, environments whose spaces differ are refused."""

from copy import deepcopy
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import SyncVectorEnv

from vhs import DtypeError, ShapeError
from vhs.rollout import RolloutPool, RolloutVectorEnv
from vhs.rollout.leaves import Nest, Unfit, converted

pytestmark = pytest.mark.slow


class Word(spaces.Space[str]):
    """A space of one's own."""

    def sample(self, mask: Any = None, probability: Any = None) -> str:
        return "word " * int(self.np_random.integers(1, 4))

    def contains(self, x: Any) -> bool:
        return isinstance(x, str)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Word)

    __hash__ = None  # type: ignore[assignment]


LOOSE = [
    spaces.Text(8),
    spaces.Sequence(spaces.Discrete(4)),
    spaces.Sequence(spaces.Box(0, 1, (2,)), stack=True),
    spaces.Graph(spaces.Box(0, 1, (3,)), spaces.Discrete(2)),
    spaces.OneOf([spaces.Discrete(3), spaces.Box(0, 1, (2,))]),
    Word(),
    spaces.Dict(
        {"image": spaces.Box(0, 255, (4, 4), np.uint8), "mission": spaces.Text(5), "at": spaces.Discrete(9)}
    ),
    spaces.Tuple([spaces.Discrete(4), spaces.Dict({"word": Word(), "number": spaces.Box(0, 1, ())})]),
]


class Echo(gym.Env):
    """Shows samples of its space; an episode has three steps, `info` tells the action."""

    def __init__(self, space: spaces.Space[Any], actions: spaces.Space[Any] | None = None) -> None:
        self.observation_space = deepcopy(space)  # its generator is this environment's
        self.action_space = spaces.Discrete(9) if actions is None else actions

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        if seed is not None:
            self.observation_space.seed(seed)
        self.steps = 0
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        # Not as an array: gymnasium cannot put those of several lengths together.
        info = {"action": [action], "steps": self.steps}
        return self.observation_space.sample(), 0.0, self.steps == 3, False, info


def assert_same(ours: Any, theirs: Any) -> None:
    is_number = isinstance(theirs, int | np.number | np.ndarray) and np.ndim(theirs) == 0  # the value counts
    assert type(ours) is type(theirs) or is_number
    if isinstance(theirs, dict):
        assert ours.keys() == theirs.keys()
        for key in theirs:
            assert_same(ours[key], theirs[key])
    elif isinstance(theirs, tuple | list):
        assert len(ours) == len(theirs)
        for one, other in zip(ours, theirs, strict=True):
            assert_same(one, other)
    elif isinstance(theirs, np.ndarray) and theirs.dtype == object:
        assert_same(tuple(ours), tuple(theirs))
    else:
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("space", LOOSE, ids=lambda space: type(space).__name__)
def test_every_space_is_shown_and_acted_in_as_gymnasium_does(space: spaces.Space[Any], mode: str) -> None:
    def env_fn() -> gym.Env[Any, Any]:
        return Echo(space, space)

    theirs = SyncVectorEnv([env_fn] * 3, autoreset_mode=mode)
    with RolloutVectorEnv(env_fn, 1, 3, autoreset_mode=mode) as ours:
        assert ours.observation_space == theirs.observation_space
        assert_same(ours.reset(seed=4), theirs.reset(seed=4))
        ours.action_space.seed(0)
        for _ in range(8):
            actions = ours.action_space.sample()
            step = ours.step(actions)
            expected = theirs.step(actions)
            assert_same(step[0], expected[0])
            assert_same(step[4].get("final_obs"), expected[4].get("final_obs"))
            assert_same(step[2], expected[2])
            assert step[0] in ours.observation_space
            assert_same(step[4].get("steps"), expected[4].get("steps"))
            assert_same(step[4].get("action"), expected[4].get("action"))
    theirs.close()


def test_a_masked_reset_keeps_the_loose_parts_of_the_others() -> None:
    with RolloutVectorEnv(lambda: Echo(spaces.Text(8)), 1, 3, autoreset_mode="Disabled") as env:
        before, _ = env.reset(seed=1)
        after, _ = env.reset(seed=5, options={"reset_mask": np.array([False, True, False])})
        assert (after[0], after[2]) == (before[0], before[2])
        assert after[1] != before[1]


def test_a_first_reset_may_be_masked() -> None:
    with RolloutVectorEnv(lambda: Echo(spaces.Box(1, 2, (2,))), 1, 2, autoreset_mode="Disabled") as env:
        shown, _ = env.reset(seed=1, options={"reset_mask": np.array([False, True])})
        assert (shown[0] == 0).all()
        assert (shown[1] >= 1).all()


def test_loose_actions_that_are_too_few_are_refused_and_nothing_is_sent() -> None:
    with RolloutPool(lambda: Echo(spaces.Discrete(2), spaces.Text(4)), 1, 2) as pool:
        pool.reset()
        pool.recv()
        with pytest.raises(ShapeError, match="actions: expected 2 rows, got 1"):
            pool.send(("one",))
        assert pool.num_under_way == 0
        pool.send(("one", "two"))
        assert [info["action"] for info in pool.recv().infos.values()] == [["one"], ["two"]]


class Secret:
    """Can be pickled, but not be read again."""

    def __reduce__(self) -> Any:
        return _unreadable, ()


def _unreadable() -> None:
    raise ImportError("no such class here")


def test_what_cannot_be_read_is_said_and_keeps_nothing_back() -> None:
    class Secretive(Echo):
        def step(self, action: Any) -> Any:
            return *super().step(action)[:4], {"secret": Secret()}

    for space in (spaces.Discrete(3), spaces.Text(3)):
        with RolloutPool(lambda space=space: Secretive(space), 1, 2) as pool:
            pool.reset()
            pool.recv()
            pool.send([0, 0])
            batch = pool.recv()
            assert "no such class here" in batch.infos[1]["unreadable"]
            assert len(batch.observation) == 2


# -- numbers


@pytest.mark.parametrize(
    ("value", "dtype", "expected"),
    [
        (np.array([1, 255], np.int64), np.uint8, [1, 255]),
        (np.array([1, 256], np.uint16), np.uint8, None),
        (np.array([-1], np.int8), np.uint8, None),
        (np.array([2**40]), np.int32, None),
        (np.array([2**63], np.uint64), np.int64, None),
        (np.array([2**31 - 1], np.uint64), np.int32, [2**31 - 1]),
        (np.array([], np.int64), np.uint8, []),
        (np.array([True]), np.int8, [1]),
        (np.array([1e300]), np.float32, None),
        (np.array([-1e300, np.inf]), np.float32, None),
        (np.array([np.inf, -np.inf, 0.5]), np.float32, [np.inf, -np.inf, 0.5]),
        (np.array([70_000]), np.float16, None),
        (np.array([7], np.int64), np.float32, [7.0]),
    ],
)
def test_numbers_keep_their_value_or_are_refused(value: Any, dtype: Any, expected: list[Any] | None) -> None:
    if expected is None:
        with pytest.raises(Unfit, match="x: expected numbers that"):
            converted(value, np.dtype(dtype), "x")
    else:
        made = converted(value, np.dtype(dtype), "x")
        assert made.dtype == dtype
        assert made.tolist() == expected


@pytest.mark.parametrize(
    ("value", "dtype"), [(1.5, np.int64), (1j, np.float32), ("a", np.int64), (2, np.bool_), (2**70, np.int64)]
)
def test_numbers_of_another_kind_are_refused(value: Any, dtype: Any) -> None:
    with pytest.raises(DtypeError, match=f"x: expected {np.dtype(dtype)}"):
        converted(np.asarray(value), np.dtype(dtype), "x")


def test_an_observation_that_does_not_fit_is_an_error_that_names_it() -> None:
    class Deep(Echo):
        def reset(self, **kwargs: Any) -> Any:
            super().reset(**kwargs)
            return {"depth": np.array([300], np.uint16)}, {}

    with RolloutPool(lambda: Deep(spaces.Dict({"depth": spaces.Box(0, 255, (1,), np.uint8)})), 1) as pool:
        pool.reset()
        with pytest.raises(
            DtypeError, match=r"observation\['depth'\]: expected numbers that uint8 holds, got 300"
        ):
            pool.recv()


@pytest.mark.parametrize(
    ("space", "actions"),
    [
        (spaces.Discrete(3, dtype=np.uint8), np.array([0, 2])),
        (spaces.MultiBinary(1), np.array([[256], [-7]])),
        (spaces.Box(-1, 1, (1,), np.float32), np.array([[1e300], [0.5]])),
        (spaces.Box(0, 255, (1,), np.uint8), np.array([[300], [1]], np.uint16)),
    ],
)
def test_actions_of_another_width_reach_the_environment_as_they_are(
    space: spaces.Space[Any], actions: Any
) -> None:
    with RolloutPool(lambda: Echo(spaces.Discrete(2), space), 1, 2) as pool:
        pool.reset()
        pool.recv()
        pool.send(actions)
        infos = pool.recv().infos
        assert [np.asarray(infos[row]["action"][0]).tolist() for row in range(2)] == actions.tolist()


def test_one_action_for_all_is_refused_as_gymnasium_refuses_it() -> None:
    with RolloutVectorEnv(lambda: Echo(spaces.Discrete(2)), 1, 2) as env:
        env.reset()
        with pytest.raises(TypeError, match=r"actions: expected shape \(2,\), got \(\)"):
            env.step(0)


# -- environments that differ


def test_environments_with_other_spaces_are_refused_by_the_constructor() -> None:
    def of(observations: Any, actions: Any = None) -> Any:
        return lambda: Echo(observations, actions)

    two, five = spaces.Discrete(2), spaces.Discrete(5)
    for other in (of(five), of(spaces.Box(0, 1)), of(spaces.Text(3))):
        with pytest.raises(RuntimeError, match="observation spaces are not equivalent") as caught:
            RolloutPool([of(two), other], 2)
        assert "environment 1" in caught.value.__notes__[0]
    with pytest.raises(RuntimeError, match="the action spaces are not equal: expected Discrete"):
        RolloutPool([of(two), of(two, five)], 2)
    with RolloutPool([of(two), of(spaces.Discrete(2))], 2) as pool:
        assert len(shown(pool)) == 2


def shown(pool: RolloutPool) -> Any:
    pool.reset()
    return pool.recv().observation


def test_spaces_that_differ_in_their_bounds_are_taken_where_that_is_said() -> None:
    fns = [lambda n=n: Echo(spaces.Discrete(n)) for n in (2, 5)]
    with RolloutVectorEnv(fns, 2, observation_mode="different") as env:
        assert env.observation_space == spaces.MultiDiscrete([2, 5])
        assert env.reset(seed=0)[0] in env.observation_space
    given = (spaces.MultiDiscrete([9, 9]), spaces.Discrete(9))
    with RolloutVectorEnv(fns, 2, observation_mode=given) as env:
        assert (env.observation_space, env.single_observation_space) == given
    boxes = [lambda n=n: Echo(spaces.Box(0, 1, (n,))) for n in (2, 5)]
    with pytest.raises(RuntimeError, match="do not share a common shape and dtype"):
        RolloutVectorEnv(boxes, 2, observation_mode="different")


def test_an_observation_outside_its_space_is_said_once(caplog: pytest.LogCaptureFixture) -> None:
    class Outside(Echo):
        def reset(self, **kwargs: Any) -> Any:
            super().reset(**kwargs)
            return 7, {}

    with RolloutPool(lambda: Outside(spaces.Discrete(3)), 1, 2) as pool:
        for _ in range(3):
            assert shown(pool).tolist() == [7, 7]
    assert caplog.text.count("expected observations in Discrete(3), found one outside") == 2


def test_the_final_info_is_what_it_was_although_its_dictionary_is_used_again() -> None:
    class Reuse(Echo):
        def __init__(self, space: Any) -> None:
            super().__init__(space)
            self.info = {"score": 0, "path": np.zeros(2), "seen": ["start"]}

        def reset(self, **kwargs: Any) -> Any:
            observation, _ = super().reset(**kwargs)
            self.info["score"], self.info["path"][:], self.info["seen"][:] = 0, 0, ["start"]
            return observation, self.info

        def step(self, action: Any) -> Any:
            result = super().step(action)
            self.info["score"] += 1
            self.info["path"] += 1
            self.info["seen"].append("step")
            return *result[:4], self.info

    for space in (spaces.Discrete(3), spaces.Text(3)):
        with RolloutPool(lambda space=space: Reuse(space), 1, autoreset="SameStep") as pool:
            pool.reset()
            pool.recv()
            for _ in range(3):
                pool.send([0])
                info = pool.recv().infos[0]
            assert info["score"] == 0
            final = info["final_info"]
            assert (final["score"], final["path"].tolist(), len(final["seen"])) == (3, [3.0, 3.0], 4)


def test_parts_are_told_apart() -> None:
    nest = Nest(LOOSE[6], "observation")
    assert [leaf.path for leaf in nest.leaves] == [("at",), ("image",)]
    assert nest.is_like(Nest(LOOSE[6], "observation"))
    assert not nest.is_like(Nest(spaces.Dict({"at": spaces.Discrete(9)}), "observation"))
