"""Guo et al.'s evaluator beside plain loops over the same random weights; what is none of its files is refused."""

import pickle
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch

from eval.clip_fid.score import FeatureSet
from eval.sets.sets import sample_set
from eval.text_motion.guo import KINDS, GuoError, GuoEvaluator, GuoFiles, load_guo, read_statistics, read_word_vectors
from motionkit.core.motion import Caption
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import joint_map, rest_positions
from motionkit.features import humanml3d
from motionkit.features.humanml3d import process
from motionkit.training.loop import CheckpointError
from tests.helpers.published_guo import (
    KIT,
    PLAIN,
    T2M,
    VOCABULARY,
    GuoWidths,
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
    return load_guo(files)


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


def plain_motion(vectors: np.ndarray, evaluator: GuoEvaluator) -> np.ndarray:
    """One motion's whole tokens; contacts are dropped."""
    standardised = (vectors.astype(np.float64) - evaluator.statistics.mean) / evaluator.statistics.std
    tokens = plain_tokens(standardised[: len(vectors) // 4 * 4, :-4], state_of("movement_encoder"))
    return plain_sequence(tokens, state_of("motion_encoder"))


LENGTHS = (24, 196, 7, 40, 24, 197, 50, 4)


def test_motions_agree_with_the_plain_reference(evaluator: GuoEvaluator) -> None:
    motions = [pose_vectors(length, seed) for seed, length in enumerate(LENGTHS)]
    found = evaluator.embed_vectors(motions)
    expected = [plain_motion(motion, evaluator) for motion in motions]
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
    evaluator = load_guo(GuoFiles(tmp_path / "finest.tar", statistics=statistics))
    vectors = pose_vectors(48, 3)
    standardised = (vectors[:, :67] - evaluator.statistics.mean) / evaluator.statistics.std
    tokens = plain_tokens(standardised, state_of("movement_encoder", 67))
    expected = plain_sequence(tokens, state_of("motion_encoder", 67))
    for given in (vectors, vectors[:, :67]):
        np.testing.assert_allclose(evaluator.embed_vectors([given])[0], expected, atol=1e-10)
    assert evaluator.name == "mardm"


def walking(num_poses: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    rest = rest_positions(SMPL22)
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
    # Where a motion stands, which way it faces and how tall it is say nothing.
    turned = (sequences[0][..., [2, 1, 0]] * [1, 1, -1] + [3, 0.2, -1]).astype(np.float32)
    moved = sample_set("moved", Fraction(20), [turned, np.float32(1.3) * sequences[1]], ["a", "b"])
    np.testing.assert_allclose(evaluator.embed_motions(moved), expected[:2], atol=1e-3)
    assert isinstance(evaluator, FeatureSet)


def test_kit_s_21_joints_become_vectors_in_its_unit_with_their_own_bones(tmp_path: Path) -> None:
    evaluator = load_guo(GuoFiles(write_archive(tmp_path / "kit", SMALL, num_inputs=247)))
    assert (evaluator.layout, evaluator.fps) == ("kit21", Fraction(25, 2))
    metres = (joint_map(SMPL22, "kit21").weights @ walking(50, 3)).astype(np.float32)
    vectors = evaluator.pose_vectors(metres)
    assert vectors.shape == (49, 251)
    # Turned and moved, but no bone is longer or shorter: distances inside a pose are KIT's thousandths of 1.7 m.
    joints = humanml3d.positions(vectors, "kit21")[:, 1:]
    inside = np.linalg.norm(joints[:, :, None] - joints[:, None], axis=-1)
    given = np.linalg.norm(metres[:-1, 1:, None] - metres[:-1, None, 1:], axis=-1)
    np.testing.assert_allclose(0.0017 * inside, given, atol=1e-4)
    np.testing.assert_allclose(np.diff(vectors[:, 3]) * 0.0017, np.diff(metres[:-1, 0, 1]), atol=1e-4)
    with pytest.raises(GuoError, match="22 joints"):
        evaluator.describe(walking(20, 0)[None], Fraction(25, 2))


GOOD = pose_vectors(40, 0)
NAN = np.where(np.arange(40 * 263).reshape(40, 263) == 2000, np.nan, GOOD)


@pytest.mark.parametrize(
    ("motions", "message"),
    [
        ([GOOD, NAN], "motion 1: holds NaN"),
        ([pose_vectors(200, 0)], "200 frames"),
        ([GOOD[:, :251]], "263 numbers"),
        ([(GOOD - GOOD.mean(0)) / GOOD.std(0)], "still standardised"),
        ([100 * GOOD], "another unit"),
    ],
)
def test_vectors_that_it_cannot_read_are_refused(
    evaluator: GuoEvaluator, motions: list[np.ndarray], message: str
) -> None:
    with pytest.raises(GuoError, match=message):
        evaluator.embed_vectors(motions)


def test_other_framerates_and_captions_without_tokens_are_refused(evaluator: GuoEvaluator, files: GuoFiles) -> None:
    samples = sample_set("mine", Fraction(30), [walking(41, 0)], ["a"])
    for refused in (
        lambda: evaluator.embed_motions(samples),
        lambda: evaluator.describe(walking(41, 0)[None], Fraction(60)),
    ):
        with pytest.raises(GuoError, match="--fps 20"):
            refused()
    for tokens in ("", "walk", "/X", "a/X man/X walks/X"):
        with pytest.raises(GuoError, match=r"word/POS"):
            evaluator.embed_texts([Caption("somebody walks", tokens=tokens)])
    assert evaluator.embed_texts([Caption("hop", tokens="hop/X"), Caption("…", tokens="a/X man/NOUN walk/X")]).size
    with pytest.raises(GuoError, match="--glove DIR"):
        load_guo(GuoFiles(files.weights)).embed_texts([Caption("hop", tokens="hop/X")])


def test_the_fingerprint_is_of_everything_that_numbers_depend_on(files: GuoFiles, tmp_path: Path) -> None:
    older = tmp_path / "older.tar"
    torch.save(checkpoint(259, SMALL), older, _use_new_zipfile_serialization=False)
    beside = files.weights.parents[2] / "Comp_v6_KLD01" / "meta"
    fingerprints = [
        load_guo(each).fingerprint
        for each in (
            files,
            GuoFiles(files.weights),
            GuoFiles(write_archive(tmp_path / "other", SMALL, seed=8)),
            GuoFiles(write_archive(tmp_path / "kit", SMALL, num_inputs=247)),
            GuoFiles(older, files.glove, beside),
        )
    ]
    assert len(set(fingerprints)) == 4 and fingerprints[0] == fingerprints[4]


Change = Callable[[dict[str, dict[str, torch.Tensor]]], object]
FAULTS: dict[str, Change] = {
    "first layer": lambda s: s["movement_encoder"].update({"main.0.weight": torch.zeros(6, 263, 4)}),
    "text_encoder.hidden holds numbers": lambda s: s["text_encoder"]["hidden"].fill_(torch.inf),
    "'movement_encoder'": lambda s: s.pop("movement_encoder"),
}


@pytest.mark.parametrize("message", FAULTS)
def test_other_weights_are_refused(tmp_path: Path, message: str) -> None:
    state = checkpoint(259, SMALL)
    FAULTS[message](state)  # type: ignore[arg-type]
    torch.save(state, tmp_path / "finest.tar")
    with pytest.raises(CheckpointError, match=message):
        load_guo(GuoFiles(tmp_path / "finest.tar", statistics=write_statistics(tmp_path)))


class Program:
    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (Path("executed"),))


def test_nothing_in_a_file_is_executed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    torch.save({**checkpoint(259, SMALL), "opt_text_encoder": Program()}, tmp_path / "finest.tar")
    with pytest.raises(CheckpointError, match="without running its pickle"):
        load_guo(GuoFiles(tmp_path / "finest.tar"))
    glove = write_glove(tmp_path / "glove")
    (glove / "our_vab_words.pkl").write_bytes(pickle.dumps(["sos", Program()]))
    with pytest.raises(GuoError, match="would be code to run"):
        read_word_vectors(glove)
    assert not (tmp_path / "executed").exists()


@pytest.mark.parametrize(
    ("signature", "message"),
    [
        (PLAIN, r"root height is 0.9385, 0.9175"),
        (KIT, r"shape \(251,\), expected \(263\)"),
    ],
)
def test_statistics_of_another_convention_are_refused(
    signature: tuple[tuple[float, ...], float], message: str, tmp_path: Path
) -> None:
    read_statistics(write_statistics(tmp_path / "mdm", T2M, ("t2m_mean.npy", "t2m_std.npy")), KINDS[0])
    with pytest.raises(GuoError, match=message):
        read_statistics(write_statistics(tmp_path / "wrong", signature), KINDS[0])
    with pytest.raises(GuoError, match=r"there is no mean.npy and std.npy"):
        read_statistics(tmp_path, KINDS[0])


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("our_vab_idx.pkl", pickle.dumps({"sos": 0, "eos": 1, "unk": 99, "a": 2}), "'unk' in row 99 of 20"),
        ("our_vab_data.npy", np.zeros((20, 50), np.float32), r"shape \(20, 50\)"),
    ],
)
def test_other_word_vectors_are_refused(tmp_path: Path, file: str, content: bytes | np.ndarray, message: str) -> None:
    glove = write_glove(tmp_path)
    if isinstance(content, bytes):
        (glove / file).write_bytes(content)
    else:
        np.save(glove / file, content)
    with pytest.raises(GuoError, match=message):
        read_word_vectors(glove)
    (glove / file).unlink()
    with pytest.raises(GuoError, match=file):
        read_word_vectors(glove)
