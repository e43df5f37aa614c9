"""What is not a published evaluator's weights, statistics or word vectors is refused with one line that says why."""

import pickle
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from eval.text_motion.guo.evaluator import load_guo
from eval.text_motion.guo.kind import KINDS, GuoError, GuoFiles, read_statistics
from eval.text_motion.guo.networks import GuoNetworks, GuoWidths
from eval.text_motion.guo.words import read_word_vectors
from motionkit.training.loop import CheckpointError
from tests.helpers.published_guo import KIT, PLAIN, T2M, checkpoint, write_archive, write_glove, write_statistics

SMALL = GuoWidths(movement=6, motion=5, text=4, shared=3)
Change = Callable[[dict[str, dict[str, torch.Tensor]]], object]


def test_the_published_sizes() -> None:
    with torch.device("meta"):
        networks = GuoNetworks(KINDS[259])
    named = networks.published()
    found = {f"{key}/{name}": tuple(tensor.shape) for key, part in named.items() for name, tensor in part.items()}
    assert found["movement_encoder/main.0.weight"] == (512, 259, 4)
    assert found["movement_encoder/out_net.weight"] == (512, 512)
    assert found["motion_encoder/hidden"] == (2, 1, 1024) and found["text_encoder/hidden"] == (2, 1, 512)
    assert found["motion_encoder/gru.weight_ih_l0_reverse"] == (3072, 1024)
    assert found["motion_encoder/output_net.0.weight"] == (1024, 2048)
    assert found["motion_encoder/output_net.3.weight"] == (512, 1024)
    assert found["text_encoder/pos_emb.weight"] == (300, 15) and found["text_encoder/input_emb.weight"] == (512, 300)
    assert found["text_encoder/output_net.3.weight"] == (512, 512)
    assert [len(part) for part in named.values()] == [6, 17, 19]


