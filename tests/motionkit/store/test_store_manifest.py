"""A manifest that is damaged, old, wild or another's is refused with its name; parts are not written over."""

import hashlib
import json
from itertools import cycle

import pytest

from motionkit.core.errors import StoreError
from motionkit.store import Store, StoreWriter
from motionkit.store.manifest import read_manifest
from motionkit.store.validate import faults
from tests.helpers.signed_again import sign


def test_another_format_version(small_store):
    sign(small_store, lambda document: document.update(format_version=7))
    with pytest.raises(StoreError, match=r"format version 7 and was written by 'motionkit .* reads version 2"):
        Store.open(small_store)
    with pytest.raises(StoreError, match="format version 7"), StoreWriter.append(small_store):
        pass


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", r"manifest\.json is damaged \(Expecting property name"),
        ("[" * 100_000, r"manifest\.json is damaged"),
        ('{"format": "lerobot"}', "not the manifest of a store"),
        ('{"format": "motionkit-store", "format_version": 2}', "is damaged"),
    ],
)
def test_a_damaged_manifest(small_store, text, says):
    (small_store / "manifest.json").write_text(text)
    with pytest.raises(StoreError, match=says):
        Store.open(small_store)


def test_every_flipped_byte_of_the_manifest_is_noticed(small_store):
    path = small_store / "manifest.json"
    content = path.read_bytes()
    for place, flip in zip(range(len(content)), cycle((0x01, 0x08, 0x20))):
        damaged = bytearray(content)
        damaged[place] ^= flip
        path.write_bytes(damaged)
        with pytest.raises(StoreError, match=r"manifest\.json is damaged"):
            read_manifest(small_store)


def test_a_manifest_of_before_checksums_is_read(small_store):
    """And its fingerprint, by which runs know their store, is what it was: the sha256 of its text."""
    path = small_store / "manifest.json"
    document = json.loads(path.read_text())
    del document["checksum"]
    text = json.dumps(document, indent=2) + "\n"
    before = Store.open(small_store).fingerprint
    path.write_text(text)
    assert Store.open(small_store).fingerprint == before == hashlib.sha256(text.encode()).hexdigest()


def put(*place):
    """An edit of the manifest: the last of `place` is put where the others lead."""

    def edit(document):
        *folders, name, value = place
        for folder in folders:
            document = document.setdefault(folder, {})
        document[name] = value

    return edit


PART = "segments/part-00000.parquet"


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        (put("next", {"part": 0, "sequence_index": 6}), "next part is 0, but it names .*part-00000"),
        (put("next", {"part": 2**31 + 1, "sequence_index": 6}), "next part is 2147483649"),
        (put("next", {"part": 1, "sequence_index": 5}), "next sequence_index is 5 of 6 sequences"),
        (put("next", {"part": 1}), "no 'sequence_index'"),
        (put("counts", "frames", -1), "frames is -1"),
        (put("counts", "frames", True), "frames is True"),
        (put("counts", "frames", 2**63), "frames is 9223372036854775808"),
        (put("counts", []), r"counts is '\[\]'"),
        (put("files", PART, 7), r"segments/part-00000\.parquet is '7'"),
        (put("files", PART, "num_rows", "8"), "num_rows is '8'"),
        (put("files", PART, "sha256", "../../etc"), "sha256 of .*part-00000.* is '../../etc'"),
        (put("files", "../outside.parquet", {}), r"names '\.\./outside\.parquet', which is no file of a store"),
        (put("files", "/etc/passwd", {}), "which is no file of a store"),
        (put("files", "segments/../sequences.parquet", {}), "which is no file of a store"),
        (put("files", "segments/part-000007.parquet", {}), "which is no file of a store"),
        (put("tool", "\x1b[2J"), r"tool is '\\x1b\[2J'"),
    ],
)
def test_a_manifest_with_wild_numbers_and_names(small_store, edit, says):
    sign(small_store, edit)
    for use in (Store.open, lambda path: list(faults(path)), lambda path: StoreWriter.append(path).__enter__()):
        with pytest.raises(StoreError, match=says) as caught:
            use(small_store)
        assert "\n" not in str(caught.value)


def test_tables_that_are_not_the_manifests(small_store):
    (small_store / "sequences.parquet").write_bytes(b"PAR1")
    with pytest.raises(StoreError, match="motionkit validate"):
        Store.open(small_store)


def test_a_part_that_is_there_is_not_written_over(small_store, make_motion, monkeypatch):
    """`next.part` of a manifest without a checksum, with one bit flipped, used to be believed."""
    part = small_store / PART
    before = part.read_bytes()
    with (
        pytest.raises(StoreError, match=r"part-00000\.parquet is there already"),
        StoreWriter.append(small_store) as writer,
    ):
        monkeypatch.setattr(writer, "_next_part", 0)
        writer.add(make_motion("later"))
    assert part.read_bytes() == before


def test_parts_are_kept_while_one_that_the_manifest_names_is_missing(small_store, make_motion):
    """In a manifest without a checksum a name may be wrong by one bit: what it does not name may be what it means."""
    path = small_store / "manifest.json"
    document = json.loads(path.read_text())
    del document["checksum"]
    document["files"]["segments/part-00002.parquet"] = document["files"].pop(PART)
    path.write_text(json.dumps(document))
    with (
        pytest.raises(StoreError, match=r"part-00000\.parquet is referred to"),
        StoreWriter.append(small_store) as writer,
    ):
        writer.add(make_motion("later"))
    assert (small_store / PART).exists()
