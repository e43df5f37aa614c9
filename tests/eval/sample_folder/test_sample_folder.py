"""Folders of samples: what published repositories write is read as it stands, what is wrong is refused or left out."""

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from eval.sample_folder import SampleFolder, SampleFolderError, SampleOptions, read_sample_folder
from eval.sample_folder.arrays import read_stored, split_motions
from eval.sample_folder.reading import read_manifest
from motionkit.core.errors import FormatError
from motionkit.core.moments import moments
from motionkit.features.layout import SMPL22_LAYOUT
from motionkit.io.smpl_body import mean_shape_skeleton
from tests.helpers import published_layouts as published
from tests.helpers.vector_samples import dart_rows, hymotion_rows, walk

JOINTS = published.motions()[0]
BROKEN = JOINTS.copy()
BROKEN[7, 3] = np.nan
AT_20 = SampleOptions(Fraction(20))
IN_FILE_ORDER = (0, 3, 1, 4, 2, 5)  # prompt by prompt, where the published order is repetition by repetition


def read(folder: Path, options: SampleOptions = AT_20) -> SampleFolder:
    return read_sample_folder("mine", folder, options)


def folder_of(folder: Path, manifest: str = "fps = 20", **arrays: np.ndarray) -> Path:
    for name, array in arrays.items():
        np.save(folder / f"{name}.npy", array)
    if manifest:
        (folder / "samples.toml").write_text(manifest)
    return folder


def fault(folder: Path, options: SampleOptions = AT_20) -> str:
    with pytest.raises((SampleFolderError, FormatError)) as raised:
        read(folder, options)
    return str(raised.value)


@pytest.mark.parametrize("export", [False, True])
def test_mdm(tmp_path: Path, export: bool) -> None:
    folder = published.write_mdm(tmp_path, export=export)
    for source in (folder, folder / ("results.npz" if export else "results.npy")):
        samples = read(source)
        published.same_order(samples.sequences, range(6))
        assert samples.captions == published.CAPTIONS * 2
        assert samples.groups == ("0", "1", "2", "0", "1", "2")
        assert samples.sequence_ids[:2] == ("results/0000", "results/0001")
        assert samples.at(Fraction(20)).rows_by_group() == {"0": [0, 3], "1": [1, 4], "2": [2, 5]}


def test_mld(tmp_path: Path) -> None:
    for name in ("demo", "test"):
        (tmp_path / name).mkdir()
    demo = read(published.write_mld_demo(tmp_path / "demo"))
    published.same_order(demo.sequences, range(6))
    assert demo.captions == published.CAPTIONS * 2
    assert "6 files *_ref.* left out" in demo.describe()
    folder = published.write_mld_test(tmp_path / "test")
    padded = read(folder)
    published.same_order(padded.sequences, IN_FILE_ORDER)
    assert padded.groups == ("000000", "000000", "000001", "000001", "000002", "000002")
    (folder / "lengths.csv").unlink()
    assert "6 motions with a frozen pose at the end" in read(folder).describe()


def test_t2m_gpt(tmp_path: Path) -> None:
    samples = read(published.write_t2m_gpt(tmp_path))
    published.same_order(samples.sequences, range(6))
    assert "6 files *_gt.* left out" in samples.describe()
    with pytest.raises(SampleFolderError, match=r"6 of 6 motions have no caption, the first is '000000_pred'"):
        samples.require("caption")
    rows = [f'{index:06d}_pred.npy,"{caption}"\n' for index, caption in enumerate(published.CAPTIONS * 2)]
    (tmp_path / "captions.csv").write_text("file,caption\n" + "".join(rows))
    captioned = read(tmp_path)
    captioned.require("caption")
    assert captioned.captions == published.CAPTIONS * 2
    (tmp_path / "samples.toml").write_text('files = ["*_gt.npy"]')
    assert read(tmp_path).sequence_ids[0] == "000000_gt"