HIDDEN = "hidden"
FAULTS: dict[str, tuple[Change, str]] = {
    "another first layer": (
        lambda s: s["movement_encoder"].update({"main.0.weight": torch.zeros(6, 263, 4)}),
        r"movement_encoder/main.0.weight is \(6, 263, 4\); the evaluator of Guo et al. begins with 259 numbers",
    ),
    "a shape": (
        lambda s: s["motion_encoder"].update({HIDDEN: torch.zeros(2, 1, 4)}),
        r"motion_encoder/hidden is \(2, 1, 4\), expected \(2, 1, 5\)",
    ),
    "a lost tensor": (lambda s: s["text_encoder"].pop("pos_emb.bias"), "of 19 tensors: it lacks text_encoder/pos_emb"),
    "one too many": (
        lambda s: s["motion_encoder"].update(extra=torch.zeros(1)),
        "of 17 tensors: it has motion_encoder/extra besides",
    ),
    "not finite": (lambda s: s["text_encoder"][HIDDEN].fill_(torch.inf), "text_encoder/hidden holds numbers that are"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_other_weights_are_refused(tmp_path: Path, name: str) -> None:
    change, message = FAULTS[name]
    state = checkpoint(259, SMALL)
    change(state)  # type: ignore[arg-type]
    torch.save(state, tmp_path / "finest.tar")
    with pytest.raises(CheckpointError, match=message):
        load_guo(GuoFiles(tmp_path / "finest.tar", statistics=write_statistics(tmp_path)), SMALL)


class Program:
    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (Path("executed"),))


def test_nothing_in_a_file_is_executed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    torch.save({**checkpoint(259, SMALL), "opt_text_encoder": Program()}, tmp_path / "finest.tar")
    with pytest.raises(CheckpointError, match="without running its pickle"):
        load_guo(GuoFiles(tmp_path / "finest.tar"), SMALL)
    glove = write_glove(tmp_path / "glove")
    (glove / "our_vab_words.pkl").write_bytes(pickle.dumps(["sos", Program()]))
    with pytest.raises(GuoError, match=r"our_vab_words.pkl: it calls for .*, which would be code to run"):
        read_word_vectors(glove)
    assert not (tmp_path / "executed").exists()


def test_damaged_and_absent_weights(tmp_path: Path) -> None:
    weights = write_archive(tmp_path / "t2m", SMALL)
    (tmp_path / "cut.tar").write_bytes(weights.read_bytes()[:3000])
    for path in (tmp_path / "cut.tar", tmp_path / "none"):
        with pytest.raises(CheckpointError):
            load_guo(GuoFiles(path), SMALL)
    alone = tmp_path / "finest.tar"
    alone.write_bytes(weights.read_bytes())
    with pytest.raises(GuoError, match="not beside them"):
        load_guo(GuoFiles(alone), SMALL)
    # A file of torch's older format, which is what the published ones may be.
    torch.save(checkpoint(259, SMALL), alone, _use_new_zipfile_serialization=False)
    first, second = load_guo(GuoFiles(weights), SMALL), load_guo(GuoFiles(alone, statistics=_meta(weights)), SMALL)
    assert first.fingerprint == second.fingerprint


def _meta(weights: Path) -> Path:
    return weights.parents[2] / "Comp_v6_KLD01" / "meta"


def test_statistics_of_another_convention_are_refused(tmp_path: Path) -> None:
    t2m, kit = KINDS[259], KINDS[247]
    read_statistics(write_statistics(tmp_path / "right"), t2m)
    read_statistics(write_statistics(tmp_path / "mdm", T2M, ("t2m_mean.npy", "t2m_std.npy")), t2m)
    read_statistics(write_statistics(tmp_path / "kit", KIT), kit)
    divided = (tuple(std / (25 if block in (0, 1, 2, 6) else 1) for block, std in enumerate(PLAIN[0])), PLAIN[1])
    contacts = ((*T2M[0][:6], PLAIN[0][6]), T2M[1])
    less = (tuple(std * (2 if block in (0, 1, 2, 6) else 1) for block, std in enumerate(T2M[0])), T2M[1])
    cases = (
        (PLAIN, "these are published statistics"),
        (
            divided,
            r"mean root height is 0.9385, 0.9175 in the statistics that belong to the guo evaluator of HumanML3D",
        ),
        (contacts, "the std of numbers 259 to 262 is 0.352, 0.0141 in the statistics"),
        (less, "the std of numbers 0 to 0 is 0.00103, 0.000515 in"),
    )
    for index, (signature, message) in enumerate(cases):
        folder = write_statistics(tmp_path / f"wrong-{index}", signature)
        with pytest.raises(GuoError, match=f"wrong-{index}: .*{message}"):
            read_statistics(folder, t2m)
    with pytest.raises(GuoError, match=r"mean.npy: array of shape \(251,\), expected \(263\)"):
        read_statistics(tmp_path / "kit", t2m)
    with pytest.raises(GuoError, match=r"there is no mean.npy and std.npy, or .*t2m_mean.npy and t2m_std.npy"):
        read_statistics(tmp_path, t2m)
    np.save(tmp_path / "right" / "std.npy", np.full(263, np.nan))
    with pytest.raises(GuoError, match="must be finite"):
        read_statistics(tmp_path / "right", t2m)
    (tmp_path / "right" / "std.npy").write_bytes(b"\x93NUMPY")
    with pytest.raises(GuoError, match=r"std.npy: "):
        read_statistics(tmp_path / "right", t2m)


def test_the_dataset_s_own_statistics_are_refused(golden_humanml3d: Path, tmp_path: Path) -> None:
    mean, std = np.load(golden_humanml3d / "Mean.npy"), np.load(golden_humanml3d / "Std.npy")
    for weight, message in ((1, "these are published statistics"), (25, "mean root height is 0.9386")):
        weighted = std.copy()
        weighted[[*range(4), *range(259, 263)]] /= weight
        np.save(tmp_path / "mean.npy", mean)
        np.save(tmp_path / "std.npy", weighted)
        with pytest.raises(GuoError, match=message):
            read_statistics(tmp_path, KINDS[259])


GLOVE_FAULTS: dict[str, tuple[str, object, str]] = {
    "a list of places": ("our_vab_idx.pkl", ["sos"], "expected a dictionary from words to their rows"),
    "another class": ("our_vab_idx.pkl", OrderedDict(sos=0), "OrderedDict', which would be code to run"),
    "no start": ("our_vab_idx.pkl", {"eos": 0, "unk": 1}, "the word 'sos' is missing"),
    "a row outside": ("our_vab_idx.pkl", {"sos": 0, "eos": 1, "unk": 99, "a": 2}, "'unk' is row 99 of 20"),
}


@pytest.mark.parametrize("name", GLOVE_FAULTS)
def test_other_word_vectors_are_refused(tmp_path: Path, name: str) -> None:
    file, content, message = GLOVE_FAULTS[name]
    glove = write_glove(tmp_path)
    (glove / file).write_bytes(pickle.dumps(content))
    with pytest.raises(GuoError, match=message):
        read_word_vectors(glove)


def test_vectors_of_another_size_are_refused(tmp_path: Path) -> None:
    glove = write_glove(tmp_path)
    for array, message in (
        (np.zeros((20, 50), np.float32), r"of shape \(20, 50\), expected \(any, 300\)"),
        (np.full((20, 300), np.nan), "expected finite"),
        (np.full((20, 300), 0x7F800001, np.uint32).view(np.float32), "expected finite"),  # warns where it is converted
        (np.zeros((20, 300), np.int64), "expected finite"),
    ):
        np.save(glove / "our_vab_data.npy", array)
        with pytest.raises(GuoError, match=message):
            read_word_vectors(glove)
    (glove / "our_vab_data.npy").unlink()
    with pytest.raises(GuoError, match=r"our_vab_data.npy"):
        read_word_vectors(glove)
