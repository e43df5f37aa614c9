"""Stores written by earlier versions stay readable: one small store for each format version, kept as it was written."""

import json
import shutil
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.errors import StoreError
from motionkit.core.motion import Caption, Motion, Provenance
from motionkit.core.skeleton import SMPL22, Feet, Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.store import Store, StoreWriter
from motionkit.store.commit import LOCK_FILE
from motionkit.store.life.rewrite import merge, migrate, remove
from motionkit.store.schema import FORMAT_VERSION
from motionkit.store.validate import faults

STORES = Path(__file__).parent / "stores"
# The one fault of these stores: a caption that starts after its motion's end.
CAPTION = "'limbs/short': a caption lasts from 0.5"
LAYOUT_MAP = json.dumps({"name": "limb", "requires": ["knee"], "smpl22": dict.fromkeys(SMPL22.joint_names, "hip")})


def motions(version: int = FORMAT_VERSION) -> list[Motion]:
    """What the kept store of a version holds; all numbers are exact in float32 and lie on the store's grid."""
    skeleton = Skeleton(
        "limb",
        ("hip", "knee", "toe"),
        (-1, 0, 1),
        np.array([[0, 1, 0], [0, -0.5, 0], [0, -0.5, 0.25]], np.float32),
        feet=Feet(1, 2, 1, 2),
        end_sites=((2, (0.0, 0.0, 0.1)),),
        layout_map=LAYOUT_MAP if version >= 2 else "",
    )
    made = []
    for name, num_frames, fps in (("short", 5, Fraction(30)), ("long", 300, Fraction(24000, 1001))):
        numbers = np.arange(num_frames * 9, dtype=np.float32).reshape(num_frames, 3, 3) / 64
        turns = np.tile(np.array([1, 0, 0, 0], np.float32), (num_frames, 3, 1)) if name == "short" else None
        made.append(
            Motion(
                numbers,
                skeleton,
                TimeGrid(fps, num_frames),
                local_rotations=turns,
                root_translation=None if turns is None else numbers[:, 0].copy(),
                captions=(Caption("a leg moves", 0.5, None, "a/DET leg/NOUN moves/VERB"),),
                action="move",
                style="calm" if version >= 2 else "",
                split="train",
                sequence_id=f"limbs/{name}",
                provenance=Provenance(source="limbs", source_format="bvh", stated_fps="30", operations=("made",)),
            )
        )
    return made


@pytest.mark.parametrize("path", sorted(STORES.iterdir()), ids=lambda path: path.name)
def test_a_store_of_an_earlier_version(path):
    assert all(CAPTION in fault for fault in faults(path))
    store = Store.open(path)
    version = int(path.name.removeprefix("v"))
    assert store.manifest.format_version == version
    assert store.query("SELECT count(*) AS n FROM segments").to_pylist() == [{"n": store.manifest.num_segments}]
    for found, expected in zip(store.read_many(store.select()), motions(version), strict=True):
        np.testing.assert_array_equal(found.joint_positions, expected.joint_positions)
        assert (found.local_rotations is None) == (expected.local_rotations is None)
        assert found.timegrid == expected.timegrid
        assert found.captions == expected.captions
        assert (found.sequence_id, found.action, found.style) == (expected.sequence_id, expected.action, expected.style)
        assert found.provenance == expected.provenance
        assert found.skeleton == expected.skeleton
        assert found.skeleton.layout_map == expected.skeleton.layout_map


def test_an_earlier_version_is_not_added_to(tmp_path):
    shutil.copytree(STORES / "v1", tmp_path / "store")
    before = Store.open(tmp_path / "store").fingerprint
    with (
        pytest.raises(StoreError, match=r"format version 1, .*'motionkit migrate --store .*store'"),
        StoreWriter.append(tmp_path / "store"),
    ):
        pass
    assert Store.open(tmp_path / "store").fingerprint == before


def test_a_migrated_store_is_the_one_that_this_version_writes(tmp_path):
    shutil.copytree(STORES / "v1", tmp_path / "store")
    assert migrate(tmp_path / "store")
    assert not migrate(tmp_path / "store")
    with StoreWriter.create(tmp_path / "fresh") as writer:
        for motion in motions(1):
            writer.add(motion)
    migrated, fresh = Store.open(tmp_path / "store"), Store.open(tmp_path / "fresh")
    assert migrated.manifest.format_version == FORMAT_VERSION
    assert all(CAPTION in fault for fault in faults(tmp_path / "store"))
    parts = [(store.path / store.manifest.parts[0]).read_bytes() for store in (migrated, fresh)]
    assert parts[0] == parts[1]
    assert migrated.sequences_table.drop_columns("part").equals(fresh.sequences_table.drop_columns("part"))
    assert migrated.skeletons_table.equals(fresh.skeletons_table)


def test_a_merge_brings_an_earlier_version_up(tmp_path):
    merge(tmp_path / "merged", [STORES / "v1"])
    with StoreWriter.create(tmp_path / "fresh") as writer:
        for motion in motions(1):
            writer.add(motion)
    assert Store.open(tmp_path / "merged").fingerprint == Store.open(tmp_path / "fresh").fingerprint


def test_the_present_version_is_kept_too(tmp_path):
    """`write_present_version(STORES / "vN")` makes the store of a new format version."""
    write_present_version(tmp_path / "again")
    again, kept = Store.open(tmp_path / "again"), Store.open(STORES / f"v{FORMAT_VERSION}")
    assert again.manifest.num_removed_segments == kept.manifest.num_removed_segments == 1
    assert again.manifest.next_sequence_index == kept.manifest.next_sequence_index == 3
    assert again.sequences_table.schema.equals(kept.sequences_table.schema)
    # How quality is measured may be improved without a new format version.
    names = kept.sequences_table.column_names
    measured = names[names.index("max_joint_speed_metres_per_second") : names.index("quality_flags") + 1]
    assert again.sequences_table.drop_columns(measured).equals(kept.sequences_table.drop_columns(measured))
    assert again.skeletons_table.equals(kept.skeletons_table)
    assert again.query("FROM segments").equals(kept.query("FROM segments"))


def write_present_version(path: Path) -> None:
    """Write the store of this version, with the segments of a sequence that was removed in between."""
    short, long = motions()
    with StoreWriter.create(path) as writer:
        for motion in (short, replace(short, sequence_id="limbs/removed"), long):
            writer.add(motion)
    remove(path, ["limbs/removed"])
    (path / LOCK_FILE).unlink()
