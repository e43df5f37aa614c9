"""Folders of samples with something wrong: what is refused, what is left out, and what people are told."""

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from eval.sample_folder import SampleFolder, SampleFolderError, SampleOptions, read_sample_folder
from eval.sample_folder.arrays import read_stored, split_motions
from eval.sample_folder.manifest import name_expression, read_manifest
from motionkit.core.errors import FormatError
from motionkit.core.moments import moments
from motionkit.features.layout import vector_layout
from tests.helpers import published_layouts as published

JOINTS = published.motions()[0]


def folder_of(tmp_path: Path, manifest: str = "fps = 20", **arrays: np.ndarray) -> Path:
    for name, array in arrays.items():
        np.save(tmp_path / f"{name}.npy", array)
    if manifest:
        (tmp_path / "samples.toml").write_text(manifest)
    return tmp_path


def read(folder: Path, options: SampleOptions | None = None) -> SampleFolder:
    return read_sample_folder("mine", folder, options)


def fault(folder: Path) -> str:
    with pytest.raises((SampleFolderError, FormatError)) as told:
        read(folder)
    return str(told.value)


def test_the_framerate_is_asked_for_with_the_line_to_write(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "", a=JOINTS)
    assert f"a.npy: nothing says its framerate; write fps = 20 (or what it is) into {folder}/samples.toml" in fault(
        folder
    )
    assert read(folder, SampleOptions(Fraction(25))).fps == (25,)
    (folder / "motions.json").write_text(json.dumps({"fps": 30}))
    assert read(folder, SampleOptions(Fraction(25))).fps == (30,)
    (folder / "rates.csv").write_text("file,fps\na.npy,60\n")
    assert read(folder).fps == (60,)
    (folder / "samples.toml").write_text("fps = 24")
    assert read(folder).fps == (24,)


@pytest.mark.parametrize(
    ("array", "expected"),
    [
        (JOINTS, JOINTS),
        (JOINTS.transpose(1, 2, 0), JOINTS),
        (JOINTS[None], JOINTS),
        (JOINTS.transpose(1, 2, 0)[None], JOINTS),
        (JOINTS[:22], JOINTS[:22]),
        (JOINTS[:22].transpose(1, 2, 0), JOINTS[:22]),
        (JOINTS[:3].transpose(1, 2, 0), JOINTS[:3]),
        (np.concatenate((JOINTS, JOINTS[:, :2]), axis=1).astype(np.float64), JOINTS),
        (np.asfortranarray(JOINTS), JOINTS),
    ],
)
def test_axes_are_distinguished_by_where_the_3_stands(tmp_path: Path, array: np.ndarray, expected: np.ndarray) -> None:
    samples = read(folder_of(tmp_path, a=array))
    np.testing.assert_array_equal(samples.sequences.values, expected)
    assert samples.sequence_ids == ("a",)


@pytest.mark.parametrize("shape", [(40, 3, 22), (40, 66), (40, 23, 3), (5,), (2, 2, 40, 22, 3), (40, 263, 2)])
def test_axes_that_could_be_mistaken_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(FormatError, match=r"expected frames × joints × 3 or joints × 3 × frames"):
        split_motions(np.zeros(shape), Path("a.npy"))


def test_vectors_of_mdm_s_own_order_are_rows(tmp_path: Path) -> None:
    rows = published.vectors()[0]
    for array in (rows, rows[None], rows.T[:, None], rows.T[None, :, None]):
        (found,) = split_motions(array, Path("a.npy"))
        np.testing.assert_array_equal(found, rows)


def test_metres_are_checked(tmp_path: Path) -> None:
    told = fault(folder_of(tmp_path, a=JOINTS * 100))
    assert "write unit_metres = 0.01 into samples.toml if the positions are in cm" in told
    samples = read(folder_of(tmp_path, "fps = 20\nunit_metres = 0.01"))
    np.testing.assert_allclose(samples.sequences.values, JOINTS, rtol=1e-5, atol=1e-6)
    assert "no usual unit explains" in fault(folder_of(tmp_path, "fps = 20\nunit_metres = 1e-4"))


def test_bones_that_breathe_are_no_body(tmp_path: Path) -> None:
    size = 1 + 0.6 * np.sin(np.arange(len(JOINTS), dtype=np.float32))
    assert "the bones' lengths vary by" in fault(folder_of(tmp_path, a=JOINTS * size[:, None, None]))


