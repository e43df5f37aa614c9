"""The native-rate evaluator's parts: what it sees, what it is trained on, what it learns from captions."""

from fractions import Fraction

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.native_evaluator.bank import DrawnClips, Takes, build_bank, build_banks
from eval.native_evaluator.network import CUTOFF_HZ, NUM_CHANNELS, TARGETS, prepare, rich_input, smooth, standardised
from eval.native_evaluator.training import collect_sentences, matching_loss, spoil
from eval.sets.damage import families, slide, translate, turn
from eval.sets.sets import Ragged
from motionkit.core.errors import UsageError
from motionkit.core.motion import Caption


def walking(num_frames: int, fps: float, seed: int = 0) -> np.ndarray:
    """A body of 22 random joints that swings while it walks along a curve."""
    rng = np.random.default_rng(seed)
    seconds = np.arange(num_frames)[:, None, None] / fps
    body = rng.normal(0, 0.3, (22, 3)) + np.array([0.0, 0.9, 0.0])
    swing = 0.1 * np.sin(2 * np.pi * rng.uniform(0.5, 3.0, (22, 3)) * seconds + rng.uniform(0, 6, (22, 3)))
    path = np.concatenate((np.sin(0.5 * seconds), 0 * seconds, 1.1 * seconds), -1)
    return np.asarray(body + swing + path, dtype=np.float32)


def takes_of(*sequences: tuple[np.ndarray, int], captions: tuple[tuple[Caption, ...], ...] | None = None) -> Takes:
    return Takes(
        sequences=Ragged.of([positions for positions, _ in sequences]),
        fps=tuple(Fraction(fps) for _, fps in sequences),
        captions=captions or ((),) * len(sequences),
    )


def as_input(clips: np.ndarray, fps: float) -> np.ndarray:
    return rich_input(torch.from_numpy(clips.astype(np.float64)), fps).numpy()


@given(yaw=st.floats(-3.1, 3.1), x=st.floats(-50, 50), z=st.floats(-50, 50), fps=st.sampled_from([20.0, 60.0, 120.0]))
@settings(max_examples=20)
def test_input_ignores_where_and_which_way(yaw: float, x: float, z: float, fps: float) -> None:
    clips = walking(24, fps)[None].astype(np.float64)
    moved = translate(turn(clips, yaw), np.array([[x, z]]))
    assert np.allclose(as_input(moved, fps), as_input(clips, fps), atol=1e-6)


def test_input_means_the_same_at_every_framerate() -> None:
    slow, fast = as_input(walking(31, 60.0)[None], 60.0), as_input(walking(61, 120.0)[None], 120.0)[:, ::2]
    inner = slice(4, -4)
    assert np.allclose(fast[..., -1] - slow[..., -1], np.log(2.0))
    slow, fast = slow[..., :-1], fast[..., :-1]
    # Forward differences of the slower clip look further ahead: they agree to first order.
    assert np.abs(slow[:, inner] - fast[:, inner]).max() < 0.35
    assert np.abs(slow[:, inner, :64] - fast[:, inner, :64]).max() < 1e-6


def test_slip_channels_see_sliding_of_a_standing_body() -> None:
    standing = np.repeat(walking(1, 60.0)[None], 32, axis=1)
    slid = slide(standing, 60.0, 0.05, np.random.default_rng(0))
    difference = as_input(slid, 60.0)[..., -3:-1] - as_input(standing, 60.0)[..., -3:-1]
    assert np.allclose(difference, np.log(0.055 / 0.005), atol=0.01)


def test_a_glitch_is_held_within_five_deviations() -> None:
    glitched = walking(32, 60.0)[None].copy()
    glitched[0, 16, 20] += 30.0
    raw = torch.from_numpy(as_input(glitched, 60.0))
    mean, scale = raw.mean(dim=(0, 1)), torch.full((NUM_CHANNELS,), 2.0, dtype=torch.float64)
    seen = standardised(raw, mean, scale)
    plain = (raw - mean) * scale
    assert plain.abs().max() > 1000 and seen.abs().max() == 5.0
    assert torch.equal(seen[plain.abs() < 5], plain[plain.abs() < 5])


def test_a_bank_holds_only_sequences_that_reach_the_framerate() -> None:
    takes = takes_of((walking(300, 120), 120), (walking(100, 30), 30), (walking(90, 60), 60))
    bank = build_bank(takes, Fraction(60), 1e9, 16, np.random.default_rng(0))
    assert bank.sequence_index.tolist() == [0, 2]
    assert bank.sequences.num_frames.tolist() == [150, 90]
    assert [bank.fps for bank in build_banks(takes, [Fraction(30), Fraction(60), Fraction(240)], 1e9, 16, 0)] == [
        30,
        60,
    ]
    with pytest.raises(UsageError, match="highest framerate is 120"):
        build_banks(takes, [Fraction(240)], 1e9, 16, 0)
    many = takes_of(*((walking(120, 60, seed), 60) for seed in range(20)))
    assert len(build_bank(many, Fraction(60), 10.0, 16, np.random.default_rng(0)).sequences) == 5


