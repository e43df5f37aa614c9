"""Parts as this program writes them, byte by byte, are Parquet as other programs read it."""

import hashlib
import tempfile
import zlib
from pathlib import Path

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from motionkit.checksums import sha256_of
from motionkit.errors import StoreError
from motionkit.motion import Motion
from motionkit.store import Store, StoreWriter, segment_reader, thrift
from motionkit.store import pages as pages_module
from motionkit.store import parts as parts_module
from motionkit.store.footer import read_footer
from motionkit.store.manifest import read_manifest
from motionkit.store.pages import float_page, float_runs, integer_page
from motionkit.store.schema import KEY_COLUMNS, SEGMENTS
from motionkit.store.summary import summarise
from motionkit.store.thrift import Value
from tests.motionkit.store.signed_again import describe

PART = "segments/part-00000.parquet"


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (thrift.i32(0), (5, "00")),
        (thrift.i32(-1), (5, "01")),
        (thrift.i32(1), (5, "02")),
        (thrift.i64(150), (6, "ac02")),
        (thrift.i64(-(2**63)), (6, "ff" * 9 + "01")),
        (thrift.i8(-3), (3, "fd")),
        (thrift.binary(b"ab"), (8, "026162")),
        (thrift.list_of([thrift.i32(1), thrift.i32(2)]), (9, "250204")),
        (thrift.list_of([thrift.binary(b"")] * 15), (9, "f80f" + "00" * 15)),
        (thrift.struct({1: thrift.i32(1), 4: thrift.boolean(True), 5: thrift.boolean(False)}), (12, "15023112" + "00")),
    ],
)
def test_thrift_as_its_specification_has_it(value: Value, expected: tuple[int, str]) -> None:
    assert (value.kind, value.content.hex()) == expected


