"""What published repositories write is read as it stands: motions, captions, prompts, lengths."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from eval.sample_folder import SampleFolder, SampleFolderError, SampleOptions, read_sample_folder
from motionkit.core.moments import moments
from tests.helpers import published_layouts as published

AT_20 = SampleOptions(Fraction(20))
IN_FILE_ORDER = (0, 3, 1, 4, 2, 5)  # prompt by prompt, where the published order is repetition by repetition


def read(folder: Path) -> SampleFolder:
    return read_sample_folder("mine", folder, AT_20)


@pytest.mark.parametrize("export", [False, True])
def test_mdm(tmp_path: Path, export: bool) -> None:
    folder = published.write_mdm(tmp_path, export=export)
    file = folder / ("results.npz" if export else "results.npy")
    for source in (folder, file):
        samples = read(source)
        published.same_order(samples.sequences, range(6))
        assert samples.captions == published.CAPTIONS * 2
        assert samples.groups == ("0", "1", "2", "0", "1", "2")
        assert samples.sequence_ids[:2] == ("results/0000", "results/0001")
        assert set(samples.fps) == {20}
        assert samples.at(Fraction(20)).rows_by_group() == {"0": [0, 3], "1": [1, 4], "2": [2, 5]}


def test_mld_demo(tmp_path: Path) -> None:
    samples = read(published.write_mld_demo(tmp_path))
    published.same_order(samples.sequences, range(6))
    assert samples.captions == published.CAPTIONS * 2
    assert "6 real motions (*_ref) left out" in samples.describe()


def test_mld_predictions_of_a_test_are_cut_to_their_lengths(tmp_path: Path) -> None:
    folder = published.write_mld_test(tmp_path)
    samples = read(folder)
    published.same_order(samples.sequences, IN_FILE_ORDER)
    assert samples.groups == ("000000", "000000", "000001", "000001", "000002", "000002")
    (folder / "lengths.csv").unlink()
    assert "6 motions end in a frozen pose" in read(folder).describe()
    (folder / "samples.toml").write_text('name = "{group}_{repeat}"')
    assert read(folder).groups == samples.groups


def test_t2m_gpt(tmp_path: Path) -> None:
    samples = read(published.write_t2m_gpt(tmp_path))
    published.same_order(samples.sequences, range(6))
    assert "6 real motions (*_gt) left out" in samples.describe()
    with pytest.raises(SampleFolderError, match=r"6 of 6 motions have no caption, the first is '000000_pred'"):
        samples.require_captions()
    rows = [f'{index:06d}_pred.npy,"{caption}"\n' for index, caption in enumerate(published.CAPTIONS * 2)]
    (tmp_path / "captions.csv").write_text("file,caption\n" + "".join(rows))
    captioned = read(tmp_path)
    captioned.require_captions()
    assert captioned.captions == published.CAPTIONS * 2
    (tmp_path / "samples.toml").write_text('files = ["*_gt.npy"]')
    assert read(tmp_path).sequence_ids[0] == "000000_gt"


def statistics() -> tuple[np.ndarray, np.ndarray]:
    found = moments(np.concatenate(published.vectors()))
    return found.mean.astype(np.float32), np.maximum(found.std, 0.01).astype(np.float32)


def test_t2m_gpt_vectors_with_their_own_statistics(tmp_path: Path) -> None:
    samples = read_sample_folder("mine", published.write_t2m_gpt_vectors(tmp_path, *statistics()))
    assert samples.sequence_ids == tuple(f"{index:06d}" for index in range(6))
    for found, whole in zip(samples.sequences, published.motions(), strict=True):
        np.testing.assert_allclose(found, whole[:-1], rtol=0, atol=2e-3)


def test_momask(tmp_path: Path) -> None:
    folder = published.write_momask(tmp_path)
    samples = read(folder)
    published.same_order(samples.sequences, IN_FILE_ORDER)
    assert samples.captions == tuple(caption for caption in published.CAPTIONS for _ in range(2))
    assert samples.groups == ("0", "0", "1", "1", "2", "2")
    told = samples.describe()
    assert "12 foot-corrected copies (*_ik) left out" in told
    assert "6 .bvh files of the same names as the arrays left out" in told
    (folder / "samples.toml").write_text('fps = 20\nfiles = ["joints/**/*_ik.npy"]')
    corrected = read(folder)
    assert len(corrected.sequences) == 6
    np.testing.assert_allclose(corrected.sequences[0], published.motions()[0] + 1, atol=1e-6)


def test_bvh_says_its_own_framerate_and_unit(tmp_path: Path) -> None:
    published.write_momask(tmp_path)
    samples = read_sample_folder("mine", tmp_path / "animations")
    assert set(samples.fps) == {20}
    assert samples.groups == ("0", "0", "1", "1", "2", "2")
    for found, index in zip(samples.sequences, IN_FILE_ORDER, strict=True):
        np.testing.assert_allclose(found[:, 0], published.motions()[index][:, 0], atol=1e-5)


def test_kit_joints_want_their_unit(tmp_path: Path) -> None:
    with pytest.raises(SampleFolderError, match=r"unit_metres = 0.0017 into samples.toml if .* KIT-ML's unit"):
        read(published.write_kit_joints(tmp_path, None))
    samples = read(published.write_kit_joints(tmp_path, 0.0017))
    assert set(samples.fps) == {Fraction(25, 2)}
    assert samples.sequences.values.shape[1:] == (22, 3)
    assert 1.4 < samples.sequences.values[:, 15, 1].max() < 2.0


def test_a_folder_of_this_project_says_everything_itself(tmp_path: Path) -> None:
    for index, joints in enumerate(published.motions()):
        np.savez(tmp_path / f"{index}.npz", joint_positions=joints, fps=20 + 10 * (index % 2), captions=["walks"])
    samples = read_sample_folder("mine", tmp_path)
    published.same_order(samples.sequences, range(6))
    assert samples.captions == ("walks",) * 6
    assert "20 fps (3), 30 fps (3)" in samples.describe()
    at_30 = samples.at(Fraction(30))
    np.testing.assert_array_equal(at_30.sequences[1], published.motions()[1])
    assert len(at_30.sequences[0]) == 79
