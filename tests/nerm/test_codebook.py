import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch

import nerm.codebook
from motionkit.core.errors import UsageError
from motionkit.fields.motion_field import to_motion
from motionkit.fields.resample import resample_positions
from motionkit.store.writer import StoreWriter
from motionkit.training.config import apply_overrides
from motionkit.training.loop import step_generator
from motionkit.training.run import RunFolder
from motionkit.training.stage import StageContext
from motionkit.training.tensors import CheckpointError
from nerm.codebook import (
    PUBLISHED,
    CodebookNetwork,
    CodebookTraining,
    Quantiser,
    VectorCorpus,
    check_lengths,
    codebook_vectors,
    joint_positions_block,
    load_codes,
    load_published,
    perplexity,
    train_codebook,
    vector_corpus,
    write_vectors,
)
from nerm.recipes import nano, paper
from nerm.settings import CodebookConfig, CodebookNetworkConfig
from tests.helpers.analytic import analytic_motion
from tests.helpers.nerm_corpus import analytic_positions, analytic_source

SMALL = apply_overrides(
    CodebookConfig(window_frames=16),
    [
        "network.width=24",
        "network.code_dimension=16",
        "network.num_codes=32",
        "schedule.batch_size=16",
        "schedule.steps=40",
        "schedule.learning_rate=0.002",
        "schedule.drop_at=1000",
    ],
)


def _corpus(path: Path) -> VectorCorpus:
    write_vectors(analytic_source(), SMALL, path / "vectors.f32")
    return vector_corpus(analytic_source(), SMALL, path / "vectors.f32")


def _training(path: Path) -> CodebookTraining:
    return CodebookTraining(_corpus(path), SMALL, seed=0, device=torch.device("cpu"))


def test_the_paper_s_codebook_is_t2m_gpt_s() -> None:
    config = paper().codebook
    sizes = config.network
    assert (sizes.num_codes, sizes.code_dimension, sizes.width, config.window_frames) == (512, 512, 512, 64)
    network = CodebookNetwork(sizes, 263)
    # T2M-GPT's VQVAE_251 with these widths: 3 + 1 residual depth, counted from its published layer shapes.
    convolutions = [module for module in network.modules() if isinstance(module, torch.nn.Conv1d)]
    assert len(convolutions) == 2 * (2 * (1 + 2 * 3)) + 2 + 3
    dilations = [module.dilation[0] for module in network.encoder.modules() if isinstance(module, torch.nn.Conv1d)]
    assert [dilation for dilation in dilations if dilation > 1] == [9, 3, 9, 3]