def test_momask(tmp_path: Path) -> None:
    folder = published.write_momask(tmp_path)
    alone = read(folder / "animations")
    for samples in (read(folder), alone):
        assert samples.groups == ("0", "0", "1", "1", "2", "2") and set(samples.fps) == {20}
    published.same_order(read(folder).sequences, IN_FILE_ORDER)
    for found, index in zip(alone.sequences, IN_FILE_ORDER, strict=True):
        np.testing.assert_allclose(found[:, 0], published.motions()[index][:, 0], atol=1e-5)
    assert read(folder).captions == tuple(caption for caption in published.CAPTIONS for _ in range(2))
    notes = read(folder).describe()
    assert "12 files *_ik.* left out" in notes and "6 files *.bvh of the same names as the arrays left out" in notes
    (folder / "samples.toml").write_text('fps = 20\nfiles = ["joints/**/*_ik.npy"]')
    np.testing.assert_allclose(read(folder).sequences[0], published.motions()[0] + 1, atol=1e-6)


def test_kit_joints(tmp_path: Path) -> None:
    assert "in KIT-ML's unit it would be" in fault(published.write_kit_joints(tmp_path, None))
    samples = read(published.write_kit_joints(tmp_path, 0.0017))
    assert set(samples.fps) == {Fraction(25, 2)}
    assert samples.sequences.values.shape[1:] == (22, 3)
    assert 1.4 < samples.sequences.values[:, 15, 1].max() < 2.0


def test_a_folder_of_this_project_is_complete(tmp_path: Path) -> None:
    for index, joints in enumerate(published.motions()):
        np.savez(tmp_path / f"{index}.npz", joint_positions=joints, fps=20 + 10 * (index % 2), captions=["walks"])
    samples = read_sample_folder("mine", tmp_path)
    published.same_order(samples.sequences, range(6))
    assert samples.captions == ("walks",) * 6
    assert "20 fps (3), 30 fps (3)" in samples.describe()


def test_framerates_are_stated_by_the_manifest_the_csv_the_file_or_the_option(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "", a=JOINTS)
    assert f"write fps = 20 (or what it is) into {folder}/samples.toml" in fault(folder, SampleOptions())
    for name, text, fps in (
        ("", "", 25),
        ("motions.json", json.dumps({"fps": 30}), 30),
        ("rates.csv", "file,fps\na.npy,60\n", 60),
        ("samples.toml", "fps = 24", 24),
    ):
        if name:
            (folder / name).write_text(text)
        assert read(folder, SampleOptions(Fraction(25))).fps == (Fraction(fps),)
    np.savez(folder / "b.npz", joint_positions=JOINTS, fps=60)
    for name in ("samples.toml", "rates.csv", "motions.json"):
        (folder / name).unlink()
    samples = read(folder, SampleOptions())
    assert (samples.sequence_ids, samples.fps) == (("b",), (Fraction(60),))
    assert [(problem.path.name, problem.reason) for problem in samples.left_out] == [("a.npy", "framerate")]


@pytest.mark.parametrize(
    ("array", "expected"),
    [
        (JOINTS.transpose(1, 2, 0), JOINTS),
        (JOINTS.transpose(1, 2, 0)[None], JOINTS),
        (JOINTS[:22].transpose(1, 2, 0), JOINTS[:22]),
        (JOINTS[:3].transpose(1, 2, 0), JOINTS[:3]),
        (np.concatenate((JOINTS, JOINTS[:, :2]), axis=1).astype(np.float64), JOINTS),
        (np.concatenate((JOINTS, np.zeros((9, 22, 3), np.float32))), JOINTS),  # padding
    ],
)
def test_axes_are_distinguished_by_where_the_3_stands(tmp_path: Path, array: np.ndarray, expected: np.ndarray) -> None:
    samples = read(folder_of(tmp_path, a=array))
    np.testing.assert_array_equal(samples.sequences.values, expected)
    assert samples.sequence_ids == ("a",)


def test_axes_of_vectors_and_ambiguous_ones() -> None:
    rows = published.vectors()[0]
    for array in (rows, rows[None], rows.T[:, None], rows.T[None, :, None]):
        (found,) = split_motions(array, Path("a.npy"))
        np.testing.assert_array_equal(found, rows)
    for shape in ((40, 3, 22), (40, 66), (40, 23, 3), (5,), (2, 2, 40, 22, 3), (40, 263, 2)):
        with pytest.raises(FormatError, match=r"expected frames × joints × 3 or joints × 3 × frames"):
            split_motions(np.zeros(shape), Path("a.npy"))