def column(num_frames: int, channels: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(num_frames * channels, np.float32)


@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(takes=st.lists(st.tuples(st.sampled_from([1, 2, 255, 256, 257, 600]), st.booleans()), min_size=1, max_size=6))
def test_pyarrow_and_duckdb_read_what_was_written(takes, make_motion, monkeypatch) -> None:
    """Rows, nulls, keys and their statistics, whatever the lengths and wherever rotations are missing."""
    monkeypatch.setattr(pages_module, "RUN_SEGMENTS", 2)
    monkeypatch.setattr(parts_module, "ROW_GROUP_SEGMENTS", 3)
    motions = [make_motion(f"m{i}", count, rotations=rotations) for i, (count, rotations) in enumerate(takes)]
    with tempfile.TemporaryDirectory() as folder:
        with StoreWriter.create(Path(folder) / "store") as writer:
            for motion in motions:
                writer.add(motion)
        part = pq.ParquetFile(Path(folder) / "store" / PART)
        rows = part.read().to_pylist()
        found = duckdb.sql(
            "SELECT sequence_index, sum(num_frames), sum(len(joint_positions)), count(joint_rotations), "
            f"sum(len(root_translation)) FROM '{folder}/store/{PART}' GROUP BY 1 ORDER BY 1"
        ).fetchall()
    for number, motion in enumerate(motions):
        own = [row for row in rows if row["sequence_index"] == number]
        assert [row["start_frame"] for row in own] == list(range(0, motion.num_frames, 256))
        for name, array in (
            ("joint_positions", motion.joint_positions),
            ("joint_rotations", motion.local_rotations),
            ("root_translation", motion.root_translation),
        ):
            if array is None:
                assert all(row[name] is None for row in own)
                continue
            blocks = [np.float32(row[name]).reshape(-1, row["num_frames"]).T for row in own]
            np.testing.assert_array_equal(np.concatenate(blocks), array.reshape(motion.num_frames, -1))
    assert found == [
        (i, count, 66 * count, -(-count // 256) if rotations else 0, 3 * count if rotations else None)
        for i, (count, rotations) in enumerate(takes)
    ]
    check_row_groups(part.metadata, rows)


def check_row_groups(metadata: pq.FileMetaData, rows: list[dict[str, object]]) -> None:
    first = 0
    for number in range(metadata.num_row_groups):
        group = metadata.row_group(number)
        assert group.num_rows in (3, 4) or number == metadata.num_row_groups - 1
        of_group = rows[first : first + group.num_rows]
        for place, name in enumerate(KEY_COLUMNS):
            statistics = group.column(place).statistics
            keys = [row[name] for row in of_group]
            assert (statistics.min, statistics.max, statistics.null_count) == (min(keys), max(keys), 0)
        first += group.num_rows


def test_the_schema_is_that_which_pyarrow_writes(small_store, tmp_path) -> None:
    part = pq.ParquetFile(small_store / PART)
    pq.write_table(SEGMENTS.empty_table(), tmp_path / "pyarrows.parquet")
    assert part.schema.equals(pq.ParquetFile(tmp_path / "pyarrows.parquet").schema)
    assert part.schema_arrow.equals(SEGMENTS, check_metadata=True)


def test_every_byte_of_a_part_is_accounted_for(small_store) -> None:
    metadata = pq.ParquetFile(small_store / PART).metadata
    place = 4
    for number in range(metadata.num_row_groups):
        group = metadata.row_group(number)
        chunks = [group.column(i) for i in range(group.num_columns)]
        for chunk in chunks:
            assert chunk.data_page_offset == place
            place += chunk.total_compressed_size
        assert group.total_byte_size == sum(chunk.total_uncompressed_size for chunk in chunks)
    assert place + metadata.serialized_size + 8 == (small_store / PART).stat().st_size


def test_what_is_compressed_does_not_depend_on_what_lies_beside_it(tmp_path, make_motion) -> None:
    with StoreWriter.create(tmp_path / "store") as writer:
        for number in range(5):
            writer.add(make_motion(f"m{number}", 300, rotations=True))
    content = (tmp_path / "store" / PART).read_bytes()
    for number in range(5):
        flat = make_motion(f"m{number}", 300, rotations=True).root_translation
        (run,) = float_runs(np.concatenate([flat[:256].T.ravel(), flat[256:].T.ravel()]), 300)
        start = 0
        for size in run.frame_sizes:
            assert content.count(run.frames[start : start + size].tobytes()) == 1
            start += size


def test_runs_are_short_and_pages_know_their_sizes() -> None:
    long = float_runs(column(256 * 40 + 1, 3, seed=1), 256 * 40 + 1)
    assert [run.num_rows for run in long] == [16, 16, 9]
    nulls = float_runs(None, 256 * 17)
    assert [(run.num_rows, run.frames.size) for run in nulls] == [(16, 0), (1, 0)]
    page = float_page([*long, *nulls], nullable=True)
    assert page.num_values == 3 * (256 * 40 + 1) + 17
    assert page.num_bytes_plain > 4 * 3 * (256 * 40 + 1)
    assert integer_page(np.arange(5, dtype=np.int32)).num_values == 5


def test_a_sequences_page_takes_no_more_room_than_arrows() -> None:
    """A page of one sequence, its byte planes apart, against Arrow's own of the same values."""
    steps = np.random.default_rng(3).standard_normal((66, 200)) * 0.01
    walk = (np.rint(np.cumsum(steps, axis=1) * 2**22) / 2**22).astype(np.float32).ravel()
    page = float_page(float_runs(walk, 200), nullable=False)
    sink = pa.BufferOutputStream()
    options = {"compression": "zstd", "use_dictionary": False, "use_byte_stream_split": True}
    pq.write_table(pa.table({"values": walk}), sink, write_statistics=False, **options)
    arrows = pq.ParquetFile(pa.BufferReader(sink.getvalue())).metadata.row_group(0).column(0).total_compressed_size
    assert len(page.header) + len(page.body) < arrows


def write(path: Path, make_motion) -> dict[int, Motion]:
    """A store of three motions, of which one has several row groups."""
    motions = [make_motion(f"m{i}", count, rotations=i == 1) for i, count in enumerate((300, 40, 9000))]
    with StoreWriter.create(path) as writer:
        return {writer.add(motion): motion for motion in motions}


def without_checksums(store: Path) -> None:
    """As versions before page checksums wrote it: the page's header has none, and the manifest no footer's digest."""
    rows = pq.read_table(store / PART)
    pq.write_table(rows, store / PART, compression="zstd", row_group_size=16)
    describe(store, PART, rows.num_rows)


@pytest.mark.parametrize("old", [False, True], ids=["with checksums", "of before checksums"])
@pytest.mark.parametrize("place", [0.001, 0.3, 0.5, 0.7, 0.9])
def test_a_flipped_byte_of_a_page_is_not_read(tmp_path, make_motion, place, old):
    """zstd would give other numbers in silence."""
    motions = write(tmp_path / "store", make_motion)
    if old:
        without_checksums(tmp_path / "store")
    path = tmp_path / "store" / PART
    content = bytearray(path.read_bytes())
    content[int(place * len(content))] ^= 1
    path.write_bytes(content)
    store, damaged = Store.open(tmp_path / "store"), 0
    for index, motion in motions.items():
        try:
            np.testing.assert_array_equal(store.read(index).joint_positions, motion.joint_positions)
        except StoreError as error:
            assert "part-00000.parquet" in str(error) and "validate" in str(error) and "\n" not in str(error)
            damaged += 1
    assert damaged
    with pytest.raises(StoreError, match="validate"):
        store.query("SELECT sum(list_sum(joint_positions)), count(joint_rotations), sum(num_frames) FROM segments")


def test_pages_have_checksums_and_the_manifest_that_of_the_footer(tmp_path, make_motion):
    write(tmp_path / "store", make_motion)
    path = tmp_path / "store" / PART
    entry = read_manifest(tmp_path / "store").files[PART]
    content = path.read_bytes()
    length = int.from_bytes(content[-8:-4], "little") + 8
    assert entry.footer_sha256 == hashlib.sha256(content[-length:]).hexdigest()
    assert read_footer(path) == content[-length:]
    page = integer_page(np.arange(5, dtype=np.int32))
    assert thrift.i32(zlib.crc32(page.body) - (zlib.crc32(page.body) >> 31 << 32)).content in page.header


@pytest.mark.parametrize("place", range(1, 60, 7))
def test_a_flipped_byte_of_a_footer_is_noticed(tmp_path, make_motion, place):
    """Also by who reads nothing else: `motionkit info`."""
    write(tmp_path / "store", make_motion)
    path = tmp_path / "store" / PART
    content = bytearray(path.read_bytes())
    content[-place * 20] ^= 2
    path.write_bytes(content)
    store = Store.open(tmp_path / "store")
    for use in (lambda: store.read(0), lambda: summarise(store), lambda: store.query("FROM segments")):
        with pytest.raises(StoreError, match=r"part-00000\.parquet is damaged .*validate"):
            use()


def test_a_part_of_before_checksums_is_compared_once(tmp_path, make_motion, monkeypatch):
    motions = write(tmp_path / "store", make_motion)
    without_checksums(tmp_path / "store")
    hashed = []

    def counting(path: Path) -> str:
        hashed.append(path)
        return sha256_of(path)

    monkeypatch.setattr(segment_reader, "sha256_of", counting)
    store = Store.open(tmp_path / "store")
    assert [len(store.read(index).joint_positions) for index in motions] == [300, 40, 9000]
    store.query("FROM segments")
    assert hashed == [tmp_path / "store" / PART]
