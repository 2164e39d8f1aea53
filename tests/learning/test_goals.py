"""Goals: what they are called, what is drawn for an episode and what merely looked up."""

import numpy as np
import pytest
import torch
from torch import Tensor
from toy import toy_learner

from vhs import ArgumentError, DtypeError, LabelError, Outcome, Prototypes, ShapeError
from vhs.learning.goals import ClassGoals, Goals, PrototypeGoals
from vhs.learning.learner import Learner
from vhs.learning.methods import METHODS

from .parts import DIM, GOALS, fill_store, make_batch, small_learner


def hindsight(learner: Learner, reached: Tensor) -> Tensor:
    """The goals of episodes that saw `reached` at their ends."""
    batch = make_batch([Outcome.FAILURE] * len(reached))
    return learner.goals.hindsight(learner.agent, batch, batch.offsets + batch.lengths, reached, reached[:0])


def everything(goals: Goals) -> list[Tensor]:
    """All that a query could have changed: prototypes, their generator, and the store's next batch."""
    return [*goals.state_dict().values(), *map(torch.from_numpy, goals.store.sample(4))]


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("prototype", ["running", "exact"])
def test_a_query_draws_nothing_and_changes_nothing(name: str, prototype: str) -> None:
    overrides = [f"method.prototype={prototype}"] if name in ("vhs", "pg", "gcsl") else []
    asked, left = (toy_learner(name, *overrides).goals for _ in range(2))
    for goals in (asked, left):
        fill_store(goals)
        goals.begin(1)
    first = asked.embedding(1)
    assert torch.equal(first, asked.embedding(1))
    for label in range(GOALS):
        asked.embedding(label)
    for mine, other in zip(everything(asked), everything(left), strict=True):
        assert torch.equal(mine, other)


def test_a_class_without_a_prototype_begins_every_episode_with_fresh_noise() -> None:
    goals = small_learner().goals
    assert torch.equal(goals.embedding(0), torch.zeros(DIM))
    first = goals.begin(0)
    assert torch.equal(goals.embedding(0), first)
    second = goals.begin(0)
    assert not torch.equal(first, second)
    assert torch.equal(goals.embedding(1), torch.zeros(DIM)), "another class"
    expected = Prototypes(GOALS, DIM, seed=0)
    for found in (first, second):
        np.testing.assert_array_equal(found, expected.embed([0])[0])


def test_running_prototypes_are_not_refreshed_on_demand() -> None:
    goals = small_learner().goals
    fill_store(goals)
    goals.refresh(0)
    assert not goals.prototypes.seen.any()


def test_refresh_brings_exact_prototypes_to_the_newest_weights() -> None:
    learner = small_learner("method.prototype=exact")
    fill_store(learner.goals, per_class=1)
    learner.goals.refresh(0)
    before = learner.goals.embedding(0)
    with torch.no_grad():
        learner.agent.extractor.project.bias.add_(torch.arange(DIM))
    assert torch.equal(learner.goals.embedding(0), before)
    learner.goals.refresh(0)
    assert not torch.equal(learner.goals.embedding(0), before)
    assert learner.goals.prototypes.seen.tolist() == [True, False, False]


def test_prototype_hindsight_takes_the_prototype_nearest_to_what_was_reached() -> None:
    learner = small_learner("method.hindsight_goal=prototype")
    reached = torch.randn(4, DIM, generator=torch.Generator().manual_seed(2))
    fill_store(learner.goals)
    assert torch.equal(hindsight(learner, reached), reached), "no prototype leaves the feature"
    table = np.eye(GOALS, DIM, dtype=np.float32) * np.array([[1.0], [50.0], [2.0]], dtype=np.float32)
    learner.goals.prototypes.update(table, [0, 1, 2])
    near = torch.tensor(table)[[2, 0, 1, 0]] * 3 + 0.1
    torch.testing.assert_close(hindsight(learner, near), torch.tensor(table)[[2, 0, 1, 0]])


