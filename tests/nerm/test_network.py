"""NeRM's networks: coordinates, CCA, the decoder and the denoiser."""

import pytest
import torch

from motionkit.training.config import apply_overrides
from motionkit.training.networks import Conditions, ConditionSizes
from nerm.latents import ALWAYS, in_use
from nerm.network import CodebookCoordinateAttention, Denoiser, FieldNetwork, Linear, attention
from nerm.recipes import RECIPES, EncoderConfig, FieldConfig, TransformerConfig
from tests.nerm.small_fields import changed

TINY = changed(
    FieldConfig(),
    "latents.dimension=32 latents.knots=8 latents.knot_numbers=4 latents.path_knots=4 encoder.num_queries=8 "
    "encoder.num_frequencies=8 decoder.width=24 decoder.num_layers=3 schedule.epochs=none schedule.steps=1",
)
CODES = torch.randn(20, 12, generator=torch.Generator().manual_seed(5))
LOCAL = ("latents.layout=local", "loss.scaling=group")
VARIANTS = {
    "paper": (),
    "no time encoding": ("encoder.kind=none",),
    "raw time": ("encoder.kind=raw",),
    "raw time, local": ("encoder.kind=raw", *LOCAL),
    "fourier": ("encoder.kind=fourier",),
    "frame numbers": ("encoder.coordinates=frames",),
    "transformer": ("decoder.kind=transformer",),
    "one bank": LOCAL,
    "banks": (*LOCAL, "latents.knots=8,4", "latents.knot_numbers=3,5"),
}


def _network(*changes: str) -> FieldNetwork:
    torch.manual_seed(0)
    return FieldNetwork(apply_overrides(TINY, changes), 66, CODES).eval()


def _clips(network: FieldNetwork, batch: int = 5, poses: int = 7) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    dimension = TINY.latents.dimension if network.local is None else network.local.dimension
    latents = torch.randn(batch, dimension, generator=generator)
    frames = torch.randint(0, 40, (batch, poses), generator=generator)
    fps = torch.tensor([20.0, 30.0, 60.0, 120.0, 100.0], dtype=torch.float64)[:batch]
    return latents, -1 + 2 * frames / fps[:, None] / TINY.windows.max_duration_seconds, fps


@pytest.mark.parametrize("name", [name for name in VARIANTS if name != "transformer"])
def test_a_pose_depends_on_its_own_coordinate_latent_and_framerate_alone(name: str) -> None:
    network = _network(*VARIANTS[name])
    latents, coordinates, fps = _clips(network)
    together = network(latents, coordinates, fps)
    for clip in range(5):
        for pose in range(7):
            alone = network(
                latents[clip : clip + 1], coordinates[clip : clip + 1, pose : pose + 1], fps[clip : clip + 1]
            )
            torch.testing.assert_close(alone[0, 0], together[clip, pose], atol=2e-6, rtol=1e-4)


def test_through_a_context_a_transformers_pose_depends_on_nothing_else_either() -> None:
    network = _network(*VARIANTS["transformer"])
    latents, coordinates, fps = _clips(network)

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


def test_the_decoder_is_the_paper_s() -> None:
    config = RECIPES["paper"]().field
    decoder, encoder = config.decoder, config.encoder
    assert (decoder.width, decoder.num_layers, decoder.activation, config.latents.dimension) == (1024, 9, "relu", 256)
    assert (encoder.num_queries, encoder.num_frequencies, encoder.num_heads, encoder.num_layers) == (256, 64, 4, 3)
    assert (config.schedule.batch_size, config.schedule.learning_rate) == (4096, 1e-4)
    assert (config.loss.kl_weight, config.latents.layout) == (1e-4, "global")


def test_a_local_latent_means_the_same_at_every_knot() -> None:
    network = _network(*LOCAL, "latents.knots=16", "latents.path_knots=16")
    assert network.local is not None
    banks = [torch.randn(1, bank.num_knots, bank.numbers) for bank in network.local.banks]
    later_banks = [torch.roll(knots, 2, dims=1) for knots in banks]
    t = torch.tensor([[-0.1]], dtype=torch.float64)
    fps = torch.tensor([30.0], dtype=torch.float64)
    here = network(network.local.join(banks), t, fps)
    later = network(network.local.join(later_banks), t + 0.25, fps)
    torch.testing.assert_close(here, later, atol=1e-5, rtol=1e-4)


LAYOUT = ConditionSizes(text_dimension=3, actions=("a", "b", "c"))


