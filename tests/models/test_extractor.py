"""The feature extractor: layout, scale, batch norm's two ways, refusals."""

import pytest
import torch
from torch import Tensor

from vhs import ShapeError
from vhs.models import FeatureExtractor


@pytest.fixture
def extractor() -> FeatureExtractor:
    torch.manual_seed(0)
    return FeatureExtractor((84, 84, 3), 2, (16, 32, 32, 64), 256)


def images(count: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, 256, (count, 2, 84, 84, 3), dtype=torch.uint8, generator=generator)


def test_shape_of_the_features(extractor: FeatureExtractor) -> None:
    assert extractor(images(3)).shape == (3, 256)


def test_channels_are_frames_by_colours(extractor: FeatureExtractor) -> None:
    extractor.eval()
    observations = images(1)
    planes = torch.cat([observations[0, 0].permute(2, 0, 1), observations[0, 1].permute(2, 0, 1)]).float()
    raw = extractor.project(extractor.convolutions((planes - 128).unsqueeze(0)).flatten(1))
    expected = (raw - raw.mean()) / raw.std(correction=0)
    torch.testing.assert_close(extractor(observations), expected, atol=1e-4, rtol=1e-4)


def test_frames_in_a_row_and_frames_as_channels_are_the_same_bits(extractor: FeatureExtractor) -> None:
    stacks = images(3)
    pictures = torch.cat([stacks[:, 0], stacks[:, 1]], dim=-1)
    extractor.eval()
    assert torch.equal(extractor(stacks), extractor(pictures))


def test_learning_ignores_the_contrast_of_the_pixels(extractor: FeatureExtractor) -> None:
    extractor.train()
    quarter = images(8) // 4
    dim, bright = quarter * 2 + 64, quarter * 4  # both centred on 128
    torch.testing.assert_close(extractor(dim), extractor(bright), atol=1e-3, rtol=1e-3)


def test_features_have_one_scale_whatever_the_weights(extractor: FeatureExtractor) -> None:
    with torch.no_grad():
        extractor.project.weight *= 50
    features = extractor(images(4))
    torch.testing.assert_close(features.norm(dim=1), torch.full((4,), 16.0), atol=1e-2, rtol=0)


def test_acting_does_not_depend_on_the_company(extractor: FeatureExtractor) -> None:
    extractor.eval()
    observations = images(6)
    torch.testing.assert_close(
        extractor(observations)[2:3], extractor(observations[2:3]), atol=1e-4, rtol=1e-4
    )


def test_folded_convolutions_follow_every_change_of_weights_and_statistics(
    extractor: FeatureExtractor,
) -> None:
    def layer_by_layer(observations: Tensor) -> Tensor:
        planes = observations.permute(0, 1, 4, 2, 3).flatten(1, 2).float() - 128
        raw = extractor.project(extractor.convolutions(planes).flatten(1))
        return torch.nn.functional.layer_norm(raw, raw.shape[1:])

    observations = images(4)
    optimiser = torch.optim.Adam(extractor.parameters(), lr=0.01)
    for _ in range(3):
        extractor.train()
        extractor(images(8, seed=1))[:, 0].sum().backward()
        optimiser.step()
        extractor.eval()
        with torch.inference_mode():
            torch.testing.assert_close(
                extractor(observations), layer_by_layer(observations), atol=1e-3, rtol=1e-3
            )
    other = FeatureExtractor((84, 84, 3), 2, (16, 32, 32, 64), 256)
    extractor.load_state_dict(other.state_dict())
    with torch.inference_mode():
        torch.testing.assert_close(
            extractor(observations), layer_by_layer(observations), atol=1e-3, rtol=1e-3
        )


def test_acting_follows_statistics_that_move_without_the_weights(extractor: FeatureExtractor) -> None:
    observations = images(4)
    found = []
    for seed in range(2):
        extractor.eval()
        with torch.inference_mode():
            found.append(extractor(observations))
        extractor.train()
        extractor(images(8, seed))
    assert not torch.allclose(*found, atol=1e-2)


def test_bfloat16_stays_near_float32(extractor: FeatureExtractor) -> None:
    extractor.train()
    observations = images(16)
    exact, fast = extractor(observations), extractor(observations, torch.bfloat16)
    assert fast.dtype == torch.float32
    cosine = torch.nn.functional.cosine_similarity(exact, fast)
    assert cosine.min() > 0.99


@pytest.mark.parametrize("shape", [(3, 2, 84, 84, 4), (3, 84, 84, 3), (3, 1, 84, 84, 3)])
def test_another_shape_is_refused(extractor: FeatureExtractor, shape: tuple[int, ...]) -> None:
    with pytest.raises(ShapeError, match=r"expected shape \[N, 84, 84, 6\] or \[N, 2, 84, 84, 3\], found"):
        extractor(torch.zeros(shape, dtype=torch.uint8))


@pytest.mark.parametrize("channels", [(4,), (4, 6), (4, 4, 4, 4, 4, 4, 4)])
@pytest.mark.parametrize("frame", [(16, 16, 3), (9, 31, 1), (64, 5, 7)])
def test_pictures_of_any_size_through_any_number_of_layers(
    channels: tuple[int, ...], frame: tuple[int, int, int]
) -> None:
    torch.manual_seed(0)
    extractor = FeatureExtractor(frame, 2, channels, 8)
    height, width, colours = frame
    pictures = torch.randint(0, 256, (5, height, width, 2 * colours), dtype=torch.uint8)
    learned = extractor(pictures)
    assert learned.shape == (5, 8)
    extractor.eval()
    with torch.no_grad():
        acted = extractor(pictures)
        layers = extractor.convolutions(pictures.permute(0, 3, 1, 2).float() - 128)
        torch.testing.assert_close(
            acted,
            torch.nn.functional.layer_norm(extractor.project(layers.flatten(1)), (8,)),
            atol=1e-4,
            rtol=1e-4,
        )
