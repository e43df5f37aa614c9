"""Damaged and hostile .npz files: one explained error each, nothing unpacked beyond reason, nothing executed."""

import contextlib
import io
import pickle
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.io import npz_archive
from motionkit.io.amass import read_amass
from motionkit.io.pickled_data import parse_scalar
from motionkit.io.scan.items import ReadOptions, SourceItem
from motionkit.io.scan.scanner import scan
from tests.helpers.amass_samples import smplh_fields, stageii_fields, standing_poses, write_amass


def read_path(path: Path) -> Motion:
    return read_amass(SourceItem("amass", path, path.parent, "a"), ReadOptions())


def fault(path: Path) -> FormatError:
    with pytest.raises(FormatError) as caught:
        read_path(path)
    assert "\n" not in str(caught.value)
    return caught.value


def npy_member(header: str, content: bytes = b"") -> bytes:
    padded = header.encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(padded).to_bytes(2, "little") + padded + content


def with_members(path: Path, members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> Path:
    """A motion in which some members are replaced by these bytes."""
    write_amass(path, smplh_fields())
    with zipfile.ZipFile(path) as old:
        kept = {name: old.read(name) for name in old.namelist()}
    with zipfile.ZipFile(path, "w", method) as new:
        for name, content in (kept | members).items():
            new.writestr(name, content)
    return path


def test_arrays_that_are_no_motion_are_reported_by_name_and_reason(tmp_path: Path) -> None:
    nan = standing_poses()
    nan[2, 30] = np.nan
    huge = np.zeros((4, 3))
    huge[3, 1] = 1e12
    moving = np.zeros((4, 16))
    moving[1, 0] = 1.0
    cases: list[tuple[dict[str, object], str, str, int | None]] = [
        ({"poses": None}, "missing-key", "root_orient", None),
        ({"trans": None}, "missing-key", "trans", None),
        ({"poses": np.zeros((4, 100))}, "channel-count", "poses of 100 numbers", None),
        ({"poses": np.zeros((4, 165)), "surface_model_type": "smplh"}, "channel-count", "smplh", None),
        ({"poses": np.zeros((4, 52, 3))}, "channel-count", "poses", None),
        ({"poses": np.zeros((0, 156)), "trans": np.zeros((0, 3))}, "no-frames", "poses", None),
        ({"trans": np.zeros((3, 3))}, "channel-count", "trans", None),
        ({"trans": huge}, "range", "trans", 3),
        ({"poses": nan}, "nan", "poses", 2),
        ({"poses": standing_poses().astype(object)}, "object-array", "poses", None),
        ({"poses": standing_poses().astype("S4")}, "not-a-number", "poses", None),
        ({"poses": standing_poses().astype(complex)}, "not-a-number", "poses", None),
        ({"mocap_framerate": np.array([120.0, 60.0])}, "channel-count", "mocap_framerate", None),
        ({"mocap_framerate": np.array(120j)}, "not-a-number", "mocap_framerate", None),
        ({"mocap_framerate": np.array([1, 2], dtype=object)}, "framerate", "mocap_framerate", None),
        ({"mocap_framerate": np.array({"fps": 120}, dtype=object)}, "framerate", "mocap_framerate", None),
    ]
    for changes, reason, says, frame in cases:
        error = fault(write_amass(tmp_path / "a_poses.npz", smplh_fields(**changes)))
        assert (error.reason, error.frame) == (reason, frame), changes
        assert says in str(error)


def test_column_major_and_narrow_arrays_are_read(tmp_path: Path) -> None:
    poses = np.random.default_rng(0).normal(0, 0.5, (4, 156)).astype(np.float32)
    plain = read_path(write_amass(tmp_path / "a_poses.npz", smplh_fields(poses=poses)))
    for form in (np.asfortranarray(poses), poses.astype(">f4"), poses.astype(np.float64)):
        again = read_path(write_amass(tmp_path / "a_poses.npz", smplh_fields(poses=form)))
        assert np.array_equal(plain.joint_positions, again.joint_positions)


def test_bytes_that_are_no_archive(tmp_path: Path) -> None:
    path = write_amass(tmp_path / "a_poses.npz", smplh_fields())
    data = path.read_bytes()
    for content, reason in (
        (b"", "empty"),
        (b"\x93NUMPY" + data, "not-what-it-says"),
        (data[: len(data) // 2], "truncated"),
        (data[:-30], "truncated"),
        (data[:4], "truncated"),
        (data.replace(b"\x93NUMPY", b"\x93NUMPZ"), "truncated"),
    ):
        path.write_bytes(content)
        assert fault(path).reason == reason


def test_sizes_are_bounded_before_anything_is_unpacked(tmp_path: Path) -> None:
    zeros = npy_member("{'descr': '<f8', 'fortran_order': False, 'shape': (100000, 156), }", bytes(8 * 15_600_000))
    lying = npy_member("{'descr': '<f8', 'fortran_order': False, 'shape': (999999999, 156), }", bytes(1248))
    short = npy_member("{'descr': '<f8', 'fortran_order': False, 'shape': (4, 156), }", bytes(1248))
    bomb = with_members(tmp_path / "bomb_poses.npz", {"poses.npy": zeros})
    del zeros
    lies = with_members(tmp_path / "lie_poses.npz", {"poses.npy": lying})
    shorts = with_members(tmp_path / "short_poses.npz", {"poses.npy": short})
    long_name = with_members(tmp_path / "name_poses.npz", {"gender.npy": bytes(1 << 20)})
    tracemalloc.start()
    try:
        assert fault(bomb).reason == "too-large" and "claim to unpack" in str(fault(bomb))
        assert fault(lies).reason == "truncated"
        assert fault(shorts).reason == "truncated"
        assert read_path(long_name).num_frames == 4  # nothing asks for the gender without body models
        assert tracemalloc.get_traced_memory()[1] < 2**24
    finally:
        tracemalloc.stop()
    with pytest.raises(FormatError, match="gender: looks like"):
        npz_archive.read_scalar(npz_archive.open_archive(long_name, long_name.read_bytes()), "gender")


def test_sizes_in_the_zip_directory_are_not_believed(tmp_path: Path) -> None:
    path = write_amass(tmp_path / "a_poses.npz", smplh_fields(), compressed=True)
    data, whole = path.read_bytes(), read_path(path).joint_positions
    directory = data.rindex(b"PK\x01\x02", 0, data.index(b"poses.npy", data.index(b"PK\x01\x02")))
    for offset in (20, 24):  # compressed, then uncompressed size
        for size in (1 << 31, 0xFFFFFFFE, 7):
            changed = bytearray(data)
            changed[directory + offset : directory + offset + 4] = size.to_bytes(4, "little")
            path.write_bytes(changed)
            try:
                np.testing.assert_array_equal(read_path(path).joint_positions, whole)
            except FormatError as error:
                assert error.reason in ("truncated", "too-large")


def test_names_in_the_archive_are_keys_and_never_paths(tmp_path: Path) -> None:
    path = tmp_path / "in" / "a_poses.npz"
    write_amass(path, smplh_fields())
    with zipfile.ZipFile(path) as archive:
        poses = archive.read("poses.npy")
    for name in ("../poses.npy", "/poses.npy", "in/../poses.npy", "poses.npy/../../x"):
        write_amass(path, smplh_fields(poses=None))
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr(name, poses)
        assert fault(path).reason == "missing-key"
    assert sorted(entry.name for entry in tmp_path.rglob("*")) == ["a_poses.npz", "in"]


def test_other_compressions_and_encryption_are_refused(tmp_path: Path) -> None:
    path = with_members(tmp_path / "a_poses.npz", {}, method=zipfile.ZIP_BZIP2)
    assert fault(path).reason == "unreadable"
    write_amass(path, smplh_fields())
    data = bytearray(path.read_bytes())
    for place in (data.index(b"PK\x01\x02") + 8, 6):
        data[place] |= 1
    path.write_bytes(data)
    assert fault(path).reason == "truncated" and "encrypted" in str(fault(path))


class Payload:
    """What an unpickler would run."""

    def __reduce__(self) -> tuple[object, ...]:
        return exec, ("import pathlib; pathlib.Path('ran').touch()",)


def pickled(value: object, protocol: int = 4) -> bytes:
    return pickle.dumps(np.array(value, dtype=object), protocol=protocol)


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_constants_in_pickled_arrays_are_read(protocol: int) -> None:
    for value in ("male", 120, 59.94, 120.00004577636719):
        assert parse_scalar(pickled(value, protocol)) == value
        assert parse_scalar(pickled([value], protocol)) == value
    if protocol > 2:  # before, bytes are a call
        assert parse_scalar(pickled(b"female", protocol)) == "female"


def test_everything_else_in_a_pickle_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for value in (Payload(), [Payload()], {"a": 1}, ["male", "female"], None, Path("male")):
        for protocol in (2, 3, 4, 5):
            assert parse_scalar(pickled(value, protocol)) is None, value
    for content in (b"", b".", b"\x80\x04.", pickled("male")[:-1], pickled("male").replace(b"ndarray", b"recarra")):
        assert parse_scalar(content) is None
    fields = smplh_fields(gender=np.array(Payload(), dtype=object))
    assert read_path(write_amass(tmp_path / "a_poses.npz", fields)).num_frames == 4
    hostile = smplh_fields(mocap_framerate=np.array(Payload(), dtype=object))
    assert fault(write_amass(tmp_path / "a_poses.npz", hostile)).reason == "framerate"
    assert not Path("ran").exists()


def test_a_scan_of_broken_archives_finds_what_is_named_as_a_motion(tmp_path: Path) -> None:
    (tmp_path / "a_poses.npz").write_bytes(b"PK\x03\x04broken")
    (tmp_path / "b.npz").write_bytes(b"PK\x03\x04broken")
    found = scan([tmp_path], ReadOptions(format="amass"))
    assert [item.path.name for item in found.items] == ["a_poses.npz"]


def _bytes_of(fields: dict[str, object], compressed: bool) -> bytes:
    file = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(file, **fields)  # type: ignore[arg-type]
    return file.getvalue()


SAMPLES = [
    _bytes_of(smplh_fields(2, mocap_framerate=np.array(120.0, dtype=object)), compressed=False),
    _bytes_of(stageii_fields(2), compressed=True),
]
SNIPPETS = st.sampled_from([b"PK\x01\x02", b"PK\x05\x06", b"\x93NUMPY", b"'|O'", b"(9999999, 156)", b"\xff" * 4, b"\0"])


@st.composite
def damage(draw: st.DrawFn) -> bytes:
    content = draw(st.sampled_from(SAMPLES))
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(content)))
        stop = start + draw(st.sampled_from([0, 1, 2, 4, 8, 64, len(content)]))
        content = content[:start] + draw(st.one_of(SNIPPETS, st.binary(max_size=8))) + content[stop:]
    return content


@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=damage())
def test_only_explained_errors_come_out(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a_poses.npz"
    path.write_bytes(content)
    with contextlib.suppress(FormatError):
        read_path(path)
    npz_archive.peek_keys(path)


@settings(max_examples=300)
@given(st.data())
def test_damaged_pickles_give_a_constant_or_none(data: st.DataObject) -> None:
    content = pickled(data.draw(st.sampled_from(["male", 120.0])), data.draw(st.integers(2, 5)))
    start = data.draw(st.integers(0, len(content)))
    content = content[:start] + data.draw(st.binary(max_size=6)) + content[start + data.draw(st.integers(0, 6)) :]
    value = parse_scalar(content)
    assert value is None or isinstance(value, (str, int, float))
