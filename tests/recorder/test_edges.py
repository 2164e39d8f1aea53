"""The recorder where things go wrong or differ: crashes, shared streams, types, numbers of actions, infos."""

from __future__ import annotations

import gc
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

import vhs
from vhs.recorder import HindsightRecorder, make_buffer
from vhs.streams import Infos, streams_of


class Counter(gymnasium.Env[dict[str, Any], np.int64]):
    """Counts its steps from `base`, four an episode; `crash` is the step that raises."""

    action_space: spaces.Space[Any] = spaces.Discrete(2)

    def __init__(self, base: int = 0, crash: int = 99, info_key: str = "effort") -> None:
        box = spaces.Box(-9, 999, (1,), np.float32)
        self.observation_space = spaces.Dict(observation=box, achieved_goal=box, desired_goal=box)
        self.base, self.crash, self.info_key = base, crash, info_key
        self.info: dict[str, Any] = {}

    def seen(self) -> dict[str, Any]:
        return {key: np.array([self.base + self.time], np.float32) for key in self.observation_space.spaces}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        self.time = 0
        return self.seen(), {}

    def step(self, action: Any) -> Any:
        self.time += 1
        if self.time == self.crash:
            raise RuntimeError("simulator crashed")
        # One dictionary, used again: what is kept must be a copy.
        self.info.clear()
        self.info[self.info_key] = float(self.base + self.time)
        return self.seen(), 0.0, False, self.time == 4, self.info


def new_buffer(env: gymnasium.Env[Any, Any] | None = None, **more: Any) -> vhs.EpisodeBuffer:
    return make_buffer(env or Counter(), capacity_steps=40, max_episode_steps=9, **more)


def play(env: HindsightRecorder, episodes: int = 1) -> None:
    for _ in range(episodes):
        env.reset()
        done = False
        while not done:
            _, _, terminated, truncated, _ = env.step(env.action_space.sample())
            done = terminated or truncated


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_an_episode_in_which_a_step_raised_is_dropped(error: type[BaseException]) -> None:
    class Crashing(Counter):
        def step(self, action: Any) -> Any:
            if self.time == 2 and self.crash == 3:
                raise error
            return super().step(action)

    buffer = new_buffer()
    env = HindsightRecorder(Crashing(crash=3), buffer)
    env.reset()
    env.step(0)
    env.step(0)
    with pytest.raises(error):
        env.step(0)
    assert not buffer.open[0]
    env.env.unwrapped.crash = 99  # type: ignore[attr-defined]
    with pytest.raises(vhs.ProtocolError, match="expected an open episode"):
        env.step(0)
    play(env)
    assert buffer.gather(buffer.ids).lengths.tolist() == [4]


def test_a_step_that_the_buffer_refuses_ends_the_episode_too() -> None:
    class Odd(Counter):
        def seen(self) -> dict[str, Any]:
            seen = super().seen()
            return {**seen, "observation": np.zeros(2, np.float32)} if self.time == 2 else seen

    env = HindsightRecorder(Odd(), new_buffer())
    env.reset()
    env.step(0)
    with pytest.raises(vhs.ShapeError):
        env.step(0)
    env.reset()
    assert len(env.buffer) == 0


def test_a_stream_is_that_of_the_recorder_that_was_reset_last() -> None:
    buffer = new_buffer()
    first, second = (HindsightRecorder(Counter(base), buffer) for base in (0, 100))
    first.reset()
    first.step(0)
    second.reset()
    for _ in range(4):
        second.step(0)
        with pytest.warns(
            RuntimeWarning, match="another one was reset on it since; this step is not recorded"
        ):
            first.step(0)
    play(first)
    batch = buffer.gather(buffer.ids)
    assert batch.lengths.tolist() == [1, 4, 4]
    assert batch.observations[:, 0, 0].tolist() == [0, 1, 100, 101, 102, 103, 104, 0, 1, 2, 3, 4]


@pytest.mark.parametrize("stream", [1, -1, 2**70])
def test_a_stream_that_the_buffer_does_not_have_is_refused(stream: int) -> None:
    with pytest.raises(vhs.LabelError, match=r"`stream`: expected a number in 0..1, got"):
        HindsightRecorder(Counter(), new_buffer(), stream=stream)


@pytest.mark.parametrize("start", [5, 0, -3])
def test_actions_are_given_back_as_the_environment_counts_them(start: int) -> None:
    env = Counter()
    env.action_space = spaces.Discrete(3, start=start)
    buffer = new_buffer(env, interactions={start + 2: 0, start + 1: 1})
    assert (buffer.first_action, buffer.num_actions) == (start, 3)
    recorder = HindsightRecorder(env, buffer)
    recorder.reset()
    taken = [start, start + 1, start + 2, start + 2]
    for action in taken:
        recorder.step(action)
    assert buffer.gather([0]).actions[0].tolist() == taken
    assert set(buffer.sample_transitions(50).actions.tolist()) == set(taken)
    assert buffer.sample_episodes(1, "final", on=("timeout",)).hindsight.interactions.tolist() == [0]


