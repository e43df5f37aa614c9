from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch

from motionkit.fields.motion_field import to_motion
from motionkit.fields.resample import resample_positions
from motionkit.store.writer import StoreWriter
from motionkit.training.config import apply_overrides
from motionkit.training.loop import CheckpointError, load_tensors, step_generator
from motionkit.training.run import RunFolder, StageContext
from nerm.codebook import (
    CodebookNetwork,
    CodebookTraining,
    Quantiser,
    codebook_vectors,
    load_published,
    train_codebook,
    vector_corpus,
)
from nerm.recipes import CodebookConfig, nano, paper
from tests.helpers.analytic import analytic_motion
from tests.helpers.nerm_corpus import analytic_positions, analytic_source
from tests.nerm.small_fields import changed

SMALL = changed(
    CodebookConfig(window_frames=16),
    "network.width=24 network.num_codes=32 schedule.batch_size=16 schedule.steps=40 "
    "schedule.learning_rate=0.002 schedule.kind=constant",
)


def _training() -> CodebookTraining:
    return CodebookTraining(vector_corpus(analytic_source(), SMALL), SMALL, seed=0, device=torch.device("cpu"))


def test_the_paper_s_codebook_is_t2m_gpt_s() -> None:
    config = paper().codebook
    sizes = config.network
    assert (sizes.num_codes, sizes.width, config.window_frames) == (512, 512, 64)
    network = CodebookNetwork(sizes, 263)
    # T2M-GPT's VQVAE_251 with these widths: 3 + 1 residual depth, counted from its published layer shapes.
    convolutions = [module for module in network.modules() if isinstance(module, torch.nn.Conv1d)]
    assert len(convolutions) == 2 * (2 * (1 + 2 * 3)) + 2 + 3
    dilations = [module.dilation[0] for module in network.encoder.modules() if isinstance(module, torch.nn.Conv1d)]
    assert [dilation for dilation in dilations if dilation > 1] == [9, 3, 9, 3]


def test_features_become_their_nearest_codes_and_gradients_pass() -> None:
    quantiser = Quantiser(SMALL.network)
    quantiser.start(torch.randn(8, 24, 10), torch.Generator().manual_seed(0))
    features = torch.randn(3, 24, 5, requires_grad=True)
    values, which, _ = quantiser(features)
    distances = torch.cdist(features.detach().transpose(1, 2).reshape(-1, 24), quantiser.codes)
    assert torch.equal(which.reshape(-1), distances.argmin(1))
    expected = quantiser.codes[which].transpose(1, 2)
    torch.testing.assert_close(values.detach(), expected)
    values.sum().backward()
    torch.testing.assert_close(features.grad, torch.ones_like(features))


def test_codes_move_to_the_mean_of_what_chooses_them_and_unused_ones_are_reset() -> None:
    quantiser = Quantiser(replace(SMALL.network, num_codes=3, width=2))
    quantiser.codes.copy_(torch.tensor([[0.0, 0.0], [10.0, 10.0], [99.0, 99.0]]))
    quantiser.sums.copy_(quantiser.codes)
    features = torch.tensor([[1.0, 1.0], [1.0, 1.0], [9.0, 9.0], [9.0, 9.0]]).T[None]
    for _ in range(1500):
        quantiser.update(features, quantiser(features)[1], torch.Generator().manual_seed(0))
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


def test_the_corpus_is_resampled_and_starts_stay_inside_a_sequence() -> None:
    source = analytic_source()
    corpus = vector_corpus(source, SMALL)
    rows = [80] * 4
    assert len(corpus.vectors) == sum(rows)
    assert len(corpus.first_rows) == sum(length - SMALL.window_frames + 1 for length in rows)
    first = resample_positions(source.positions[: source.num_frames[0]], Fraction(120), Fraction(20))
    np.testing.assert_array_equal(corpus.vectors[:80], codebook_vectors(first, Fraction(20)))
    windows = corpus.windows(torch.arange(len(corpus.first_rows)), SMALL.window_frames)
    assert windows.shape[1:] == (16, 133)
    assert abs(float(windows.mean())) < 0.2


def test_the_loss_falls_and_many_codes_are_used() -> None:
    training = _training()
    figures = [training.step(step, step_generator(0, "codebook", step)) for step in range(SMALL.schedule.steps)]
    losses = [float(each["reconstruction"].detach()) for each in figures]
    assert np.mean(losses[-5:]) < 0.6 * np.mean(losses[:5])
    assert float(figures[-1]["perplexity"]) > 8


CODES, ANY_CODES = "vqvae.quantizer.codebook", torch.randn(24, 8, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("checkpoint", [{"net": {CODES: torch.full((24, 8), torch.nan)}}, {"net": Path("a program")}])
def test_what_is_not_t2m_gpt_s_codebook_is_refused(tmp_path: Path, checkpoint: object) -> None:
    torch.save(checkpoint, tmp_path / "net_last.pth")
    with pytest.raises(CheckpointError):
        load_published(tmp_path / "net_last.pth")


def test_t2m_gpt_s_codes_are_used_in_place_of_training(tmp_path: Path) -> None:
    with StoreWriter.create(tmp_path / "store") as writer:
        writer.add(replace(to_motion(analytic_motion("walk", 2.0), Fraction(20)), sequence_id="m", split="train"))
    torch.save({"net": {CODES: ANY_CODES, "vqvae.encoder.model.0.bias": torch.zeros(3)}}, tmp_path / "net_last.pth")
    config = apply_overrides(nano(), [f"codebook.published_weights={tmp_path / 'net_last.pth'!s}"])
    train_codebook(StageContext(store=tmp_path / "store", run=RunFolder(tmp_path / "run"), recipe="nano"), config)
    tensors, _ = load_tensors(RunFolder(tmp_path / "run").stage("codebook").model_path)
    assert torch.equal(tensors["codes"], ANY_CODES)