def test_drawn_clips_lie_in_their_sequences_and_margins_continue_them() -> None:
    seconds = np.arange(40, dtype=np.float32)[:, None, None] * np.ones((1, 22, 3), dtype=np.float32)
    takes = takes_of((seconds, 20), (100 + seconds[:30], 20))
    bank = build_bank(takes, Fraction(20), 1e9, 16, np.random.default_rng(0))
    drawn = bank.draw(np.random.default_rng(1), 200, 16, margin=20)
    line = drawn.positions[:, :, 0, 0]
    # A uniform motion continues itself under point reflection, inside the sequence and beyond it.
    assert np.allclose(np.diff(line, axis=1), 1.0)
    start = line[:, 20] - 100 * drawn.take
    assert start.min() == 0 and np.all(start <= np.where(drawn.take == 0, 24, 14))
    assert np.allclose(drawn.centre_seconds, (start + 7.5) / 20)
    assert 0.5 < (drawn.take == 0).mean() < 0.75


def test_spoiled_clips_carry_the_strength_that_was_done_to_them() -> None:
    clips = np.stack([walking(60, 60.0, seed) for seed in range(22)]).astype(np.float64)
    batch = spoil(clips, 60.0, 10, 7, families(), 0.5, np.random.default_rng(0))
    assert batch.positions.shape == (22, 40, 22, 3) and batch.positions.dtype == np.float32
    damages = (batch.targets > 0).sum(axis=1)
    assert np.all(batch.targets[:7] == 0) and np.all(damages[7:] >= 1)
    # Of nine clips that lost detail, four have jitter on top.
    assert np.count_nonzero(damages == 2) == 4
    assert np.all(batch.targets[damages == 2, TARGETS.index("jitter")] > 0)
    assert np.array_equal(batch.positions[:7], prepare(clips[:7, 10:-10], 60.0))
    assert not np.allclose(np.diff(batch.positions[7:], axis=1), np.diff(clips[7:, 10:-10], axis=1), atol=1e-5)


def test_sentences_are_found_by_take_and_time() -> None:
    captions = (
        (Caption("walks"), Caption("waves", 1.0, 2.0)),
        (),
        (Caption("walks", 0.0, 5.0), Caption(" ")),
    )
    sentences = collect_sentences(captions, lambda texts: np.arange(len(texts), dtype=np.float32)[:, None])
    assert len(sentences.embeddings) == 2
    take, seconds = np.array([0, 0, 0, 1, 2]), np.array([0.5, 1.5, 2.0, 0.5, 6.0])
    drawn = DrawnClips(np.zeros((5, 8, 22, 3)), take, seconds)
    drawings = [sentences.of_clips(drawn, 5, np.random.default_rng(seed)) for seed in range(20)]
    assert all(rows == [0, 1, 2] for rows, _ in drawings)
    assert [set(column) for column in np.stack([drawing[1] for drawing in drawings]).T] == [{0}, {0, 1}, {0}]


def test_matching_leaves_pairs_with_the_same_caption_out_of_the_negatives() -> None:
    generator = torch.Generator().manual_seed(0)
    motions, texts = torch.randn((2, 6, 4), generator=generator)
    texts[1] = texts[0]
    ids = np.array([0, 0, 1, 2, 3, 4])
    loss = matching_loss(motions, texts, ids, 0.5)
    logits = -torch.stack([((motion - texts) ** 2).sum(-1) for motion in motions]) / (0.5 * 4)
    expected = []
    for scores in (logits, logits.T):
        for row in range(6):
            others = [column for column in range(6) if column == row or ids[column] != ids[row]]
            expected.append(torch.logsumexp(scores[row, others], 0) - scores[row, row])
    assert float(loss) == pytest.approx(float(torch.stack(expected).mean()), rel=1e-5)


@given(num_poses=st.integers(4, 70), fps=st.sampled_from([20.0, 59.94, 120.0, 480.0]))
def test_smoothing_solves_the_penalised_least_squares(num_poses: int, fps: float) -> None:
    clips = np.random.default_rng(0).normal(size=(2, num_poses, 22, 3))
    difference = np.diff(np.eye(num_poses), n=2, axis=0)
    weight = (fps / (2 * np.pi * CUTOFF_HZ)) ** 4
    expected = np.linalg.solve(np.eye(num_poses) + weight * difference.T @ difference, clips.reshape(2, num_poses, 66))
    np.testing.assert_allclose(smooth(clips, fps).reshape(expected.shape), expected, rtol=1e-9, atol=1e-9)