def test_the_space_says_the_types_whatever_the_first_observation_has() -> None:
    class Loose(Counter):
        def reset(self, **_: Any) -> Any:
            self.time = 0
            return {key: [np.int64(3)] for key in self.observation_space.spaces}, {}

    buffer = new_buffer(Loose())
    assert (buffer.dtype, buffer.goal_dtype) == (np.float32, np.float32)
    play(HindsightRecorder(Counter(base=0), buffer))
    env = Loose()
    entry = spaces.Box(0, 9, (1,), np.int16)
    env.observation_space = spaces.Dict(observation=entry, achieved_goal=entry, desired_goal=entry)
    assert new_buffer(env).dtype == np.int16


@pytest.mark.parametrize(
    ("number", "dtype", "fits"),
    [
        (np.int64(7), "uint8", True),
        (np.int64(300), "uint8", False),
        (np.int64(-1), "uint8", False),
        (np.uint64(2**63), "int64", False),
        (np.float64(0.1), "float32", True),
        (np.float64(1e300), "float32", False),
        (np.float64("inf"), "float32", True),
        (np.float64(1.0), "int64", False),
        (np.int64(3), "float32", True),
        (np.True_, "uint8", True),
    ],
)
def test_numbers_are_converted_where_only_precision_is_lost(number: Any, dtype: str, fits: bool) -> None:
    class One(Counter):
        def seen(self) -> dict[str, Any]:
            return {
                "observation": np.array([number]),
                "achieved_goal": [0.0],
                "desired_goal": [0.0],
            }

    buffer = vhs.EpisodeBuffer(
        (1,),
        num_streams=1,
        max_episode_steps=9,
        capacity_steps=9,
        frame_stack=1,
        dtype=dtype,
        goals="vectors",
        goal_shape=(1,),
        goal_dtype="float64",
    )
    env = HindsightRecorder(One(), buffer)
    if fits:
        play(env)
        assert buffer.gather([0]).observations.ravel().tolist() == [np.array(number).astype(dtype)] * 5
        return
    with pytest.raises(vhs.DtypeError, match=f"`frame`: expected {dtype}"):
        env.reset()


def by_key(env: Any, achieved: Any, desired: Any, info: Any) -> Any:
    return -np.ones(len(achieved)) * info["effort"]


def by_list(env: Any, achieved: Any, desired: Any, infos: Any) -> Any:
    return np.array([-info["effort"] for _, info in zip(achieved, infos, strict=True)])


def by_get(env: Any, achieved: Any, desired: Any, infos: Any) -> Any:
    return -infos.get("effort", 0.0)


def told(compute: Any) -> type[Counter]:
    return type("Told", (Counter,), {"compute_reward": compute})


@pytest.mark.parametrize("compute", [by_key, by_list, by_get])
def test_a_reward_reads_the_infos_of_its_steps(compute: Any) -> None:
    buffer = new_buffer(num_streams=2)
    envs = [
        HindsightRecorder(told(compute)(base), buffer, stream=place) for place, base in enumerate((0, 100))
    ]
    for _ in range(8):  # more than fit
        for env in envs:
            play(env)
    assert set(streams_of(buffer).infos) == set(buffer.ids.tolist())
    batch = buffer.sample_transitions(50, "future", probability=1.0, reward=envs[0].reward)
    np.testing.assert_array_equal(batch.rewards, -batch.achieved_goals[:, 0])
    parts = buffer.sample_windows(20, 3, 1, "future", probability=1.0, reward=envs[0].reward)
    for row in range(20):
        used = int(parts.lengths[row])
        np.testing.assert_array_equal(parts.rewards[row, :used], -parts.achieved_goals[row, 1 : used + 1, 0])
        assert not parts.rewards[row, used:].any()


def test_infos_are_kept_only_where_they_are_read() -> None:
    def ignores(env: Any, achieved: Any, desired: Any, info: Any) -> Any:
        return -np.linalg.norm(achieved - desired, axis=-1)

    for compute, infos, kept in (
        (ignores, None, 0),
        (ignores, True, 1),
        (by_key, None, 1),
        (by_key, False, 0),
    ):
        buffer = new_buffer()
        env = HindsightRecorder(told(compute)(), buffer, infos=infos)
        play(env)
        assert len(streams_of(buffer).infos) == kept
    with pytest.raises(vhs.EpisodeError, match="expected the infos that compute_reward reads, found none"):
        buffer.sample_transitions(4, "future", probability=1.0, reward=env.reward)


@pytest.mark.slow
def test_what_recorders_share_goes_with_the_buffer() -> None:
    from vhs import streams

    before = len(streams._STREAMS)
    env = HindsightRecorder(Counter(), new_buffer())
    assert len(streams._STREAMS) == before + 1
    del env
    gc.collect()
    assert len(streams._STREAMS) == before


def test_infos_are_a_sequence() -> None:
    kept = {3: [{"a": 1}, {"a": 2, "b": 5}]}
    infos = Infos(kept, np.array([3, 3, 3]), np.array([1, 0, -1]))
    assert (len(infos), infos[0], infos[-1]) == (3, {"a": 2, "b": 5}, {"a": 1})
    assert (infos[:2], list(infos)) == ([{"a": 2, "b": 5}, {"a": 1}], [{"a": 2, "b": 5}, {"a": 1}, {"a": 1}])
    assert infos["a"].tolist() == [2, 1, 1]
    assert infos.get("b", 0).tolist() == [5, 0, 0]
    with pytest.raises(KeyError):
        infos["b"]
