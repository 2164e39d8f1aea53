"""The recorder on environments of three kinds: our own small ones, and others that we did not write."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

import vhs
from vhs.recorder import GoalDict, HindsightRecorder, Instruction, Seen, default_outcome, make_buffer


class Line(gymnasium.Env[dict[str, Any], np.int64]):
    """Walk on the numbers 0..=9 to the one told; `GoalEnv` dictionaries."""

    def __init__(self) -> None:
        number = spaces.Box(0, 9, (1,), np.int64)
        entries = dict.fromkeys(("observation", "achieved_goal", "desired_goal"), number)
        self.observation_space = spaces.Dict(entries)
        self.action_space = spaces.Discrete(2, start=-1)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.place, self.goal, self.time = 5, int(self.np_random.integers(10)), 0
        return self._seen(), {}

    def step(self, action: Any) -> Any:
        self.place = int(np.clip(self.place + (1 if action == 0 else -1), 0, 9))
        self.time += 1
        seen = self._seen()
        reward = self.compute_reward(seen["achieved_goal"], seen["desired_goal"], {})
        return seen, float(reward), False, self.time == 6, {"is_success": bool(reward == 0)}

    def compute_reward(self, achieved: Any, desired: Any, info: Any) -> Any:
        return np.where((achieved == desired).all(-1), 0.0, -1.0)

    def _seen(self) -> dict[str, Any]:
        place, goal = np.array([self.place]), np.array([self.goal])
        return {"observation": place, "achieved_goal": place, "desired_goal": goal}


def play(env: gymnasium.Env[Any, Any], episodes: int, seed: int = 0) -> list[list[tuple[Any, Any]]]:
    """Random episodes, and what a user saw of them: (observation, step's result)."""
    env.action_space.seed(seed)
    seen = []
    for episode in range(episodes):
        observation, _ = env.reset(seed=seed + episode)
        steps: list[tuple[Any, Any]] = [(observation, None)]
        done = False
        while not done:
            action = env.action_space.sample()
            result = env.step(action)
            steps.append((result[0], (action, *result[1:])))
            done = result[2] or result[3]
        seen.append(steps)
    return seen


def test_goal_dictionaries_are_recorded_step_by_step() -> None:
    env = Line()
    buffer = make_buffer(env, capacity_steps=60, max_episode_steps=6)
    assert (buffer.goals, buffer.dtype, buffer.goal_shape) == ("vectors", np.int64, (1,))
    seen = play(HindsightRecorder(env, buffer), 5)
    for number, steps in enumerate(seen):
        batch = buffer.gather([number])
        places = [step[0]["achieved_goal"] for step in steps]
        np.testing.assert_array_equal(batch.achieved_goals, places)
        np.testing.assert_array_equal(batch.observations[:, 0], places)
        np.testing.assert_array_equal(batch.desired_goals[0], steps[0][0]["desired_goal"])
        assert batch.actions[0].tolist() == [int(step[1][0]) for step in steps[1:]]
        assert batch.rewards[0].tolist() == [step[1][1] for step in steps[1:]]
        assert not batch.terminated[0]  # cut off after six steps, reached or not
        reached = steps[-1][1][-1]["is_success"]
        assert batch.outcomes[0] == (vhs.Outcome.SUCCESS if reached else vhs.Outcome.TIMEOUT)


def test_rewards_are_those_of_the_environment_for_the_new_goals() -> None:
    env = HindsightRecorder(Line(), make_buffer(Line(), capacity_steps=600, max_episode_steps=6))
    play(env, 50)
    batch = env.buffer.sample_transitions(300, "future", reward=env.reward)
    expected = Line().compute_reward(batch.achieved_goals, batch.goals, {})
    np.testing.assert_array_equal(batch.rewards, expected)
    assert (batch.rewards == 0).any()
    # The built-in rule says the same, and so needs no environment at all.
    sparse = env.buffer.sample_transitions(300, "future", reward=vhs.SparseReward(terminates=False))
    np.testing.assert_array_equal(
        sparse.rewards, Line().compute_reward(sparse.achieved_goals, sparse.goals, {})
    )


def test_values_stacked_frames_and_a_judge_of_the_users_are_recorded() -> None:
    buffer = make_buffer(Line(), capacity_steps=60, max_episode_steps=6, frame_stack=2)
    env = HindsightRecorder(Line(), buffer, judge=lambda *_: vhs.Outcome.FAILURE)
    env.reset(seed=0)
    for step in range(6):
        env.value = float(step)
        env.step(0)
    batch = buffer.gather(buffer.ids)
    assert batch.values[0].tolist() == [0, 1, 2, 3, 4, 5]
    assert batch.outcomes[0] == vhs.Outcome.FAILURE
    assert batch.observations[:, :, 0].tolist() == [[5, 5], [5, 6], [6, 7], [7, 8], [8, 9], [9, 9], [9, 9]]


def test_real_actions_are_recorded() -> None:
    env = gymnasium.make("Pendulum-v1", max_episode_steps=5)

    def reader(observation: np.ndarray) -> Seen:
        return Seen(observation, desired_goal=np.zeros(3, np.float32))

    buffer = make_buffer(env, capacity_steps=50, reader=reader)
    recorder = HindsightRecorder(env, buffer, reader=reader)
    recorder.reset(seed=0)
    actions = [np.array([number / 4], np.float32) for number in range(5)]
    frames = [recorder.step(action)[0] for action in actions]
    batch = buffer.gather(buffer.ids)
    np.testing.assert_array_equal(batch.actions[0], actions)
    np.testing.assert_array_equal(batch.observations[1:, 0], frames)


def test_a_reset_in_the_middle_keeps_what_there_is() -> None:
    env = HindsightRecorder(Line(), make_buffer(Line(), capacity_steps=60, max_episode_steps=6))
    env.reset(seed=0)
    env.reset(seed=1)  # nothing happened: dropped
    assert (len(env.buffer), env.last_id) == (0, None)
    env.step(0)
    env.reset(seed=2)
    assert env.last_id == 0
    batch = env.buffer.gather([0])
    assert batch.outcomes[0] == vhs.Outcome.TIMEOUT
    assert batch.lengths.tolist() == [1]


def test_environments_of_a_vector_share_a_buffer() -> None:
    buffer = make_buffer(Line(), capacity_steps=600, max_episode_steps=6, num_streams=3)
    envs = gymnasium.vector.SyncVectorEnv(
        [lambda stream=stream: HindsightRecorder(Line(), buffer, stream=stream) for stream in range(3)]
    )
    envs.reset(seed=4)
    for _ in range(40):  # episodes end, reset themselves and go on
        envs.step(envs.action_space.sample())
    batch = buffer.gather(buffer.ids)
    assert batch.lengths.tolist() == [6] * len(buffer)
    assert len(buffer) >= 15
    # Every step is one place or none: no episode took over the first observation of the next.
    rows = batch.achieved_goals[:, 0].reshape(len(buffer), 7)
    assert (np.abs(np.diff(rows, axis=1)) <= 1).all()
    assert (rows[:, 0] == 5).all()


def test_our_rooms_are_read_without_being_told_how() -> None:
    pytest.importorskip("mujoco", reason="the rooms need vhs[env]")
    space = spaces.Dict(
        {
            "image": spaces.Box(0, 255, (8, 8, 3), np.uint8),
            "goal": spaces.Discrete(5),
            "interaction": spaces.Discrete(3),
        }
    )

    class Room(gymnasium.Env[Any, Any]):
        observation_space, action_space = space, spaces.Discrete(6)

        def reset(self, **_: Any) -> Any:
            return {"image": np.full((8, 8, 3), 1, np.uint8), "goal": 3, "interaction": 2}, {}

        def step(self, action: Any) -> Any:
            seen = {"image": np.full((8, 8, 3), 2, np.uint8), "goal": 3, "interaction": 2}
            return seen, -1.0, True, False, {"outcome": "failure"}

    with pytest.raises(vhs.ArgumentError, match="`interactions`: expected which action does which of"):
        make_buffer(Room(), capacity_steps=9, max_episode_steps=3, num_interactions=3)
    interactions = {3: 0, 4: 1, 5: 2}
    buffer = make_buffer(
        Room(), capacity_steps=9, max_episode_steps=3, num_goals=5, interactions=interactions
    )
    env = HindsightRecorder(Room(), buffer)
    env.reset()
    env.step(4)
    batch = buffer.sample_episodes(1, "final")
    assert (batch.goals[0], batch.interactions[0], batch.outcomes[0]) == (3, 2, vhs.Outcome.FAILURE)
    assert batch.hindsight.interactions[0] == 1  # what action 4 does


def test_a_function_reads_what_no_rule_knows() -> None:
    env = gymnasium.make("CartPole-v1")
    with pytest.raises(vhs.ArgumentError, match="`reader`: expected one for an observation space without"):
        make_buffer(env, capacity_steps=1000)

    def reader(observation: np.ndarray) -> Seen:
        return Seen(observation, desired_goal=np.zeros((1, 4), np.float32))

    buffer = make_buffer(env, capacity_steps=1000, reader=reader)
    assert (buffer.goals, buffer.dtype) == ("observations", np.float32)
    play(HindsightRecorder(env, buffer, reader=reader), 3)
    batch = buffer.sample_transitions(20, "final", probability=1.0)
    last = buffer.gather(buffer.ids)
    ends = last.observations[last.offsets + last.lengths]
    np.testing.assert_array_equal(batch.goals, ends[batch.ids])


@pytest.mark.parametrize(
    ("reward", "terminated", "info", "outcome"),
    [
        (0.0, True, {"outcome": "success"}, vhs.Outcome.SUCCESS),
        (1.0, True, {"outcome": "failure"}, vhs.Outcome.FAILURE),
        (-1.0, False, {"is_success": 1.0}, vhs.Outcome.SUCCESS),
        (-1.0, False, {"success": np.True_}, vhs.Outcome.SUCCESS),
        (0.5, True, {}, vhs.Outcome.SUCCESS),
        (0.0, True, {}, vhs.Outcome.FAILURE),
        (0.5, False, {"is_success": 0.0}, vhs.Outcome.TIMEOUT),
        (0.5, True, {"is_success": False}, vhs.Outcome.FAILURE),
    ],
)
def test_outcomes_are_read_in_this_order(
    reward: float, terminated: bool, info: dict[str, Any], outcome: vhs.Outcome
) -> None:
    assert default_outcome(reward, terminated, not terminated, info) is outcome


def test_a_new_recorder_goes_on_with_a_stream_whose_episode_is_open() -> None:
    buffer = make_buffer(Line(), capacity_steps=60, max_episode_steps=6)
    HindsightRecorder(Line(), buffer).reset(seed=0)
    env = HindsightRecorder(Line(), buffer)
    play(env, 2)
    assert len(buffer) == 2, "what had no step is dropped"
    env.reset(seed=0)
    env.step(0)
    play(HindsightRecorder(Line(), buffer), 2)
    assert buffer.gather(buffer.ids).lengths.tolist() == [6, 6, 1, 6, 6], "what had one is kept"


def test_the_number_of_goals_is_read_off_the_space() -> None:
    env = gymnasium.make("vhs/InteractiveObjectNav-v0")
    buffer = make_buffer(env, capacity_steps=60, max_episode_steps=20, num_interactions=1)
    recorder = HindsightRecorder(env, buffer)
    assert {recorder.reset(seed=seed)[0]["goal"] for seed in range(8)} > {0, 4}
    env.close()


def test_spaces_that_no_buffer_can_hold_are_refused() -> None:
    env = Line()
    with pytest.raises(vhs.ArgumentError, match="`max_episode_steps`: expected a number, got None"):
        make_buffer(env, capacity_steps=60)
    env.action_space = spaces.Text(5)
    with pytest.raises(
        vhs.ArgumentError, match="`env`: expected Discrete, MultiDiscrete, MultiBinary or Box"
    ):
        make_buffer(env, capacity_steps=60, max_episode_steps=6)


def test_readers_take_names_or_functions() -> None:
    observation = {
        "pixels": np.ones((2, 2)),
        "told": 3,
        "observation": 1,
        "achieved_goal": 2,
        "desired_goal": 5,
    }
    seen = Instruction("pixels", lambda entries: entries["told"] - 1, "told")(observation)
    assert (seen.label, seen.interaction, seen.frame.shape) == (2, 3, (2, 2))
    told = GoalDict()(observation)
    assert (int(told.frame), int(told.achieved_goal), int(told.desired_goal)) == (1, 2, 5)


class Shown(gymnasium.Env[dict[str, Any], np.int64]):
    """Shows one picture beside a goal for three steps; what both are is the test's to say."""

    action_space = spaces.Discrete(2)

    def __init__(self, image: Any, goal: Any = 0) -> None:
        self.seen = {"image": np.asarray(image), "goal": goal}
        arrays = {name: np.asarray(part) for name, part in self.seen.items()}
        self.observation_space = spaces.Dict(
            {name: spaces.Box(0, 1, array.shape, array.dtype) for name, array in arrays.items()}
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        self.time = 0
        return self.seen, {}

    def step(self, action: Any) -> Any:
        self.time += 1
        return self.seen, 0.0, False, self.time == 3, {}


@pytest.mark.parametrize(
    ("image", "error", "message"),
    [
        (np.full((3, 4, 4), 0.5, np.float32), vhs.DtypeError, "`frame`: expected uint8, got float32"),
        (np.full((3, 4, 4), 300, np.int64), vhs.DtypeError, "`frame`: expected uint8, got int64"),
        (
            np.ones((4, 4, 3), np.uint8),
            vhs.ShapeError,
            r"`frame`: expected shape \[3, 4, 4\], got \[4, 4, 3\]",
        ),
    ],
)
def test_frames_that_the_buffer_cannot_hold_are_refused(
    image: np.ndarray, error: type[Exception], message: str
) -> None:
    buffer = make_buffer(Shown(np.zeros((3, 4, 4), np.uint8)), capacity_steps=9, max_episode_steps=3)
    env = HindsightRecorder(Shown(image), buffer)
    with pytest.raises(error, match=message):
        env.reset()
    assert not buffer.open[0]


def test_numbers_are_converted_within_their_kind() -> None:
    buffer = make_buffer(Shown(np.zeros(3, np.float32)), capacity_steps=9, max_episode_steps=3)
    play(HindsightRecorder(Shown(np.array([0.25, 0.5, 0.75])), buffer), 1)
    assert buffer.gather([0]).observations[0, 0].tolist() == [0.25, 0.5, 0.75]
    buffer = make_buffer(Shown(np.zeros(3, np.bool_)), capacity_steps=9, max_episode_steps=3)
    play(HindsightRecorder(Shown(np.array([True, False, True])), buffer), 1)
    assert (buffer.dtype, buffer.gather([0]).observations[0, 0].tolist()) == (np.uint8, [1, 0, 1])


def test_an_observation_that_is_a_number_is_stored_as_an_array_of_one() -> None:
    env = gymnasium.make("FrozenLake-v1")

    def reader(observation: int) -> Seen:
        return Seen(
            np.asarray(observation), desired_goal=np.asarray(15), achieved_goal=np.asarray(observation)
        )

    buffer = make_buffer(env, capacity_steps=1000, reader=reader)
    seen = play(HindsightRecorder(env, buffer, reader=reader), 2)
    assert (buffer.frame_shape, buffer.goal_shape) == ((1,), (1,))
    assert buffer.gather([1]).achieved_goals[:, 0].tolist() == [step[0] for step in seen[1]]


@pytest.mark.parametrize("frame_stack", [1, 2])
def test_a_pictured_goal_is_told_as_an_observation(frame_stack: int) -> None:
    picture = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)
    env = Shown(np.ones((4, 4, 3), np.uint8), picture)
    buffer = make_buffer(env, capacity_steps=9, max_episode_steps=3, frame_stack=frame_stack)
    assert (buffer.goals, buffer.num_goals) == ("observations", 1)
    play(HindsightRecorder(env, buffer), 2)
    np.testing.assert_array_equal(buffer.gather([0]).desired_goals, [[picture] * frame_stack])
    batch = buffer.sample_transitions(20, "final", ratio=4)
    assert (batch.goals[batch.relabelled] == 1).all()
    np.testing.assert_array_equal(batch.goals[~batch.relabelled][0], [picture] * frame_stack)


def test_a_pictured_goal_is_stacked_as_the_buffer_stacks() -> None:
    picture = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)
    buffer = vhs.EpisodeBuffer(
        (4, 4, 3),
        num_streams=1,
        max_episode_steps=3,
        capacity_steps=9,
        stacking="channels",
        goals="observations",
    )
    env = HindsightRecorder(Shown(np.ones((4, 4, 3), np.uint8), picture), buffer)
    env.reset()
    env.step(0)
    env.reset()
    told = buffer.gather([0]).desired_goals[0]
    np.testing.assert_array_equal(told, np.concatenate([picture, picture], axis=-1))


