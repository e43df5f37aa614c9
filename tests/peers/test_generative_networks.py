"""Each generative network against an independent statement of it: numbers of parameters, and one pass by hand."""

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import torch

from motionkit.features import native
from motionkit.features.native import NativeVectors
from motionkit.training.conditions import Conditions, ConditionSizes
from motionkit.training.diffusion.settings import DiffusionConfig, Prediction
from motionkit.training.pose_vectors import VectorScaling
from peers.layers import NetworkInputs, TransformerSizes, diffusion_loss, diffusion_sample
from peers.mdm import MDM, MDM_50, Mdm, MdmNetworkConfig
from peers.mld import MLD, MLD_VAE, Mld, MldNetworkConfig, MldVae, MldVaeNetworkConfig
from peers.motions import MotionBatch, PoseSpace, SampleBatch
from tests.helpers.nerm_corpus import analytic_positions
from tests.peers.plain_transformer import layer, linear, long_skips, part

FPS = Fraction(20)
SIZES = TransformerSizes(3, 16, 2, 24, 0.1)
TEXTS = ConditionSizes(6, ())


def space(numbers: int = 263) -> PoseSpace:
    return PoseSpace(NativeVectors(), VectorScaling(torch.zeros(numbers), torch.ones(numbers)), FPS)


def inputs(
    of: PoseSpace,
    sizes: ConditionSizes,
    earlier: Mapping[str, torch.nn.Module] = {},
    num_windows: int = 7,
) -> NetworkInputs:
    return NetworkInputs(of, sizes, num_windows, earlier)


def count(network: torch.nn.Module) -> int:
    return sum(parameter.numel() for parameter in network.parameters())


def conditions(rows: int, dimension: int = 6) -> Conditions:
    text = torch.randn((rows, dimension), generator=torch.Generator().manual_seed(3))
    return Conditions(text, torch.full((rows,), -1), torch.ones(rows, dtype=torch.bool), torch.ones(rows))


# A layer of width d and inner width f: four d×d maps with biases, two norms, and d×f, f×d with biases.
def encoder_layer_size(d: int, f: int) -> int:
    return 4 * (d * d + d) + 2 * 2 * d + (d * f + f) + (f * d + d)


def decoder_layer_size(d: int, f: int) -> int:
    return encoder_layer_size(d, f) + 4 * (d * d + d) + 2 * d


def test_published_sizes_have_the_published_numbers_of_parameters() -> None:
    """MDM's 17.9 million (its Table 1 of sizes, without CLIP); the others follow from their layers by hand."""
    torch.manual_seed(0)
    for stage in (MDM, MDM_50):
        mdm = Mdm(stage.recipes["paper"]["network"], inputs(space(), ConditionSizes(512, ())))
        by_hand = 2 * (512 * 263) + 512 + 263 + 3 * (512 * 512 + 512) + 8 * encoder_layer_size(512, 1024)
        assert count(mdm) == by_hand == 17_880_327
    vae = MldVae(MLD_VAE.recipes["paper"]["network"], inputs(space(), ConditionSizes(0, ())))
    skips = 4 * (512 * 256 + 256) + 2 * 256
    both = 9 * encoder_layer_size(256, 1024) + 9 * decoder_layer_size(256, 1024) + 2 * skips
    assert count(vae) == 2 * 263 * 256 + 256 + 263 + 2 * 256 + 2 * 500 * 256 + both
    mld = Mld(MLD.recipes["paper"]["network"], inputs(space(), ConditionSizes(768, ()), {"mld-vae": vae}))
    maps = 2 * (768 * 256 + 256) + (256 * 256 + 256) + 3 * 256
    assert count(mld) == maps + 9 * encoder_layer_size(256, 1024) + skips


def test_a_pass_of_mdm_is_the_one_by_hand() -> None:
    torch.manual_seed(1)
    network = Mdm(MdmNetworkConfig(SIZES), inputs(space(), TEXTS)).eval()
    lengths, steps, given = torch.tensor([5, 3]), torch.tensor([7, 900]), conditions(2)
    noisy = torch.randn(2, 5, 263)
    found = network(noisy, steps, given, lengths)
    weights = network.state_dict()
    for row in range(2):
        own = int(lengths[row])

        def position(place: int) -> torch.Tensor:
            angles = [place / 10_000 ** (2 * i / 16) for i in range(8)]
            return torch.tensor([f(angle) for angle in angles for f in (np.sin, np.cos)], dtype=torch.float32)

        time = linear(weights, "step_in.0", position(int(steps[row])))
        first = linear(weights, "step_in.2", time * torch.sigmoid(time)) + linear(weights, "text_in", given.text[row])
        tokens = torch.cat((first[None], linear(weights, "frame_in", noisy[row, :own])))
        tokens = tokens + torch.stack([position(place) for place in range(own + 1)])
        for number in range(3):
            tokens = layer(part(weights, f"layers.layers.{number}."), tokens, heads=2)
        expected = linear(weights, "frame_out", tokens[1:])
        torch.testing.assert_close(found[row, :own], expected, rtol=1e-4, atol=1e-5)


