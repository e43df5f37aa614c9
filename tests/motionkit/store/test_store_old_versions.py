"""Stores written by earlier versions stay readable: one small store for each format version, kept as it was written."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from motionkit.motion import Caption, Motion, Provenance
from motionkit.skeleton import Feet, Skeleton
from motionkit.store import Store, StoreWriter
from motionkit.store.schema import FORMAT_VERSION
from motionkit.store.validate import faults
from motionkit.timegrid import TimeGrid

STORES = Path(__file__).parent / "stores"


def motions() -> list[Motion]:
    """What every kept store holds; all numbers are exact in float32. A version 2 would start from these too."""
    skeleton = Skeleton(
        "limb",
        ("hip", "knee", "toe"),
        (-1, 0, 1),
        np.array([[0, 1, 0], [0, -0.5, 0], [0, -0.5, 0.25]], np.float32),
        feet=Feet(1, 2, 1, 2),
        end_sites=((2, (0.0, 0.0, 0.1)),),
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
                split="train",
                sequence_id=f"limbs/{name}",
                provenance=Provenance(source="limbs", source_format="bvh", stated_fps="30", operations=("made",)),
            )
        )
    return made


@pytest.mark.parametrize("path", sorted(STORES.iterdir()), ids=lambda path: path.name)
def test_a_store_of_an_earlier_version(path):
    assert list(faults(path)) == []
    store = Store.open(path)
    for found, expected in zip(store.read_many(range(2)), motions(), strict=True):
        np.testing.assert_array_equal(found.joint_positions, expected.joint_positions)
        assert (found.local_rotations is None) == (expected.local_rotations is None)
        assert found.timegrid == expected.timegrid
        assert found.captions == expected.captions
        assert found.provenance == expected.provenance
        assert found.skeleton == expected.skeleton


def test_the_present_version_is_kept_too(tmp_path):
    """`write_present_version(STORES / "vN")` makes the store of a new format version."""
    assert (STORES / f"v{FORMAT_VERSION}").is_dir()
    write_present_version(tmp_path / "again")
    kept = Store.open(STORES / f"v{FORMAT_VERSION}")
    assert Store.open(tmp_path / "again").sequences_table.equals(kept.sequences_table)


def write_present_version(path: Path) -> None:
    """Write the store of this version."""
    with StoreWriter.create(path) as writer:
        for motion in motions():
            writer.add(motion)