def test_a_goal_that_is_neither_class_nor_picture_is_refused() -> None:
    image = np.zeros((4, 4, 3), np.uint8)
    for goal, got in ((np.zeros(7, np.float32), r"float32 \[7\]"), ("red ball", "<U8"), (0.5, "float64")):
        with pytest.raises(
            vhs.ArgumentError, match="`goal`: expected a class number or a picture.*got " + got
        ):
            Instruction()({"image": image, "goal": goal})


class Guided(gymnasium.Env[dict[str, Any], int]):
    """A picture, a class, a compass and a number of Python's."""

    observation_space = spaces.Dict(
        {
            "image": spaces.Box(0, 255, (2, 2, 3), np.uint8),
            "goal": spaces.Discrete(3),
            "compass": spaces.Box(-1, 1, (2,), np.float64),
            "battery": spaces.Box(0, 1, (), np.float32),
        }
    )
    action_space = spaces.Discrete(2)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, Any]:
        super().reset(seed=seed)
        self._t = 0
        return self._seen(), {}

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self._t += 1
        return self._seen(), 0.0, self._t == 3, False, {}

    def _seen(self) -> dict[str, Any]:
        image = np.full((2, 2, 3), self._t, np.uint8)
        return {"image": image, "goal": 1, "compass": np.full(2, self._t / 4), "battery": 1 - self._t / 4}