def test_a_class_that_was_never_reached_names_nothing_and_holds_up_nothing() -> None:
    learner = small_learner("method.hindsight_goal=prototype")
    fill_store(learner.goals)
    table = np.eye(GOALS, DIM, dtype=np.float32)
    learner.goals.prototypes.update(table[:2], [0, 1])
    near = torch.tensor(table)[[1, 0, 2]] + torch.tensor([[0.0, 0.1] + [0.0] * (DIM - 2)])
    torch.testing.assert_close(hindsight(learner, near), torch.tensor(table)[[1, 0, 1]])


def test_prototype_hindsight_waits_until_goals_can_be_told_apart() -> None:
    learner = small_learner("method.hindsight_goal=prototype", "method.prototype=exact")
    fill_store(learner.goals, per_class=1)
    for label in range(GOALS):
        learner.goals.begin(label)
    assert learner.goals.prototypes.seen.all()
    assert not learner.goals.is_warm
    reached = torch.randn(4, DIM, generator=torch.Generator().manual_seed(2))
    assert torch.equal(hindsight(learner, reached), reached)


def test_exact_prototypes_embed_stored_images_of_their_class_alone() -> None:
    learner = small_learner("method.prototype=exact")
    assert not torch.equal(learner.goals.begin(2), learner.goals.begin(2)), "noise while the class is empty"
    image = np.full(learner.goals.store.observation_shape, 90, dtype=np.uint8)
    learner.goals.store.push(image, 2)
    assert not learner.goals.is_warm
    learner.agent.eval()
    with torch.inference_mode():
        expected = learner.agent.extractor(torch.from_numpy(image).unsqueeze(0))[0]
    torch.testing.assert_close(learner.goals.begin(2), expected, atol=1e-5, rtol=1e-4)
    assert not learner.goals.prototypes.seen[0]


@pytest.mark.parametrize("prototype", ["running", "exact"])
def test_a_class_that_is_shown_is_named_by_the_mean_feature_of_its_pictures(prototype: str) -> None:
    """Whatever had named it, whatever the store has of it, and without a change to anything else."""
    learner = small_learner(f"method.prototype={prototype}")
    goals = learner.goals
    assert isinstance(goals, PrototypeGoals)
    fill_store(goals)
    goals.prototypes.update(np.eye(GOALS, DIM, dtype=np.float32), np.arange(GOALS))
    weights = {name: value.clone() for name, value in learner.agent.state_dict().items()}
    others, counts = goals.prototypes.table[:2], goals.counts
    pictures = np.random.default_rng(3).integers(0, 256, (4, *goals.store.observation_shape), dtype=np.uint8)
    goals.show(2, pictures)
    learner.agent.eval()
    with torch.inference_mode():
        expected = learner.agent.extractor(torch.from_numpy(pictures)).mean(dim=0)
    for _ in range(2):
        torch.testing.assert_close(goals.begin(2), expected)
    np.testing.assert_array_equal(goals.prototypes.table[:2], others)
    np.testing.assert_array_equal(goals.counts, counts)
    for name, value in learner.agent.state_dict().items():
        assert torch.equal(value, weights[name]), name


@pytest.mark.parametrize(
    ("label", "count", "dtype", "error", "message"),
    [
        (GOALS, 1, np.uint8, LabelError, r"expected a class in 0\.\.3, found 3"),
        (-1, 1, np.uint8, LabelError, r"expected a class in 0\.\.3, found -1"),
        (0, 1, np.float32, DtypeError, r"expected pictures of dtype uint8, found float32"),
        (0, 0, np.uint8, ShapeError, r"\[n, 16, 16, 6\], n at least 1, found \[0, 16, 16, 6\]"),
    ],
)
def test_what_cannot_be_shown_changes_nothing(
    label: int, count: int, dtype: type, error: type[Exception], message: str
) -> None:
    goals = small_learner().goals
    assert isinstance(goals, PrototypeGoals)
    with pytest.raises(error, match=message):
        goals.show(label, np.zeros((count, *goals.store.observation_shape), dtype))
    assert not goals.prototypes.seen.any()


def test_words_are_not_shown() -> None:
    goals = toy_learner("a3c").goals
    assert isinstance(goals, ClassGoals)
    with pytest.raises(ArgumentError, match=r"method\.embedding = prototype\), found WordGoals"):
        goals.show(0, np.zeros((1, *goals.store.observation_shape), np.uint8))
