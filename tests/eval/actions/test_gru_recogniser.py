"""Action2Motion's GRU recognisers against the equations written out, and against takes whose action is known."""

import math
import os
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from eval.actions.gru import (
    CMU_MOCAP,
    CMU_UNIT_METRES,
    HUMANACT12,
    GruKind,
    GruNetwork,
    cmu_joints,
    humanact12_joints,
    load_gru,
)
from eval.actions.recogniser import ActionRecogniser, clip_frames, clip_rows
from eval.sets.sets import SampleSet, sample_set
from motionkit.core.errors import MotionkitError
from motionkit.core.skeletons.mapping import map_joints
from motionkit.fields.resample import resample_positions
from motionkit.io.asfamc import read_asfamc
from motionkit.io.registry import ReadOptions
from motionkit.training.loop import CheckpointError

CAPTURES = Path(os.environ.get("MOTIONKIT_CAPTURES", Path.home() / ".cache/motionkit/captures"))
WEIGHTS = {
    HUMANACT12.name: CAPTURES / "recognisers/action_recognition_model_humanact12.tar",
    CMU_MOCAP.name: CAPTURES / "recognisers/action_recognition_model_mocap_new.tar",
}


def random_weights(path: Path, kind: GruKind) -> dict[str, np.ndarray]:
    """Write a checkpoint in the published file's (legacy) form and return its numbers."""
    torch.manual_seed(5)
    network = GruNetwork(3 * kind.num_joints, len(kind.actions))
    tensors = {name: 0.15 * torch.randn_like(tensor) for name, tensor in network.state_dict().items()}
    torch.save({"model": tensors, "iteration": 3}, path, _use_new_zipfile_serialization=False)
    return {name: tensor.double().numpy() for name, tensor in tensors.items()}


def moving(num_frames: int, seed: int = 0, joints: int = 22) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (rng.normal(size=(1, joints, 3)) + 0.1 * rng.normal(size=(num_frames, joints, 3)).cumsum(axis=0)).astype(
        np.float32
    )


def samples_of(kind: GruKind, *sequences: np.ndarray) -> SampleSet:
    return sample_set("some", kind.fps, sequences, [str(i) for i in range(len(sequences))])


def sigmoid(x: float) -> float:
    return 1.0 / (1.0 + math.exp(-x))