def test_further_entries_are_recorded_where_the_reader_says_so() -> None:
    env, reader = Guided(), Instruction(fields=("compass", "battery"))
    buffer = make_buffer(env, capacity_steps=10, max_episode_steps=5, reader=reader)
    assert buffer.fields == {"compass": vhs.Field((2,), "float64"), "battery": vhs.Field()}
    recorder = HindsightRecorder(env, buffer, reader=reader)
    for _ in range(2):
        recorder.reset()
        for action in (0, 1, 0):
            recorder.step(action)
    batch = buffer.gather([0, 1])
    assert batch.fields["compass"].tolist() == [[t / 4] * 2 for t in range(4)] * 2
    assert batch.fields["battery"].tolist() == [1 - t / 4 for t in range(4)] * 2


def test_what_comes_with_a_step_is_set_before_it() -> None:
    env = Guided()
    buffer = vhs.EpisodeBuffer(
        (2, 2, 3),
        num_streams=1,
        max_episode_steps=3,
        capacity_steps=3,
        num_goals=3,
        fields={"log_prob": vhs.Field(per="step")},
    )
    recorder = HindsightRecorder(env, buffer)
    recorder.reset()
    for step in range(3):
        recorder.fields["log_prob"] = -step / 2
        recorder.step(0)
    assert buffer.gather([0]).fields["log_prob"].tolist() == [[0, -0.5, -1]]


def test_a_field_that_the_buffer_does_not_have_is_refused() -> None:
    env = Guided()
    buffer = make_buffer(env, capacity_steps=10, max_episode_steps=5)
    recorder = HindsightRecorder(env, buffer, reader=Instruction(fields=("compass",)))
    with pytest.raises(vhs.ArgumentError, match='`fields`: expected none, got "compass"'):
        recorder.reset()
    assert not buffer.open.any()
