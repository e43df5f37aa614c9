"""Parts: what is written is read by other programs, and damage to it is noticed."""

import hashlib
import tempfile
import zlib
from pathlib import Path

import duckdb
import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from motionkit.core.errors import StoreError
from motionkit.core.files import sha256_of
from motionkit.core.motion import Motion
from motionkit.store import Store, StoreWriter, codec, parts
from motionkit.store.codec import encode
from motionkit.store.manifest import read_manifest
from motionkit.store.parts import read_footer
from motionkit.store.reports.summary import summarise
from motionkit.store.schema import KEY_COLUMNS, SEGMENTS
from tests.helpers.signed_again import describe

PART = "segments/part-00000.parquet"


@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(takes=st.lists(st.tuples(st.sampled_from([1, 2, 255, 256, 257, 600]), st.booleans()), min_size=1, max_size=6))
def test_pyarrow_and_duckdb_read_what_was_written(takes, make_motion, monkeypatch) -> None:
    """Rows, nulls, keys and their statistics, whatever the lengths and wherever rotations are missing."""
    monkeypatch.setattr(codec, "RUN_FRAMES", 2 * 256)
    monkeypatch.setattr(parts, "ROW_GROUP_SEGMENTS", 3)
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


def test_the_schema_is_the_stores(small_store) -> None:
    part = pq.ParquetFile(small_store / PART)
    assert part.schema_arrow.equals(SEGMENTS, check_metadata=True)
    group = part.metadata.row_group(0)
    encodings = {(group.column(i).compression, "BYTE_STREAM_SPLIT" in group.column(i).encodings) for i in range(6)}
    assert encodings == {("ZSTD", True), ("ZSTD", False)}


def test_a_column_of_a_row_group_is_one_page_with_a_checksum(small_store) -> None:
    content = (small_store / PART).read_bytes()
    metadata = pq.ParquetFile(small_store / PART).metadata
    chunks = [metadata.row_group(0).column(number) for number in range(metadata.num_columns)]
    for chunk in chunks:
        body = content[chunk.data_page_offset : chunk.data_page_offset + chunk.total_compressed_size]
        sizes = [size for size in range(len(body) - 60, len(body)) if checksum_field(body[-size:]) in body[:-size]]
        assert len(sizes) == 1, chunk.path_in_schema


def checksum_field(body: bytes) -> bytes:
    """A page's CRC-32 as Parquet's header has it: field 4, a signed integer in zigzag and seven bits a byte."""
    crc = zlib.crc32(body)
    number = (crc << 1) if crc < 2**31 else ((2**32 - crc) << 1) - 1
    encoded = bytearray([0x15])
    while number > 0x7F:
        encoded.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*encoded, number])


def test_what_is_copied_has_the_bytes_of_what_was_written(tmp_path, make_motion) -> None:
    takes = [make_motion(f"m{i}", count, rotations=i % 2 == 0) for i, count in enumerate((300, 5000, 40, 9000, 256))]
    runs = [list(encode(take).runs) for take in takes]
    stores = [tmp_path / "written", tmp_path / "copied"]
    with StoreWriter.create(stores[0]) as writer:
        for take in takes:
            writer.add(take)
    with StoreWriter.create(stores[1]) as writer:
        for number, motion in enumerate(Store.open(stores[0]).read_encoded(np.arange(5))):
            assert list(motion.runs) == runs[number]
            writer.add_encoded(motion)
    assert [[run.num_rows for run in each] for each in runs] == [[2], [16, 4], [1], [16, 16, 4], [1]]
    assert (stores[0] / PART).read_bytes() == (stores[1] / PART).read_bytes()


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


def test_the_manifest_has_the_checksum_of_the_footer(tmp_path, make_motion):
    write(tmp_path / "store", make_motion)
    path = tmp_path / "store" / PART
    entry = read_manifest(tmp_path / "store").files[PART]
    content = path.read_bytes()
    length = int.from_bytes(content[-8:-4], "little") + 8
    assert entry.footer_sha256 == hashlib.sha256(content[-length:]).hexdigest()
    assert read_footer(path) == content[-length:]


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

    monkeypatch.setattr(parts, "sha256_of", counting)
    store = Store.open(tmp_path / "store")
    assert [len(store.read(index).joint_positions) for index in motions] == [300, 40, 9000]
    store.query("FROM segments")
    assert hashed == [tmp_path / "store" / PART]