def test_paper_sizes() -> None:
    torch.manual_seed(0)
    denoiser = Denoiser(TransformerConfig(), torch.full((256,), ALWAYS), ConditionSizes(768, ()))
    assert len(denoiser.layers) == 9
    assert len(denoiser.skips) == 4
    per_layer = 4 * 256 * 256 + 2 * 256 * 1024
    assert sum(w.numel() for w in denoiser.layers.parameters() if w.dim() == 2) == 9 * per_layer
    assert sum(w.numel() for w in denoiser.skips.parameters() if w.dim() == 2) == 4 * 512 * 256


@pytest.mark.parametrize("num_tokens", [1, 4, 8])
def test_every_input_reaches_every_number(num_tokens: int) -> None:
    torch.manual_seed(0)
    config = TransformerConfig(3, 32, 2, 64, 0.0, num_tokens)
    denoiser = Denoiser(config, torch.full((8,), ALWAYS), LAYOUT)
    latents = torch.randn(2, 8, requires_grad=True)
    text, duration = torch.randn(2, 3, requires_grad=True), torch.rand(2, requires_grad=True)
    noise = denoiser(latents, torch.tensor([0, 999]), Conditions.zero_masked(text, torch.tensor([0, 2]), duration))
    assert noise.shape == (2, 8)
    for row in range(2):
        for number in range(8):
            gradients = torch.autograd.grad(noise[row, number], (latents, text, duration), retain_graph=True)
            for gradient in gradients:
                assert gradient[row].abs().min() > 0
                assert not gradient[1 - row].any()


def test_what_a_motion_does_not_depend_on_is_neither_read_nor_put_out() -> None:
    """A motion of 0.4 l_max reads 9 of 16 numbers: the other half may hold anything."""
    torch.manual_seed(0)
    first_read = torch.linspace(-0.4, 0.95, 16)
    denoiser = Denoiser(TransformerConfig(3, 32, 2, 64, 0.0, 4), first_read, LAYOUT)
    latents, steps = torch.randn(3, 16), torch.tensor([0, 500, 999])
    conditions = Conditions.zero_masked(torch.zeros(3, 3), torch.tensor([0, 1, 2]), torch.tensor([0.4, 0.4, 1.0]))
    used = in_use(first_read, conditions.duration)
    assert used.sum(dim=1).tolist() == [9, 9, 16]
    out = denoiser(latents, steps, conditions)
    assert not out[~used].any()
    assert out[used].abs().min() > 0
    changed = denoiser(torch.where(used, latents, torch.full_like(latents, 100.0)), steps, conditions)
    torch.testing.assert_close(changed, out, rtol=0, atol=0)
    alone = denoiser(latents[:1], steps[:1], conditions.rows(slice(0, 1)))
    torch.testing.assert_close(alone, out[:1], rtol=1e-5, atol=1e-6)


def test_attention_in_bfloat16_is_that_in_float32() -> None:
    heads = torch.randn(3, 5, 2, 7, 16, generator=torch.Generator().manual_seed(0)).to(torch.bfloat16)
    seen = torch.arange(7)[None, None, None] < torch.tensor([7, 6, 4, 2, 1])[:, None, None, None]
    for mask in (None, seen):
        found, expected = attention(*heads, mask), attention(*heads.float(), mask)
        assert found.dtype == torch.bfloat16
        torch.testing.assert_close(found.float(), expected, atol=0.02, rtol=0.02)


@pytest.mark.parametrize("shape", [(3, 8), (40, 8), (2, 30, 8)])
def test_a_product_without_gradients_is_that_with_them(shape: tuple[int, ...]) -> None:
    linear, x = Linear(8, 5), torch.randn(shape)
    with torch.no_grad():
        found = linear(x)
    torch.testing.assert_close(found, linear(x).detach())
    (gradient,) = torch.autograd.grad(linear(x).sum(), linear.bias)
    torch.testing.assert_close(gradient, torch.full((5,), x.numel() / 8))


def test_prototypes_follow_their_weights() -> None:
    attention = CodebookCoordinateAttention(torch.randn(5, 3), EncoderConfig(num_frequencies=4, num_queries=3))
    names = set(attention.state_dict())
    with torch.no_grad():
        first = attention.prototypes()
        assert attention.prototypes() is first and set(attention.state_dict()) == names
        attention.query_embeddings += 1.0
        changed = attention.prototypes()
        attention.load_state_dict({name: 2.0 * tensor for name, tensor in attention.state_dict().items()})
        loaded = attention.prototypes()
    assert not torch.allclose(first, changed) and not torch.allclose(changed, loaded)
    torch.testing.assert_close(loaded, attention.prototypes().detach())
    attention.prototypes().sum().backward()
    assert attention.query_embeddings.grad is not None