def test_what_is_no_body_is_refused(tmp_path: Path) -> None:
    assert "in cm it would be 1.4" in fault(folder_of(tmp_path, a=JOINTS * 100))
    samples = read(folder_of(tmp_path, "fps = 20\nunit_metres = 0.01"))
    np.testing.assert_allclose(samples.sequences.values, JOINTS, rtol=1e-5, atol=1e-6)
    assert "no usual unit explains" in fault(folder_of(tmp_path, "fps = 20\nunit_metres = 1e-4"))
    size = 1 + 0.6 * np.sin(np.arange(len(JOINTS), dtype=np.float32))
    assert "the bones' lengths vary by" in fault(folder_of(tmp_path, a=JOINTS * size[:, None, None]))


def test_z_up_is_turned_where_most_bodies_stand_along_z(tmp_path: Path) -> None:
    arrays = {
        f"m{index}": np.stack((joints[..., 0], -joints[..., 2], joints[..., 1]), axis=-1)
        for index, joints in enumerate(published.motions())
    }
    samples = read(folder_of(tmp_path, "fps = 20", **arrays))
    published.same_order(samples.sequences, range(6), atol=1e-6)
    assert "turned from z up to y up" in samples.describe()
    np.testing.assert_allclose(read(folder_of(tmp_path, 'fps = 20\nup = "y"')).sequences[0], arrays["m0"])


def test_broken_motions_are_left_out_by_name(tmp_path: Path) -> None:
    huge = JOINTS.copy()
    huge[9] = 1e30
    folder = folder_of(tmp_path, a=JOINTS, b=BROKEN, c=huge, d=np.zeros((4, 5)), e=0 * JOINTS, i=1000 * JOINTS)
    (folder / "f.npy").write_bytes(b"\x93NUMPY")
    (folder / "g.bvh").write_text("HIERARCHY\n")
    np.save(folder / "h.npy", np.stack((JOINTS, BROKEN)))
    np.save(folder / "j.npy", np.stack((JOINTS, JOINTS / 100)))
    samples = read(folder)
    assert samples.sequence_ids == ("a", "h/0000", "j/0000")
    found = {problem.path.name: problem for problem in samples.left_out}
    assert {name: (problem.reason, problem.frame) for name, problem in found.items() if name != "g.bvh"} == {
        **{"b.npy": ("nan", 7), "c.npy": ("range", 9), "d.npy": ("channel-count", None)},
        **{"e.npy": ("no-frames", None), "f.npy": ("truncated", None), "h.npy": ("nan", 7)},
        **{"i.npy": ("body-size", None), "j.npy": ("body-size", None)},
    }
    assert found["j.npy"].message.startswith("j/0001: ")
    assert "9 of 12 motions left out" in samples.describe()


def test_nothing_readable_and_nothing_at_all(tmp_path: Path) -> None:
    assert "there is no folder" in fault(tmp_path / "nowhere")
    (tmp_path / "samples.pkl").write_bytes(b"\x80\x04N.")
    assert "no motion was found" in fault(tmp_path)
    assert "1 of 1 motions left out (1 nan)" in fault(folder_of(tmp_path, a=np.full((4, 22, 3), np.nan)))


def test_a_csv_row_without_its_file_is_reported(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, a=JOINTS)
    (folder / "texts.csv").write_text(
        f"file,caption,num_frames\na.npy,walks,9\n{'b' * 300},runs,\n../c.npy,x,\nd.npy,,0\n"
    )
    samples = read(folder)
    assert (samples.captions, samples.sequences.values.shape[0]) == (("walks",), 9)
    assert "1 row of the CSV without a file, first 'bb" in samples.describe()
    assert [problem.reason for problem in samples.left_out] == ["path", "annotations"]


@pytest.mark.parametrize(
    ("extra", "reason"),
    [
        ({"text": [[[["x"] * 99] * 99] * 99] * 2}, "text"),  # a million letters, if it were written out
        ({"lengths": [[1, 2], [3]]}, "lengths"),
        ({"num_samples": 16**9000, "num_repetitions": 1}, "channel-count"),
        ({"fps": [20]}, "framerate"),
    ],
)
def test_invalid_dictionaries_are_refused(tmp_path: Path, extra: dict[str, object], reason: str) -> None:
    path = tmp_path / "results.npy"
    np.save(path, {"motion": np.stack((JOINTS, JOINTS)), **extra}, allow_pickle=True)  # type: ignore[arg-type]
    with pytest.raises(FormatError) as raised:
        read_stored(path)
    assert raised.value.reason == reason and len(str(raised.value)) < 400