def test_z_up_is_turned_where_most_bodies_stand_along_z(tmp_path: Path) -> None:
    def z_up(joints: np.ndarray) -> np.ndarray:
        return np.stack((joints[..., 0], -joints[..., 2], joints[..., 1]), axis=-1)

    standing = published.motions()
    arrays = {f"m{index}": z_up(joints) for index, joints in enumerate(standing)}
    samples = read(folder_of(tmp_path, **arrays))
    published.same_order(samples.sequences, range(6), atol=1e-6)
    assert "turned from z up to y up" in samples.describe()
    np.testing.assert_allclose(read(folder_of(tmp_path, 'fps = 20\nup = "y"')).sequences[0], z_up(standing[0]))


LYING = np.stack((JOINTS[..., 0], -JOINTS[..., 2] + 1, JOINTS[..., 1]), axis=-1)


@pytest.mark.parametrize(
    ("array", "reason"),
    [
        (1000 * JOINTS, "body-size"),
        (JOINTS / 100, "body-size"),
        (LYING, "lying"),
        (LYING[..., [2, 0, 1]], "lying"),
        (JOINTS * np.float32([1, -1, -1]), "lying"),
    ],
    ids=["millimetres", "a hundredth", "z up", "x up", "y down"],
)
def test_a_motion_that_is_no_body_is_left_out_by_name(tmp_path: Path, array: np.ndarray, reason: str) -> None:
    arrays = {f"m{index}": joints for index, joints in enumerate(published.motions())}
    folder = folder_of(tmp_path, **arrays, odd=array)
    np.save(folder / "pair.npy", np.stack((JOINTS, array)))
    samples = read(folder)
    assert samples.sequence_ids == (*arrays, "pair/0000")
    for name, sequence in zip(arrays, samples.sequences, strict=False):
        np.testing.assert_array_equal(sequence, arrays[name])
    left_out = {problem.path.name: problem for problem in samples.left_out}
    assert {name: problem.reason for name, problem in left_out.items()} == {"odd.npy": reason, "pair.npy": reason}
    assert left_out["pair.npy"].message.startswith("motion 0001: ")
    assert f"2 of 9 motions left out (2 {reason})" in samples.describe()


def test_bodies_lie_on_purpose_where_up_is_stated(tmp_path: Path) -> None:
    samples = read(folder_of(tmp_path, 'fps = 20\nup = "y"', a=JOINTS, b=LYING))
    np.testing.assert_array_equal(samples.sequences[1], LYING)


def test_one_file_without_a_framerate_is_left_out_by_name(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "", a=JOINTS)
    np.savez(folder / "b.npz", joint_positions=JOINTS, fps=60)
    samples = read(folder)
    assert (samples.sequence_ids, samples.fps) == (("b",), (60,))
    assert [(problem.path.name, problem.reason) for problem in samples.left_out] == [("a.npy", "framerate")]
    assert read(folder, SampleOptions(Fraction(20))).fps == (20, 60)


def test_broken_motions_are_counted_and_left_out(tmp_path: Path) -> None:
    bad = JOINTS.copy()
    bad[7, 3] = np.nan
    huge = JOINTS.copy()
    huge[9] = 1e30
    folder = folder_of(tmp_path, a=JOINTS, b=bad, c=huge, d=np.zeros((4, 5)), e=np.zeros_like(JOINTS))
    (folder / "f.npy").write_bytes(b"\x93NUMPY")
    (folder / "g.bvh").write_text("HIERARCHY\n")
    np.save(folder / "h.npy", np.stack((JOINTS, bad)))
    samples = read(folder)
    assert samples.sequence_ids == ("a", "h/0000")
    reasons = {problem.path.name: (problem.reason, problem.frame) for problem in samples.left_out}
    assert reasons["b.npy"] == ("nan", 7)
    assert reasons["c.npy"] == ("range", 9)
    assert reasons["h.npy"] == ("nan", 7)
    assert {name: reason for name, (reason, _) in reasons.items()} == {
        **{"b.npy": "nan", "c.npy": "range", "d.npy": "channel-count", "e.npy": "no-frames", "f.npy": "truncated"},
        **{"g.bvh": reasons["g.bvh"][0], "h.npy": "nan"},
    }
    assert "7 of 9 motions left out" in samples.describe()


