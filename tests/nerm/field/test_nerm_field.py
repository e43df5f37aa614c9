import pytest
import torch

from motionkit.training.config import apply_overrides
from nerm.coordinates import (
    CodebookCoordinateAttention,
    FourierFeatures,
    distinct,
    frame_numbers,
    framerate_number,
    rounded_up,
)
from nerm.field.network import FieldNetwork
from nerm.recipes import RECIPES
from nerm.settings import FieldConfig

TINY = apply_overrides(
    FieldConfig(),
    [
        "latents.dimension=32",
        "latents.knots=8",
        "latents.knot_numbers=4",
        "encoder.num_queries=8",
        "encoder.num_frequencies=8",
        "decoder.width=24",
        "decoder.num_layers=3",
        "schedule.epochs=none",
        "schedule.steps=1",
    ],
)
CODES = torch.randn(20, 12, generator=torch.Generator().manual_seed(5))
LOCAL = "latents.layout=local"
VARIANTS = {
    "paper": (),
    "local": (LOCAL,),
    "no time encoding": ("encoder.kind=none",),
    "no time encoding, local": ("encoder.kind=none", LOCAL),
    "raw time": ("encoder.kind=raw",),
    "raw time, local": ("encoder.kind=raw", LOCAL),
    "fourier": ("encoder.kind=fourier",),
    "frame numbers": ("encoder.coordinates=frames",),
    "transformer": ("decoder.kind=transformer",),
    "linear path": ("decoder.linear_path=true", LOCAL),
    "banks": (
        LOCAL,
        f"latents.dimension={8 * 3 + 4 * 5}",
        "latents.knots=8,4",
        "latents.knot_numbers=3,5",
        "latents.kernel=lanczos",
        "decoder.linear_path=true",
    ),
    "body path": (
        LOCAL,
        f"latents.dimension={8 * 3 + 4 * 3}",
        "latents.knot_numbers=3",
        "latents.path_knots=4",
        "loss.scaling=group",
        "decoder.linear_path=true",
    ),
}


def _network(*changes: str) -> FieldNetwork:
    torch.manual_seed(0)
    return FieldNetwork(apply_overrides(TINY, changes), 66, CODES).eval()