RAW, NORMALISED = 'statistics = "raw"', 'statistics = "normalised"\nmean = "mean.npy"\nstd = "std.npy"'


def vectors_in(folder: Path, of: str, restore_with: str, manifest: str = NORMALISED) -> Path:
    """Vectors normalised with the statistics `of`, in a folder whose mean.npy and std.npy are of `restore_with`."""
    rows = published.vectors()
    found = moments(np.concatenate(rows))
    std = found.std
    for block in SMPL22_LAYOUT.vector:
        std[block] = std[block].mean()
    evaluator = std.copy()
    evaluator[:4] /= 25
    evaluator[-4:] /= 25
    stds = {"published": std, "evaluator": evaluator, "raw": np.ones_like(std)}
    means = {"published": found.mean, "evaluator": found.mean, "raw": np.zeros_like(std)}
    arrays = {f"m{index}": ((one - means[of]) / stds[of]).astype(np.float32) for index, one in enumerate(rows)}
    return folder_of(folder, manifest, **arrays, mean=means[restore_with], std=stds[restore_with])


@pytest.mark.parametrize("of", ["published", "evaluator"])
def test_vectors_come_back_with_their_own_statistics(tmp_path: Path, of: str) -> None:
    samples = read(vectors_in(tmp_path, of, of))
    for found, whole in zip(samples.sequences, published.motions(), strict=True):
        np.testing.assert_allclose(found, whole[:-1], rtol=0, atol=2e-3)


@pytest.mark.parametrize(
    ("of", "restore_with", "manifest", "message"),
    [
        ("published", "published", "", "nothing says whether they are normalised"),
        ("published", "published", RAW, "said to be raw, but they make no body"),
        ("raw", "published", NORMALISED, "so they look raw"),
        ("published", "evaluator", NORMALISED, "root's own velocity varies"),
        ("evaluator", "published", NORMALISED, "root's own velocity varies"),
        ("published", "raw", NORMALISED, "but they make no body"),
    ],
)
def test_statistics_that_do_not_fit_are_refused(
    tmp_path: Path, of: str, restore_with: str, manifest: str, message: str
) -> None:
    assert message in fault(vectors_in(tmp_path, of, restore_with, manifest))


def test_vectors_of_a_shared_width_are_named(tmp_path: Path) -> None:
    motion = walk()
    folder = folder_of(tmp_path, "fps = 30", a=dart_rows(motion))
    assert 'vectors = "motion-135"' in fault(folder)
    (folder / "samples.toml").write_text('fps = 30\nvectors = "dart-276"')
    samples = read(folder)
    assert samples.fps == (Fraction(30),)
    np.testing.assert_allclose(samples.sequences[0], motion.joint_positions[:-1], atol=1e-5)


def test_motius_archives_and_tables_of_the_robot(tmp_path: Path) -> None:
    rows = hymotion_rows(walk(), mean_shape_skeleton().offsets[0])[:, :135]
    np.savez(tmp_path / "a.npz", motion_135=rows)
    (tmp_path / "b.csv").write_text(f"{','.join(['0,0,0.79,1', *'0' * 32])}\n" * 40)
    samples = read(tmp_path)
    assert (samples.sequence_ids, set(samples.fps), samples.left_out) == (("a", "b"), {Fraction(30)}, ())
    assert samples.sequences.num_frames.tolist() == [len(rows), 40]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("fps = ", "not TOML"),
        ("frames = 20", "unknown key 'frames'"),
        ('statistics = "published"', "expected 'raw' or 'normalised'"),
        ('prompts = "none.txt"', "no such file in this folder"),
        ('mean = "../mean.npy"', "leaves the folder"),
        ('prompts = "link.txt"', "leaves the folder"),
        ('std = "up/secret.txt"', "leaves the folder"),
        (f"fps = 0x{'f' * 5000}", "a framerate must lie between 1 and 10000"),
        (f"files = {'[' * 5000}", "not TOML (nested too deep)"),
    ],
)
def test_invalid_manifests_are_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "secret.txt").write_text("a secret\n")
    folder = tmp_path / "samples"
    folder.mkdir()
    (folder / "link.txt").symlink_to(tmp_path / "secret.txt")
    (folder / "up").symlink_to(tmp_path)
    (folder / "samples.toml").write_text(text)
    with pytest.raises(FormatError) as raised:
        read_manifest(folder)
    assert raised.value.reason == "manifest"
    assert message in str(raised.value)
