"""Whole motions through the native evaluator: order, independence of the batch, refusals. Its weights are random."""

from fractions import Fraction

import numpy as np
import pytest
import torch

from eval.native_evaluator.evaluator import NativeEvaluator, describe_training
from eval.native_evaluator.network import NUM_CHANNELS, NativeNetwork, TextProjection
from eval.native_evaluator.settings import NativeNetworkConfig
from eval.native_evaluator.text_motion import NativeTextMotion
from eval.sets.sets import SampleSet, sample_set
from eval.text_motion.evaluator import TextMotionEvaluator
from motionkit.core.errors import MotionkitError
from motionkit.core.motion import Caption
from motionkit.core.skeleton import SMPL22

SMALL = NativeNetworkConfig(convolution=8, recurrent=6, embedding=7, shared=5, text_hidden=4)


@pytest.fixture(scope="module")
def evaluator() -> NativeTextMotion:
    torch.manual_seed(0)
    native = NativeEvaluator(
        NativeNetwork(SMALL).eval(),
        TextProjection(3, SMALL).eval(),
        torch.zeros(NUM_CHANNELS),
        torch.full((NUM_CHANNELS,), 0.2),
        torch.eye(SMALL.embedding),
        describe_training({}, "0" * 64, [Fraction(20)], None),
    )
    return NativeTextMotion(native)


def motions(lengths: tuple[int, ...]) -> SampleSet:
    rng = np.random.default_rng(0)
    rest = np.cumsum(SMPL22.offsets, axis=0)
    sequences = [(rest + 0.1 * rng.normal(size=(length, 22, 3))).astype(np.float32) for length in lengths]
    return sample_set("some", Fraction(20), sequences, [f"m{index}" for index in range(len(lengths))])


def test_rows_come_in_the_order_of_the_set_whatever_the_lengths(evaluator: NativeTextMotion) -> None:
    samples = motions((40, 12, 40, 9, 200, 12))
    assert isinstance(evaluator, TextMotionEvaluator)
    together = evaluator.embed_motions(samples)
    assert together.shape == (6, 5)
    for index in range(6):
        alone = evaluator.embed_motions(samples.select([index]))
        np.testing.assert_allclose(together[index], alone[0], rtol=1e-5, atol=1e-6)
    turned = evaluator.embed_motions(samples.select([5, 4, 3, 2, 1, 0]))
    np.testing.assert_allclose(turned, together[::-1], rtol=1e-5, atol=1e-6)
    assert np.linalg.norm(together[0] - together[2]) > 1e-3


def test_its_fingerprint_is_not_that_of_clips(evaluator: NativeTextMotion) -> None:
    assert evaluator.fingerprint != evaluator.evaluator.fingerprint
    assert evaluator.fingerprint.startswith(evaluator.evaluator.fingerprint)
    assert (evaluator.name, evaluator.fps) == ("native", None)


def test_what_it_cannot_read_is_named(evaluator: NativeTextMotion) -> None:
    with pytest.raises(MotionkitError, match="'m1' has 7 poses at 20 fps, the native evaluator needs at least 8"):
        evaluator.embed_motions(motions((20, 7)))
    with pytest.raises(MotionkitError, match="without captions"):
        evaluator.embed_texts([Caption("a person walks")])


def test_framerates_that_it_was_not_trained_at_are_reported(evaluator: NativeTextMotion) -> None:
    trained = [Fraction(fps) for fps in evaluator.evaluator.description["framerates"]]
    assert evaluator.remark_at(trained[0]) == "" and evaluator.remark_at(max(trained)) == ""
    told = evaluator.remark_at(min(trained) / 2)
    assert f"its numbers at {float(min(trained) / 2):g} fps mean little" in told and "training.framerates" in told