def test_nothing_readable_and_nothing_at_all(tmp_path: Path) -> None:
    assert "there is no folder" in fault(tmp_path / "nowhere")
    assert "no motion was found" in fault(tmp_path)
    (tmp_path / "samples.pkl").write_bytes(b"\x80\x04N.")
    assert "it has 1 .pkl (a .pkl or .pt can execute code: export its arrays, docs/samples.md)" in fault(tmp_path)
    assert "no motion can be read: 1 of 1 motions left out (nan); first" not in fault(tmp_path)
    told = fault(folder_of(tmp_path, a=np.full((4, 22, 3), np.nan)))
    assert "no motion can be read: 1 of 1 motions left out (1 nan); first" in told


def test_zeros_at_the_end_are_padding(tmp_path: Path) -> None:
    samples = read(folder_of(tmp_path, a=np.concatenate((JOINTS, np.zeros((9, 22, 3), np.float32)))))
    np.testing.assert_array_equal(samples.sequences.values, JOINTS)
    assert "of 1 motions the last frames, all zeros, were dropped" in samples.describe()


def normalised(tmp_path: Path, of: str, restore_with: str, claim: str = "normalised") -> Path:
    """Vectors normalised with the statistics `of`, in a folder that names those called `restore_with`."""
    rows = published.vectors()
    found = moments(np.concatenate(rows))
    layout = vector_layout(22)
    std = found.std
    for block in layout.blocks:
        std[block] = std[block].mean()
    evaluator = std.copy()
    evaluator[:4] /= 25
    evaluator[-4:] /= 25
    known = {"published": std, "evaluator": evaluator, "raw": np.ones_like(std)}
    mean = {"published": found.mean, "evaluator": found.mean, "raw": np.zeros_like(std)}
    arrays = {f"m{index}": ((one - mean[of]) / known[of]).astype(np.float32) for index, one in enumerate(rows)}
    manifest = 'statistics = "normalised"\nmean = "mean.npy"\nstd = "std.npy"'
    return folder_of(
        tmp_path,
        {"normalised": manifest, "raw": 'statistics = "raw"', "": ""}[claim],
        **arrays,
        mean=mean[restore_with],
        std=known[restore_with],
    )


@pytest.mark.parametrize("of", ["published", "evaluator"])
def test_vectors_come_back_with_their_own_statistics(tmp_path: Path, of: str) -> None:
    samples = read(normalised(tmp_path, of, of))
    for found, whole in zip(samples.sequences, published.motions(), strict=True):
        np.testing.assert_allclose(found, whole[:-1], rtol=0, atol=2e-3)


@pytest.mark.parametrize(
    ("of", "restore_with", "claim", "says"),
    [
        ("published", "published", "", "nothing says whether they are normalised"),
        ("published", "published", "raw", "said to be raw, but they make no body"),
        ("raw", "published", "normalised", "so they look raw"),
        ("published", "evaluator", "normalised", "root's own velocity varies 0.04 times as much"),
        ("evaluator", "published", "normalised", "root's own velocity varies 25 times as much"),
        ("published", "raw", "normalised", "but they make no body"),
    ],
)
def test_statistics_that_do_not_fit_are_refused(
    tmp_path: Path, of: str, restore_with: str, claim: str, says: str
) -> None:
    assert says in fault(normalised(tmp_path, of, restore_with, claim))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("fps = ", "not TOML"),
        ("frames = 20", "unknown key 'frames'"),
        ("fps = true", "expected a framerate"),
        ("unit_metres = -1", "length of the files' unit"),
        ('up = "down"', "expected 'x' or 'y' or 'z'"),
        ('statistics = "published"', "expected 'raw' or 'normalised'"),
        ('statistics = "normalised"', "needs mean"),
        ('mean = "../mean.npy"', "leaves the folder"),
        ('mean = "/etc/passwd"', "leaves the folder"),
        ('files = ["../*.npy"]', "leaves the folder"),
        ('prompts = "none.txt"', "no such file in this folder"),
        ('name = "{who}"', "unknown field {who}"),
        ('name = "{group}{group}"', "{group} occurs twice"),
        ('name = "{any}{any}"', "{any} occurs twice"),
        (f'name = "{"{any}" * 300}"', "1,500 letters, expected at most 1,000"),
        (f"fps = 0x{'f' * 5000}", "a framerate must lie between 1 and 10000"),
        (f"fps = '{'9' * 400}/1'", "not a number of that many digits"),
        (f"files = {'[' * 5000}", "not TOML (nested too deep)"),
    ],
)
def test_manifests_that_cannot_be(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "samples.toml").write_text(text)
    with pytest.raises(FormatError) as told:
        read_manifest(tmp_path)
    assert told.value.reason == "manifest"
    assert says in str(told.value)