def test_a_pass_of_mlds_vae_is_the_one_by_hand() -> None:
    torch.manual_seed(2)
    vae = MldVae(MldVaeNetworkConfig(SIZES, longest=20), inputs(space(), ConditionSizes(0, ()))).eval()
    lengths, rows = torch.tensor([6, 4]), torch.randn(2, 6, 263)
    batch = MotionBatch(rows, lengths, conditions(2, 0), torch.arange(2), torch.arange(6).expand(2, -1))
    mean, log_variance = vae.encode(rows, lengths)
    made = vae.decode(mean, batch.mask)
    weights = vae.state_dict()
    for row in range(2):
        own = int(lengths[row])
        tokens = torch.cat((weights["distribution"], linear(weights, "frame_in", rows[row, :own])))
        tokens = long_skips(part(weights, "encoder."), tokens + weights["encoder_positions"][: own + 2], 2, 3)
        torch.testing.assert_close(torch.stack((mean[row], log_variance[row])), tokens[:2], rtol=1e-4, atol=1e-5)
        queries = weights["decoder_positions"][:own]
        out = long_skips(part(weights, "decoder."), queries, 2, 3, memory=tokens[:1])
        torch.testing.assert_close(made[row, :own], linear(weights, "frame_out", out), rtol=1e-4, atol=1e-5)
    assert not made[1, 4:].any()


def test_a_pass_of_mlds_denoiser_is_the_one_by_hand() -> None:
    torch.manual_seed(3)
    vae = MldVae(MldVaeNetworkConfig(SIZES, longest=20), inputs(space(), ConditionSizes(0, ())))
    network = Mld(MldNetworkConfig(SIZES, time_features=12), inputs(space(), TEXTS, {"mld-vae": vae})).eval()
    noisy, steps, given = torch.randn(2, 1, 16), torch.tensor([3, 500]), conditions(2)
    found = network(noisy, steps, given)
    weights = network.state_dict()
    assert not [name for name in weights if "vae" in name]
    for row in range(2):
        angles = torch.tensor([int(steps[row]) / 10_000 ** (i / 6) for i in range(6)])
        time = linear(weights, "step_in.0", torch.cat((angles.cos(), angles.sin())))
        time = linear(weights, "step_in.2", time * torch.sigmoid(time))
        text = linear(weights, "text_in.1", given.text[row].clamp(min=0))
        tokens = torch.stack((noisy[row, 0], time, text)) + weights["positions"]
        expected = long_skips(part(weights, "layers."), tokens, 2, 3)
        torch.testing.assert_close(found[row, 0], expected[0], rtol=1e-3, atol=1e-4)


def test_joints_are_those_of_the_vectors() -> None:
    positions = analytic_positions(np.arange(50) / 20, 2)
    vectors = native.vectors(positions, "smpl22", FPS)
    mean, scale = torch.linspace(-1, 1, 263), torch.linspace(0.5, 2, 263)
    of = PoseSpace(NativeVectors(), VectorScaling(mean, scale), FPS)
    found = of.joints(((torch.from_numpy(vectors) - mean) / scale)[None])
    np.testing.assert_allclose(found[0].numpy(), native.positions(vectors, "smpl22", FPS), atol=1e-5)


@pytest.mark.parametrize("sampler", ["ddpm", "ddim"])
def test_guidance_goes_beyond_the_condition(sampler: str) -> None:
    """A network that answers 1 under a condition and 0 without: guided by s it is s."""
    batch = SampleBatch(
        lengths=torch.tensor([3, 2]),
        conditions=conditions(2),
        unconditional=conditions(2).unconditional(),
        generators=[torch.Generator().manual_seed(row) for row in range(2)],
        device=torch.device("cpu"),
    )

    def output(noisy: torch.Tensor, steps: torch.Tensor, told: Conditions) -> torch.Tensor:
        return told.given[:, None, None].float().expand(noisy.shape)

    config = DiffusionConfig(
        num_steps=8, schedule="cosine", prediction="latent", sampler=sampler, sampling_steps=8, guidance_scale=2.5
    )
    found = diffusion_sample(output, batch, lambda: batch.noise_within(batch.lengths, 4), config)
    torch.testing.assert_close(found, torch.full((2, 3, 4), 2.5, dtype=torch.float64))
    plain = diffusion_sample(
        output, batch, lambda: batch.noise_within(batch.lengths, 4), replace(config, guidance_scale=1.0)
    )
    torch.testing.assert_close(plain, torch.ones((2, 3, 4), dtype=torch.float64))


@pytest.mark.parametrize("prediction", ["noise", "latent", "velocity"])
@pytest.mark.parametrize("sampler", ["ddpm", "ddim"])
def test_nothing_is_copied_from_the_device_in_a_step(sampler: str, prediction: Prediction) -> None:
    """A tensor on torch's device "meta" has no values, so copying it to the CPU is an error."""
    device = torch.device("meta")
    config = DiffusionConfig(
        num_steps=8, schedule="cosine", prediction=prediction, sampler=sampler, sampling_steps=8, guidance_scale=2.5
    )

    def output(noisy: torch.Tensor, steps: torch.Tensor, told: Conditions) -> torch.Tensor:
        assert {noisy.device, steps.device, told.given.device} == {device}
        return noisy

    clean, mask = torch.zeros(2, 3, 4, device=device), torch.ones(2, 3, dtype=torch.bool, device=device)
    loss = diffusion_loss(output, clean, mask, conditions(2).to(device), config, torch.Generator())
    assert loss.device == device
    batch = SampleBatch(
        lengths=torch.tensor([3, 2]),
        conditions=conditions(2),
        unconditional=conditions(2),
        generators=[torch.Generator() for _ in range(2)],
        device=device,
    )
    found = diffusion_sample(output, batch, lambda: batch.noise_within(batch.lengths, 4), config)
    assert (found.device, found.dtype, found.shape) == (device, torch.float64, (2, 3, 4))