@pytest.mark.parametrize("frames", [16, 64])
def test_time_is_shortened_four_times_and_brought_back(frames: int) -> None:
    network = CodebookNetwork(SMALL.network, 133)
    features = network.encode(torch.randn(2, frames, 133))
    assert features.shape == (2, 16, frames // 4)
    assert network.decode(features).shape == (2, frames, 133)


def test_features_become_their_nearest_codes_and_gradients_pass() -> None:
    quantiser = Quantiser(SMALL.network)
    quantiser.start(torch.randn(8, 16, 10), torch.Generator().manual_seed(0))
    features = torch.randn(3, 16, 5, requires_grad=True)
    quantised = quantiser(features)
    distances = torch.cdist(features.detach().transpose(1, 2).reshape(-1, 16), quantiser.codes)
    assert torch.equal(quantised.which.reshape(-1), distances.argmin(1))
    expected = quantiser.codes[quantised.which].transpose(1, 2)
    torch.testing.assert_close(quantised.values.detach(), expected)
    quantised.values.sum().backward()
    torch.testing.assert_close(features.grad, torch.ones_like(features))


def test_codes_move_to_the_mean_of_what_chooses_them_and_unused_ones_are_reset() -> None:
    quantiser = Quantiser(replace(SMALL.network, num_codes=3, code_dimension=2))
    quantiser.codes.copy_(torch.tensor([[0.0, 0.0], [10.0, 10.0], [99.0, 99.0]]))
    quantiser.sums.copy_(quantiser.codes)
    features = torch.tensor([[1.0, 1.0], [1.0, 1.0], [9.0, 9.0], [9.0, 9.0]]).T[None]
    for _ in range(1500):
        quantiser.update(features, quantiser(features).which, torch.Generator().manual_seed(0))
    codes = {tuple(code) for code in quantiser.codes.round(decimals=3).tolist()}
    assert codes == {(1.0, 1.0), (9.0, 9.0)}


def test_vectors_are_the_same_wherever_and_whichever_way_a_body_goes() -> None:
    positions = analytic_positions(np.arange(40) / 20, 1)
    turn = np.array([[np.cos(1.1), 0, np.sin(1.1)], [0, 1, 0], [-np.sin(1.1), 0, np.cos(1.1)]])
    elsewhere = (positions @ turn.T + [3.0, 0.0, -1.0]).astype(np.float32)
    vectors = codebook_vectors(positions, Fraction(20))
    assert vectors.shape == (39, 133)
    np.testing.assert_allclose(codebook_vectors(elsewhere, Fraction(20)), vectors, atol=2e-4)
    # It walks at 0.5 m/s towards where it faces on average.
    assert vectors[:, 2].mean() == pytest.approx(0.5, abs=0.1)
    assert vectors[:, joint_positions_block(22)].shape == (39, 63)


def test_the_corpus_is_resampled_and_starts_stay_inside_a_sequence(tmp_path: Path) -> None:
    source = analytic_source()
    corpus = _corpus(tmp_path)
    rows = [80] * 4
    assert len(corpus.vectors) == sum(rows)
    assert len(corpus.first_rows) == sum(length - SMALL.window_frames + 1 for length in rows)
    first = resample_positions(source.positions[: source.num_frames[0]], Fraction(120), Fraction(20))
    np.testing.assert_array_equal(corpus.vectors[:80], codebook_vectors(first, Fraction(20)))
    windows = corpus.windows(torch.arange(len(corpus.first_rows)), SMALL.window_frames)
    assert windows.shape[1:] == (16, 133)
    assert abs(float(windows.mean())) < 0.2
    written = (tmp_path / "vectors.f32").stat().st_ino
    np.testing.assert_array_equal(_corpus(tmp_path).vectors, corpus.vectors)
    assert (tmp_path / "vectors.f32").stat().st_ino == written


def test_sequences_that_are_all_too_short_are_explained() -> None:
    with pytest.raises(UsageError, match="window_frames"):
        check_lengths(analytic_source(), replace(SMALL, window_frames=400))


def test_the_loss_falls_and_many_codes_are_used(tmp_path: Path) -> None:
    training = _training(tmp_path)
    figures = [training.step(step, step_generator(0, "codebook", step)) for step in range(SMALL.schedule.steps)]
    losses = [float(each["reconstruction"].detach()) for each in figures]
    assert np.mean(losses[-5:]) < 0.6 * np.mean(losses[:5])
    assert float(figures[-1]["perplexity"]) > 8


def test_perplexity_counts_codes_in_use() -> None:
    assert float(perplexity(torch.arange(8).repeat(3), 20)) == pytest.approx(8.0)
    assert float(perplexity(torch.zeros(9, dtype=torch.int64), 20)) == pytest.approx(1.0)


PUBLISHED_SMALL = CodebookNetworkConfig(width=10, code_dimension=8, num_codes=24)


def convolution(out: int, channels: int, size: int, rng: np.random.Generator) -> dict[str, torch.Tensor]:
    weight = rng.normal(0, (channels * size) ** -0.5, (out, channels, size))
    return {"weight": torch.tensor(weight).float(), "bias": torch.tensor(rng.normal(0, 0.1, out)).float()}


def published_state(config: CodebookNetworkConfig, numbers: int = 263) -> dict[str, torch.Tensor]:
    """A state dict with the names and shapes of models/vqvae.py (HumanVQVAE), down_t 2, depth 3, no norm."""
    rng, width = np.random.default_rng(0), config.width
    layers = {"encoder.model.0": (width, numbers, 3), "encoder.model.4": (config.code_dimension, width, 3)}
    layers |= {"decoder.model.0": (width, config.code_dimension, 3), "decoder.model.4": (width, width, 3)}
    layers["decoder.model.6"] = (numbers, width, 3)
    for block in (2, 3):
        layers[f"encoder.model.{block}.0"] = (width, width, 4)
        layers[f"decoder.model.{block}.2"] = (width, width, 3)
        for depth in range(3):
            for stack in (f"encoder.model.{block}.1", f"decoder.model.{block}.0"):
                layers[f"{stack}.model.{depth}.conv1"] = (width, width, 3)
                layers[f"{stack}.model.{depth}.conv2"] = (width, width, 1)
    state = {
        f"vqvae.{name}.{part}": tensor
        for name, shape in layers.items()
        for part, tensor in convolution(*shape, rng).items()
    }
    codes = torch.tensor(rng.normal(0, 0.3, (config.num_codes, config.code_dimension))).float()
    return {**state, "vqvae.quantizer.codebook": codes}


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    torch.save({"net": published_state(PUBLISHED_SMALL)}, tmp_path / "net_last.pth")
    return tmp_path / "net_last.pth"


def plain_convolution(
    x: np.ndarray, state: dict[str, torch.Tensor], name: str, *, stride: int = 1, padding: int = 1, dilation: int = 1
) -> np.ndarray:
    """y[o, t] = b[o] + Σ_{c, k} w[o, c, k] · x[c, stride · t + dilation · k − padding], in float64."""
    weight, bias = (state[f"vqvae.{name}.{part}"].double().numpy() for part in ("weight", "bias"))
    padded = np.pad(x, ((0, 0), (padding, padding)))
    frames = (padded.shape[1] - dilation * (weight.shape[2] - 1) - 1) // stride + 1
    taps = [padded[:, dilation * k : dilation * k + stride * (frames - 1) + 1 : stride] for k in range(weight.shape[2])]
    return bias[:, None] + np.einsum("ock,kct->ot", weight, np.stack(taps))


def plain_stack(x: np.ndarray, state: dict[str, torch.Tensor], name: str) -> np.ndarray:
    """Resnet1D with reversed dilations: 9, 3, 1."""
    for depth, dilation in enumerate((9, 3, 1)):
        inner = plain_convolution(
            np.maximum(x, 0), state, f"{name}.model.{depth}.conv1", padding=dilation, dilation=dilation
        )
        x = x + plain_convolution(np.maximum(inner, 0), state, f"{name}.model.{depth}.conv2", padding=0)
    return x


def plain_encode(vectors: np.ndarray, state: dict[str, torch.Tensor]) -> np.ndarray:
    x = np.maximum(plain_convolution(vectors.T, state, "encoder.model.0"), 0)
    for block in (2, 3):
        x = plain_convolution(x, state, f"encoder.model.{block}.0", stride=2)
        x = plain_stack(x, state, f"encoder.model.{block}.1")
    return plain_convolution(x, state, "encoder.model.4")


def plain_decode(features: np.ndarray, state: dict[str, torch.Tensor]) -> np.ndarray:
    x = np.maximum(plain_convolution(features, state, "decoder.model.0"), 0)
    for block in (2, 3):
        x = np.repeat(plain_stack(x, state, f"decoder.model.{block}.0"), 2, axis=1)
        x = plain_convolution(x, state, f"decoder.model.{block}.2")
    x = np.maximum(plain_convolution(x, state, "decoder.model.4"), 0)
    return plain_convolution(x, state, "decoder.model.6").T


def test_it_encodes_and_decodes_as_its_names_say(checkpoint: Path) -> None:
    state, published = published_state(PUBLISHED_SMALL), load_published(checkpoint, config=PUBLISHED_SMALL)
    vectors = np.random.default_rng(1).normal(size=(32, 263))
    read = torch.from_numpy(vectors).float()[None]
    expected = plain_encode(vectors, state)
    features = published.encode(read)
    np.testing.assert_allclose(features[0].numpy(), expected, atol=1e-5)
    codes = state["vqvae.quantizer.codebook"].double().numpy()
    nearest = np.square(expected.T[:, None] - codes).sum(-1).argmin(1)
    quantised = published.quantiser(features)
    np.testing.assert_array_equal(quantised.which[0].numpy(), nearest)
    decoded = published.decode(quantised.values)
    np.testing.assert_allclose(decoded[0].numpy(), plain_decode(codes[nearest].T, state), atol=1e-5)


def test_the_published_sizes_are_the_paper_s() -> None:
    names = published_state(replace(PUBLISHED, width=1, code_dimension=1, num_codes=1)).keys()
    with torch.device("meta"):
        network = CodebookNetwork(PUBLISHED, 263)
    sizes = [parameter.numel() for parameter in network.parameters()]
    assert len(sizes) + 1 == len(names)
    assert sum(sizes) == sum(
        out * (channels * size + 1)
        for out, channels, size in [
            *[(512, 263, 3), (512, 512, 3), (512, 512, 3), (512, 512, 3), (263, 512, 3)],
            *2 * [(512, 512, 4), (512, 512, 3), *2 * 3 * [(512, 512, 3), (512, 512, 1)]],
        ]
    )


def broken(change: Callable[[dict[str, torch.Tensor]], object]) -> dict[str, torch.Tensor]:
    state = published_state(PUBLISHED_SMALL)
    change(state)
    return state


FIRST, LAST, CODES = "vqvae.encoder.model.0.weight", "vqvae.decoder.model.6.bias", "vqvae.quantizer.codebook"
FAULTS = {
    "another input": (lambda s: s.update({FIRST: torch.zeros(10, 66, 3)}), FIRST),
    "no input": (lambda s: s.pop(FIRST), FIRST),
    "a lost tensor": (lambda s: s.pop(LAST), LAST),
    "a norm": (lambda s: s.update({"vqvae.encoder.model.9.weight": torch.zeros(3)}), "model.9.weight"),
    "a shape": (lambda s: s.update({LAST: torch.zeros(5)}), LAST),
    "not finite": (lambda s: s[LAST].fill_(torch.nan), LAST),
    "never trained": (lambda s: s[CODES].zero_(), "copies"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_what_is_not_that_checkpoint_is_refused(tmp_path: Path, name: str) -> None:
    change, named = FAULTS[name]
    torch.save({"net": broken(change)}, tmp_path / "net_last.pth")
    with pytest.raises(CheckpointError, match=named):
        load_published(tmp_path / "net_last.pth", config=PUBLISHED_SMALL)


class Program:
    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (Path("executed"),))


def test_a_file_that_would_run_something_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    torch.save({"net": Program()}, tmp_path / "net_last.pth")
    with pytest.raises(CheckpointError, match="without running its pickle"):
        load_published(tmp_path / "net_last.pth", config=PUBLISHED_SMALL)
    assert not (tmp_path / "executed").exists()


def test_the_stage_takes_it_in_place_of_training(
    tmp_path: Path, checkpoint: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    performance = analytic_motion("walk", 2.0)
    with StoreWriter.create(tmp_path / "store") as writer:
        writer.add(replace(to_motion(performance, Fraction(20)), sequence_id="m", split="train"))
    loads = load_published
    monkeypatch.setattr(nerm.codebook, "load_published", lambda *places: loads(*places, config=PUBLISHED_SMALL))
    codebook = apply_overrides(nano().codebook, [f"published.weights={checkpoint!s}"])
    refused = replace(nano(), codebook=apply_overrides(codebook, [f"published.weights={tmp_path / 'absent.pth'!s}"]))
    context = StageContext(store=tmp_path / "store", run=RunFolder(tmp_path / "run"), recipe="nano")
    with pytest.raises(CheckpointError, match="no such file"):
        train_codebook(context, refused)
    assert not (tmp_path / "run").exists()
    train_codebook(context, replace(nano(), codebook=codebook))
    torch.testing.assert_close(
        load_codes(tmp_path / "run"), published_state(PUBLISHED_SMALL)["vqvae.quantizer.codebook"]
    )
    summary = json.loads((tmp_path / "run" / "codebook" / "summary.json").read_text())
    assert (summary["codes"], summary["from"]) == (24, str(checkpoint))