@pytest.mark.parametrize("key", ["prompts", "mean", "std"])
def test_no_link_leads_out_of_the_folder(tmp_path: Path, key: str) -> None:
    outside = tmp_path / "secret.txt"
    outside.write_text("a secret\n")
    folder = tmp_path / "samples"
    folder.mkdir()
    (folder / "link.txt").symlink_to(outside)
    (folder / "up").symlink_to(tmp_path)
    for name in ("link.txt", "up/secret.txt", "up/none.txt"):
        (folder / "samples.toml").write_text(f'{key} = "{name}"')
        with pytest.raises(FormatError, match="a link that leaves the folder; copy the file here") as told:
            read_manifest(folder)
        assert told.value.reason == "manifest"
    (folder / "here.txt").write_text("walks\n")
    (folder / "link.txt").unlink()
    (folder / "link.txt").symlink_to(folder / "here.txt")
    (folder / "samples.toml").write_text('prompts = "link.txt"')
    assert read_manifest(folder).prompts == folder / "link.txt"


def test_names_say_what_the_pattern_says(tmp_path: Path) -> None:
    match = name_expression("{action}-{group}_{repeat}_{any}_len{num_frames}").fullmatch("jump_up-12_3_x_len40")
    assert match is not None and match.groupdict() == {
        "action": "jump_up",
        "group": "12",
        "repeat": "3",
        "num_frames": "40",
    }
    samples = read(folder_of(tmp_path, 'fps = 20\nname = "{action}-{group}_{repeat}"', **{"jump_up-12_3": JOINTS}))
    assert (samples.actions, samples.groups) == (("jump up",), ("12",))
    samples.require_actions()
    np.save(tmp_path / "other.npy", JOINTS)
    assert "1 of 2 motions left out (1 name)" in read(tmp_path).describe()


def test_a_csv_row_without_its_file_is_reported(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, a=JOINTS)
    (folder / "texts.csv").write_text(
        f"file,caption,num_frames\na.npy,walks,9\n{'b' * 300},runs,\n../c.npy,x,\nd.npy,,0\n"
    )
    samples = read(folder)
    assert (samples.captions, samples.sequences.values.shape[0]) == (("walks",), 9)
    assert "1 rows of the CSV describe files that are not there, first 'bb" in samples.describe()
    assert [problem.reason for problem in samples.left_out] == ["path", "annotations"]


@pytest.mark.parametrize(
    ("extra", "reason"),
    [
        ({"text": 5}, "text"),
        ({"text": [[[["x"] * 99] * 99] * 99] * 2}, "text"),  # a million letters, if it were written out
        ({"lengths": [[1, 2], [3]]}, "lengths"),
        ({"num_samples": 1, "num_repetitions": [2]}, "channel-count"),
        ({"num_samples": 16**9000, "num_repetitions": 1}, "channel-count"),
        ({"fps": [20]}, "framerate"),
    ],
)
def test_dictionaries_that_say_nonsense(tmp_path: Path, extra: dict[str, object], reason: str) -> None:
    path = tmp_path / "results.npy"
    np.save(path, {"motion": np.stack((JOINTS, JOINTS)), **extra}, allow_pickle=True)  # type: ignore[arg-type]
    with pytest.raises(FormatError) as told:
        read_stored(path)
    assert told.value.reason == reason and len(str(told.value)) < 400


@pytest.mark.parametrize("wild", [3e38, np.inf, -np.inf])
def test_a_motion_of_wild_numbers_costs_only_itself(tmp_path: Path, wild: float) -> None:
    raw = published.vectors()
    bad = raw[0].copy()
    bad[3, 7] = wild
    samples = read(folder_of(tmp_path, 'statistics = "raw"', a=bad, b=raw[1], c=raw[2]))
    assert samples.sequence_ids == ("b", "c")
    assert [problem.frame for problem in samples.left_out] == [3]
