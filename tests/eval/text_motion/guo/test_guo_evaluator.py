"""Guo et al.'s evaluator beside plain loops over the same random weights; rows in order."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch

from eval.clip_fid.score import FeatureSet
from eval.sets.sets import sample_set
from eval.text_motion.evaluator import TextMotionEvaluator
from eval.text_motion.guo import evaluator as guo
from eval.text_motion.guo.evaluator import GuoEvaluator, load_guo
from eval.text_motion.guo.kind import GuoError, GuoFiles
from eval.text_motion.guo.networks import GuoWidths
from motionkit.core.motion import Caption
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import joint_map
from motionkit.features import humanml3d
from motionkit.features.humanml3d import process
from tests.helpers.published_guo import (
    VOCABULARY,
    checkpoint,
    pose_vectors,
    write_archive,
    write_glove,
    write_statistics,
)

SMALL = GuoWidths(movement=6, motion=5, text=4, shared=3)
State = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> GuoFiles:
    folder = tmp_path_factory.mktemp("guo")
    return GuoFiles(write_archive(folder / "t2m", SMALL), write_glove(folder / "glove"))


@pytest.fixture(scope="module")
def evaluator(files: GuoFiles) -> GuoEvaluator:
    return load_guo(files, SMALL)


def state_of(key: str, num_inputs: int = 259) -> State:
    return {name: tensor.double().numpy() for name, tensor in checkpoint(num_inputs, SMALL)[key].items()}  # type: ignore[attr-defined]


# The plain reference: one motion, one frame, one step at a time, by the published names.


def leaky(x: np.ndarray) -> np.ndarray:
    return np.where(x > 0, x, 0.2 * x)


def plain_convolution(x: np.ndarray, weight: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """y[t] = b + Σ_k W[:, :, k] x[2t + k − 1], frames outside being zero."""
    rows = []
    for t in range((len(x) - 2) // 2 + 1):
        y = bias.copy()
        for k in range(4):
            if 0 <= 2 * t + k - 1 < len(x):
                y += weight[:, :, k] @ x[2 * t + k - 1]
        rows.append(y)
    return np.array(rows)


def plain_tokens(frames: np.ndarray, state: State) -> np.ndarray:
    hidden = leaky(plain_convolution(frames, state["main.0.weight"], state["main.0.bias"]))
    hidden = leaky(plain_convolution(hidden, state["main.3.weight"], state["main.3.bias"]))
    return hidden @ state["out_net.weight"].T + state["out_net.bias"]


def plain_gru(steps: np.ndarray, state: State, start: np.ndarray, suffix: str) -> np.ndarray:
    def gates(x: np.ndarray, part: str) -> list[np.ndarray]:
        return np.split(state[f"gru.weight_{part}_l0{suffix}"] @ x + state[f"gru.bias_{part}_l0{suffix}"], 3)

    h = start
    for x in steps:
        (input_r, input_z, input_n), (hidden_r, hidden_z, hidden_n) = gates(x, "ih"), gates(h, "hh")
        reset, update = 1 / (1 + np.exp(-input_r - hidden_r)), 1 / (1 + np.exp(-input_z - hidden_z))
        h = (1 - update) * np.tanh(input_n + reset * hidden_n) + update * h
    return h


def plain_sequence(steps: np.ndarray, state: State) -> np.ndarray:
    x = steps @ state["input_emb.weight"].T + state["input_emb.bias"]
    forward = plain_gru(x, state, state["hidden"][0, 0], "")
    backward = plain_gru(x[::-1], state, state["hidden"][1, 0], "_reverse")
    y = state["output_net.0.weight"] @ np.concatenate((forward, backward)) + state["output_net.0.bias"]
    y = (y - y.mean()) / np.sqrt(y.var() + 1e-5) * state["output_net.1.weight"] + state["output_net.1.bias"]
    return state["output_net.3.weight"] @ leaky(y) + state["output_net.3.bias"]


def plain_motion(vectors: np.ndarray, length: int, evaluator: GuoEvaluator) -> np.ndarray:
    """One motion's whole tokens; contacts are dropped."""
    standardised = (vectors.astype(np.float64) - evaluator.statistics.mean) / evaluator.statistics.std
    tokens = plain_tokens(standardised[: length // 4 * 4, :-4], state_of("movement_encoder"))
    return plain_sequence(tokens, state_of("motion_encoder"))


LENGTHS = (24, 196, 7, 40, 24, 197, 50, 4)


def test_motions_agree_with_the_plain_reference(evaluator: GuoEvaluator) -> None:
    motions = [pose_vectors(max(196, length), seed) for seed, length in enumerate(LENGTHS)]
    found = evaluator.embed_vectors(motions, LENGTHS)
    expected = [plain_motion(*each, evaluator) for each in zip(motions, LENGTHS, strict=True)]
    np.testing.assert_allclose(found, expected, atol=1e-10)
    assert found.dtype == np.float64 and np.ptp(found, axis=0).min() > 0.01


CAPTIONS = (
    "a/DET person/NOUN walk/VERB slowly/ADV",
    "a/DET man/NOUN turn/VERB left/ADJ and/CCONJ walk/VERB in/ADP a/DET circle/NOUN",
    "zebra/NOUN",
    " ".join(["walk/VERB"] * 19),
    " ".join(["a/DET"] * 20 + ["foot/NOUN"] * 5),
    "is/AUX two/NUM then/ADV arm/NOUN is/AUX",
)
# Parts of speech by hand: VERB 0 NOUN 1 DET 2 ADP 3 NUM 4 AUX 5 ADV 8 Loc 9 Body 10 Act 12 Desc 13 OTHER 14.
PARTS = (
    [14, 2, 1, 12, 13, 14],
    [14, 2, 1, 12, 9, 14, 12, 3, 2, 1, 14],
    [14, 14, 14],
    [14, *[12] * 19, 14],
    [14, *[2] * 20, 14],
    [14, 5, 4, 8, 10, 5, 14],
)


def test_captions_agree_with_the_plain_reference(evaluator: GuoEvaluator, files: GuoFiles) -> None:
    assert files.glove is not None
    vectors, state = np.load(files.glove / "our_vab_data.npy").astype(np.float64), state_of("text_encoder")
    expected = []
    for tokens, parts in zip(CAPTIONS, PARTS, strict=True):
        words = ["sos", *(token.split("/")[0] for token in tokens.split()[:20]), "eos"]
        rows = [vectors[VOCABULARY.index(word if word in VOCABULARY else "unk")] for word in words]
        one_hot = np.eye(15)[parts]
        steps = np.array(rows) + one_hot @ state["pos_emb.weight"].T + state["pos_emb.bias"]
        expected.append(plain_sequence(steps, state))
    found = evaluator.embed_texts([Caption("…", tokens=tokens) for tokens in CAPTIONS])
    np.testing.assert_allclose(found, expected, atol=1e-10)


def test_mardm_s_evaluator_reads_67_numbers(tmp_path: Path) -> None:
    torch.save(checkpoint(67, SMALL), tmp_path / "finest.tar")
    signature = ((0.01283, 0.01693, 0.15378, 0.12224), 0.93862)
    statistics = write_statistics(tmp_path / "meta", signature, ("eval_mean.npy", "eval_std.npy"))
    evaluator = load_guo(GuoFiles(tmp_path / "finest.tar", statistics=statistics), SMALL)
    vectors = pose_vectors(48, 3)
    standardised = (vectors[:, :67] - evaluator.statistics.mean) / evaluator.statistics.std
    tokens = plain_tokens(standardised, state_of("movement_encoder", 67))
    expected = plain_sequence(tokens, state_of("motion_encoder", 67))
    for given in (vectors, vectors[:, :67]):
        np.testing.assert_allclose(evaluator.embed_vectors([given])[0], expected, atol=1e-10)
    assert evaluator.name == "mardm"


@pytest.mark.parametrize("at_once", [1, 2, 64])
def test_rows_come_in_order_and_do_not_depend_on_the_batch(
    evaluator: GuoEvaluator, monkeypatch: pytest.MonkeyPatch, at_once: int
) -> None:
    lengths = (40, 24, 196, 24, 61, 40, 24)
    motions = [pose_vectors(length, seed) for seed, length in enumerate(lengths)]
    alone = np.concatenate([evaluator.embed_vectors([motion]) for motion in motions])
    monkeypatch.setattr(guo, "ROWS_AT_ONCE", at_once)
    np.testing.assert_allclose(evaluator.embed_vectors(motions), alone, atol=1e-12)
    order = np.random.default_rng(0).permutation(len(motions))
    np.testing.assert_allclose(evaluator.embed_vectors([motions[index] for index in order]), alone[order], atol=1e-12)
    captions = [Caption("…", tokens=tokens) for tokens in (*CAPTIONS, *CAPTIONS[:2])]
    sentences = np.concatenate([evaluator.embed_texts([caption]) for caption in captions])
    np.testing.assert_allclose(evaluator.embed_texts(captions), sentences, atol=1e-12)


def walking(num_poses: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    rest = np.zeros((22, 3))
    for joint, parent in enumerate(SMPL22.parents[1:], start=1):
        rest[joint] = rest[parent] + SMPL22.offsets[joint]
    time = np.arange(num_poses)[:, None, None] / 20
    swing = 0.1 * np.sin(2 * np.pi * rng.uniform(0.3, 2, (22, 3)) * time + rng.uniform(0, 6, (22, 3)))
    return (rest + swing + [0, 1, 0] + time * [0.5, 0, 1]).astype(np.float32)


def test_joint_positions_become_the_published_vectors(evaluator: GuoEvaluator) -> None:
    sequences = [walking(length, seed) for seed, length in enumerate((41, 61, 41))]
    samples = sample_set("mine", Fraction(20), sequences, ["a", "b", "c"])
    vectors = [humanml3d.vectors(process(sequence, "smpl22"), "smpl22") for sequence in sequences]
    assert [len(each) for each in vectors] == [40, 60, 40]
    expected = evaluator.embed_vectors(vectors)
    np.testing.assert_array_equal(evaluator.embed_motions(samples), expected)
    clips = np.stack([sequences[0], sequences[2]])
    np.testing.assert_allclose(evaluator.describe(clips, Fraction(20)), expected[[0, 2]], atol=1e-12)
    # Where a motion stands and which way it faces says nothing; how tall it is neither.
    turned = (sequences[0][..., [2, 1, 0]] * [1, 1, -1] + [3, 0.2, -1]).astype(np.float32)
    moved = sample_set("moved", Fraction(20), [turned, np.float32(1.3) * sequences[1]], ["a", "b"])
    np.testing.assert_allclose(evaluator.embed_motions(moved), expected[:2], atol=1e-3)
    assert isinstance(evaluator, TextMotionEvaluator) and isinstance(evaluator, FeatureSet)


def test_kit_s_21_joints_become_vectors_in_its_unit_with_their_own_bones(tmp_path: Path) -> None:
    evaluator = load_guo(GuoFiles(write_archive(tmp_path / "kit", SMALL, num_inputs=247)), SMALL)
    assert (evaluator.layout, evaluator.fps, evaluator.vector_size) == ("kit21", Fraction(25, 2), 251)
    metres = (joint_map(SMPL22, "kit21").weights @ walking(50, 3)).astype(np.float32)
    made = evaluator.pose_vectors(metres)
    assert made.shape == (49, 251)
    # Turned and moved, but no bone is longer or shorter: distances inside a pose are KIT's thousandths of 1.7 m.
    joints = humanml3d.positions(made, "kit21")[:, 1:]
    inside = np.linalg.norm(joints[:, :, None] - joints[:, None], axis=-1)
    given = np.linalg.norm(metres[:-1, 1:, None] - metres[:-1, None, 1:], axis=-1)
    np.testing.assert_allclose(0.0017 * inside, given, atol=1e-4)
    np.testing.assert_allclose(np.diff(made[:, 3]) * 0.0017, np.diff(metres[:-1, 0, 1]), atol=1e-4)
    with pytest.raises(GuoError, match=r"motions of 22 joints: KIT's evaluator reads 21 \(kit21\), in Table 1 alone"):
        evaluator.describe(walking(20, 0)[None], Fraction(25, 2))


def test_what_it_cannot_read_is_explained(evaluator: GuoEvaluator) -> None:
    good = pose_vectors(40, 0)
    bad = good.copy()
    bad[7, 100] = np.nan
    cases = (
        ([good, bad], None, "motion 1: holds NaN"),
        ([good, good[:3]], None, "motion 1: 3 frames of 3; the evaluator needs at least 4"),
        ([good], [41], "motion 0: 41 frames of 40"),
        ([good], [40, 40], "2 lengths for 1 motions"),
        ([pose_vectors(200, 0)], None, r"200 frames; the evaluator knows motions of at most 196 \(9.8 s\)"),
        ([good[:, :251]], None, r"shape \(40, 251\); HumanML3D's have 263 numbers"),
        ([(good - good.mean(0)) / good.std(0)], None, "still standardised"),
        (
            [100 * good, 100 * good],
            None,
            "root's height is 94.9 in the typical motion, 0.918 in HumanML3D.*another unit",
        ),
    )
    for motions, lengths, message in cases:
        with pytest.raises(GuoError, match=message):
            evaluator.embed_vectors(motions, lengths)
    sequences = [walking(41, 0), walking(250, 1)]
    with pytest.raises(GuoError, match=r"mine: 30 fps, but HumanML3D's evaluator was trained at 20 fps.*--fps 20"):
        evaluator.embed_motions(sample_set("mine", Fraction(30), sequences, ["a", "b"]))
    with pytest.raises(GuoError, match="b: 249 frames"):
        evaluator.embed_motions(sample_set("mine", Fraction(20), sequences, ["a", "b"]))
    with pytest.raises(GuoError, match="clips: 60 fps"):
        evaluator.describe(np.stack(sequences[:1]), Fraction(60))
    for tokens, message in (("", "has no word/POS tokens"), ("walk", "'walk' is not of the form"), ("/X", "'/X' is")):
        with pytest.raises(GuoError, match=f"caption 'somebody walks'.*{message}"):
            evaluator.embed_texts([Caption("somebody walks", tokens=tokens)])
    with pytest.raises(GuoError, match="all its tokens are /X"):
        evaluator.embed_texts([Caption("a man walks", tokens="a/X man/X walks/X")])
    assert evaluator.embed_texts([Caption("hop", tokens="hop/X"), Caption("…", tokens="a/X man/NOUN walk/X")]).size
    with pytest.raises(GuoError, match="--glove DIR"):
        GuoEvaluator(evaluator.networks, evaluator.statistics).embed_texts([])


def test_the_fingerprint_is_of_everything_that_numbers_depend_on(evaluator: GuoEvaluator, tmp_path: Path) -> None:
    others = [
        evaluator,
        GuoEvaluator(evaluator.networks, evaluator.statistics),
        load_guo(GuoFiles(write_archive(tmp_path / "other", SMALL, seed=8)), SMALL),
        load_guo(GuoFiles(write_archive(tmp_path / "kit", SMALL, num_inputs=247)), SMALL),
    ]
    assert len({each.fingerprint for each in others}) == len(others)
    assert load_guo(GuoFiles(tmp_path / "other" / "text_mot_match" / "model" / "finest.tar"), SMALL).fingerprint == (
        others[2].fingerprint
    )
    kit = others[3]
    assert kit.fps == Fraction(25, 2) and kit.embed_vectors([np.full((24, 251), 560, np.float32)]).shape == (1, 3)
    with pytest.raises(GuoError, match="KIT's evaluator reads 21"):
        kit.embed_motions(sample_set("mine", Fraction(25, 2), [walking(41, 0)] * 2, ["a", "b"]))