def gru_by_hand(poses: np.ndarray, weights: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Features and scores of one clip, unit by unit (Cho et al. 2014 with torch's order of gates: r, z, n)."""
    layer_inputs = [row.astype(np.float64) for row in poses]
    for layer in range(2):
        w, u = weights[f"recurrent.weight_ih_l{layer}"], weights[f"recurrent.weight_hh_l{layer}"]
        b, c = weights[f"recurrent.bias_ih_l{layer}"], weights[f"recurrent.bias_hh_l{layer}"]
        h, states = np.zeros(128), []
        for x in layer_inputs:
            given_x, given_h = w @ x + b, u @ h + c
            new = np.empty(128)
            for i in range(128):
                reset = sigmoid(given_x[i] + given_h[i])
                update = sigmoid(given_x[128 + i] + given_h[128 + i])
                candidate = math.tanh(given_x[256 + i] + reset * given_h[256 + i])
                new[i] = (1 - update) * candidate + update * h[i]
            h = new
            states.append(h)
        layer_inputs = states
    features = np.tanh(weights["linear1.weight"] @ layer_inputs[-1] + weights["linear1.bias"])
    return features, weights["linear2.weight"] @ features + weights["linear2.bias"]


@pytest.mark.parametrize("kind", [HUMANACT12, CMU_MOCAP], ids=lambda kind: kind.name)
def test_features_and_scores_are_the_equations(kind: GruKind, tmp_path: Path) -> None:
    weights = random_weights(tmp_path / "weights.tar", kind)
    recogniser = load_gru(tmp_path / "weights.tar", kind)
    assert isinstance(recogniser, ActionRecogniser)
    long, short = moving(kind.clip_length + 9, 1), moving(17, 2)
    found = recogniser.recognise(samples_of(kind, long, short))
    padded = np.concatenate((short, np.repeat(short[-1:], kind.clip_length - 17, axis=0)))
    for row, clip in enumerate((long[4 : 4 + kind.clip_length], padded)):
        joints = kind.joints(clip[None])[0]
        features, scores = gru_by_hand((joints - joints[0, 0]).reshape(kind.clip_length, -1), weights)
        np.testing.assert_allclose(found.features[row], features, atol=1e-5)
        np.testing.assert_allclose(found.scores[row], scores, atol=1e-4)


def test_a_motion_has_its_own_row_whatever_is_beside_it_and_wherever_it_stands(tmp_path: Path) -> None:
    random_weights(tmp_path / "weights.tar", HUMANACT12)
    recogniser = load_gru(tmp_path / "weights.tar", HUMANACT12)
    motions = [moving(length, length) for length in (20, 60, 90, 33)]
    together = recogniser.recognise(samples_of(HUMANACT12, *motions))
    for row, motion in enumerate(motions):
        alone = recogniser.recognise(samples_of(HUMANACT12, motion + np.float32([3, 0.5, -2])))
        np.testing.assert_allclose(alone.features[0], together.features[row], atol=1e-4)


def test_hands_that_lack_go_on_along_the_forearm() -> None:
    motion = moving(4, joints=24)[None]
    seen, guessed = humanact12_joints(motion), humanact12_joints(motion[:, :, :22])
    np.testing.assert_array_equal(guessed[:, :, :22], seen[:, :, :22])
    forearm = guessed[:, :, 20] - guessed[:, :, 18]
    np.testing.assert_allclose(guessed[:, :, 22], guessed[:, :, 20] + 0.34 * forearm, atol=1e-6)
    np.testing.assert_array_equal(seen, motion * np.float32([1, -1, -1]))


@given(st.integers(1, 200), st.integers(1, 120))
def test_a_clip_has_its_length_and_lies_in_the_motion(num_frames: int, length: int) -> None:
    frames = clip_frames(num_frames, length)
    assert len(frames) == length and frames[0] >= 0 and frames[-1] < num_frames
    assert np.isin(np.diff(frames), (0, 1)).all()
    before, after = frames[0], num_frames - 1 - frames[-1]
    assert after - before in (0, 1) if num_frames >= length else (before, after) == (0, 0)
    rows = clip_rows(samples_of(CMU_MOCAP, moving(3), moving(num_frames)), length)
    np.testing.assert_array_equal(rows[1], frames + 3)


def test_other_motions_and_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "weights.tar"
    random_weights(path, HUMANACT12)
    recogniser = load_gru(path, HUMANACT12)
    with pytest.raises(MotionkitError, match="30 fps, but the recogniser 'humanact12' was trained at 20 fps"):
        recogniser.recognise(sample_set("fast", Fraction(30), [moving(70)], ["a"]))
    with pytest.raises(MotionkitError, match="24 joints, or 22 without hands; these motions have 21"):
        recogniser.recognise(samples_of(HUMANACT12, moving(70, joints=21)))
    with pytest.raises(MotionkitError, match="takes the 22 joints of the standard layout; these motions have 21"):
        cmu_joints(moving(3, joints=21)[None])
    with pytest.raises(CheckpointError, match=r"weight_ih_l0 is \(384, 72\), expected \(384, 60\)"):
        load_gru(path, CMU_MOCAP)
    torch.save({"model": {"linear1.weight": torch.zeros(30, 128)}}, path)
    with pytest.raises(CheckpointError, match=r"lacks model/linear1\.bias"):
        load_gru(path, HUMANACT12)
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(CheckpointError, match="not a checkpoint that can be read"):
        load_gru(path, HUMANACT12)


def published(kind: GruKind) -> Path:
    if not WEIGHTS[kind.name].is_file():
        pytest.skip("needs the published recognisers: set MOTIONKIT_CAPTURES to their folder")
    return WEIGHTS[kind.name]


@pytest.mark.parametrize(
    ("take", "action"), [("02/02_01", "walk"), ("02/02_03", "run"), ("05/05_02", "dance"), ("01/01_02", "climb")]
)
def test_the_published_network_knows_takes_of_the_cmu_database(take: str, action: str) -> None:
    recogniser = load_gru(published(CMU_MOCAP), CMU_MOCAP)
    path = CAPTURES / "cmu/asfamc" / f"{take}.amc"
    if not path.is_file():
        pytest.skip("needs CMU's takes: set MOTIONKIT_CAPTURES to their folder")
    motion = read_asfamc(path, ReadOptions(fps=Fraction(120)))
    positions = resample_positions(map_joints(motion, "smpl22"), Fraction(120), CMU_MOCAP.fps)
    found = recogniser.recognise(samples_of(CMU_MOCAP, positions))
    assert recogniser.actions[int(found.scores[0].argmax())] == action
    # The joints that the network saw are those of the take's own skeleton, in the database's unit.
    names = ["root", "lowerneck", "head", "lhumerus", "lradius", "lwrist", "lfemur", "ltibia", "lfoot", "ltoes"]
    own = motion.joint_positions[:, [motion.skeleton.index(name) for name in names]]
    made = cmu_joints(map_joints(motion, "smpl22")[None])[0][:, [0, 1, 2, 4, 5, 6, 12, 13, 14, 15]]
    np.testing.assert_allclose(made * CMU_UNIT_METRES, own, atol=1e-4)