def _clips(
    batch: int = 5, poses: int = 7, dimension: int = TINY.latents.dimension
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    latents = torch.randn(batch, dimension, generator=generator)
    frames = torch.randint(0, 40, (batch, poses), generator=generator)
    fps = torch.tensor([20.0, 30.0, 60.0, 120.0, 100.0], dtype=torch.float64)[:batch]
    return latents, -1 + 2 * frames / fps[:, None] / TINY.windows.max_duration_seconds, fps


@pytest.mark.parametrize("name", VARIANTS)
def test_every_variant_decodes_clips(name: str) -> None:
    network = _network(*VARIANTS[name])
    latents, coordinates, fps = _clips(dimension=network.config.latents.dimension)
    vectors = network(latents, coordinates, fps)
    assert vectors.shape == (5, 7, 66)
    vectors.square().mean().backward()
    without = [name for name, weight in network.named_parameters() if weight.grad is None]
    assert without == []


@pytest.mark.parametrize("name", [name for name in VARIANTS if name != "transformer"])
def test_a_pose_depends_on_its_own_coordinate_latent_and_framerate_alone(name: str) -> None:
    network = _network(*VARIANTS[name])
    latents, coordinates, fps = _clips(dimension=network.config.latents.dimension)
    together = network(latents, coordinates, fps)
    for clip in range(5):
        for pose in range(7):
            alone = network(
                latents[clip : clip + 1], coordinates[clip : clip + 1, pose : pose + 1], fps[clip : clip + 1]
            )
            torch.testing.assert_close(alone[0, 0], together[clip, pose], atol=2e-6, rtol=1e-4)


def test_through_a_context_a_transformers_pose_depends_on_nothing_else_either() -> None:
    network = _network(*VARIANTS["transformer"])
    latents, coordinates, fps = _clips(dimension=network.config.latents.dimension)

    def decoded(poses: list[int], num_context: int) -> torch.Tensor:
        encoded = network.encode_coordinates(coordinates[:, poses], fps)
        return network.decode(latents, encoded, fps, num_context)

    together = decoded([0, 1, 2, 3, 4, 5, 6], 3)
    for pose in (3, 4, 5, 6):
        torch.testing.assert_close(decoded([0, 1, 2, pose], 3)[:, 3], together[:, pose], atol=2e-6, rtol=1e-4)
    # The context sees itself alone, and another context is another motion.
    torch.testing.assert_close(together[:, :3], decoded([0, 1, 2], 0), atol=2e-6, rtol=1e-4)
    assert (decoded([0, 1, 4], 2)[:, 2] - together[:, 4]).abs().max() > 1e-3
    assert (decoded([0, 1, 2, 3, 4, 5, 6], 0)[:, 6] - together[:, 6]).abs().max() > 1e-3


def test_without_any_time_a_window_is_one_pose() -> None:
    network = _network("encoder.kind=none")
    vectors = network(*_clips())
    torch.testing.assert_close(vectors, vectors[:, :1].expand_as(vectors))
    moving = _network("encoder.kind=raw")(*_clips())
    assert float(moving.detach().std(dim=1).mean()) > 1e-4


def test_attention_once_per_distinct_coordinate_equals_attention_per_clip() -> None:
    network = _network()
    assert network.fourier is not None
    assert network.attention is not None
    _, coordinates, fps = _clips()
    encoded = network.encode_coordinates(coordinates, fps)
    assert encoded.features is not None
    assert len(encoded.features) < coordinates.numel()
    per_clip = torch.stack([network.attention(network.fourier(clip)) for clip in coordinates])
    torch.testing.assert_close(encoded.features[encoded.which], per_clip, atol=1e-6, rtol=1e-5)


def test_the_codebook_is_frozen_and_travels_with_the_weights() -> None:
    network = _network()
    assert "attention.codebook" in network.state_dict()
    assert "attention.codebook" not in dict(network.named_parameters())
    with pytest.raises(ValueError, match="needs a trained codebook"):
        FieldNetwork(TINY, 66)


def test_attention_adds_to_the_features() -> None:
    attention = CodebookCoordinateAttention(CODES, width=16, num_queries=8, heads=4, layers=3)
    for weight in (attention.to_prototypes.merge, attention.to_prototypes.feed_forward[2]):
        torch.nn.init.zeros_(weight.weight)
        torch.nn.init.zeros_(weight.bias)
    features = torch.randn(11, 16)
    torch.testing.assert_close(attention(features), features)


def test_the_decoder_is_the_paper_s() -> None:
    config = RECIPES["paper"]().field
    decoder, encoder = config.decoder, config.encoder
    assert (decoder.width, decoder.num_layers, decoder.activation, config.latents.dimension) == (1024, 9, "relu", 256)
    assert (encoder.num_queries, encoder.query_width, encoder.num_heads, encoder.num_layers) == (256, 128, 4, 3)
    assert (config.schedule.batch_size, config.schedule.learning_rate) == (4096, 1e-4)
    assert (config.loss.kl_weight, config.latents.layout) == (1e-4, "global")


def test_instants_reached_at_two_framerates_are_one_coordinate() -> None:
    seconds = torch.tensor([[k / 30 for k in range(4)], [4 * k / 120 for k in range(4)]], dtype=torch.float64)
    values, which = distinct(-1 + 2 * seconds / 10)
    assert len(values) == 4
    assert torch.equal(which[0], which[1])


def test_frame_numbers_count_from_one_at_each_clip_s_framerate() -> None:
    coordinates = torch.tensor([[-1.0, -1.0 + 0.2 / 20], [-1.0, 1.0]], dtype=torch.float64)
    numbers = frame_numbers(coordinates, torch.tensor([20.0, 120.0], dtype=torch.float64), 10.0)
    torch.testing.assert_close(numbers, torch.tensor([[1.0, 2.0], [1.0, 1201.0]], dtype=torch.float64))


def test_framerates_enter_by_their_logarithm() -> None:
    numbers = framerate_number(torch.tensor([20.0, 40.0, 160.0], dtype=torch.float64), 0.5)
    assert numbers.tolist() == [0.0, 0.5, 1.5]


def test_periodic_fourier_features_have_no_seam() -> None:
    period = 0.125
    features = FourierFeatures(16, 20.0, period)
    t = torch.rand(9, dtype=torch.float64)
    torch.testing.assert_close(features(t), features(t + 3 * period), atol=1e-5, rtol=0)


def test_a_local_latent_means_the_same_at_every_knot() -> None:
    network = _network(LOCAL)
    latents = torch.randn(1, 8, 4)
    spacing = 2 / 8
    t = torch.tensor([[-1 + 2.3 * spacing]], dtype=torch.float64)
    fps = torch.tensor([30.0], dtype=torch.float64)
    here = network(latents.flatten(1), t, fps)
    later = network(torch.roll(latents, 2, dims=1).flatten(1), t + 2 * spacing, fps)
    torch.testing.assert_close(here, later, atol=1e-5, rtol=1e-4)


def test_few_shapes_of_coordinates_and_the_same_answers() -> None:
    counts = [len(rounded_up(torch.arange(count, dtype=torch.float64))) for count in range(1, 3000)]
    assert all(count <= rounded <= 1.125 * count + 1 for count, rounded in enumerate(counts, start=1))
    assert len(set(counts)) < 80
    values = torch.tensor([0.1, 0.2, 0.5] * 11, dtype=torch.float64)
    torch.testing.assert_close(rounded_up(values)[:33], values)
    assert rounded_up(values)[33:].tolist() == [0.5] * 3
