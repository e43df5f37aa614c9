"""Motions made by hand for the store's tests."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.core.motion import Caption, Motion, Provenance

MakeMotion = Callable[..., Motion]


@pytest.fixture(scope="session")
def make_motion() -> MakeMotion:
    """`make_motion(id, num_frames, …)`: random joints (and rotations) on the store's grid, the same for the same id."""

    def make(
        sequence_id: str,
        num_frames: int = 40,
        *,
        fps: Fraction = Fraction(30),
        skeleton: mk.Skeleton = mk.SMPL22,
        rotations: bool = False,
        split: str = "train",
    ) -> Motion:
        generator = np.random.default_rng(sum(sequence_id.encode()))
        joints = skeleton.num_joints

        def numbers(*shape: int) -> np.ndarray:
            return (np.rint(generator.standard_normal(shape) * 2**22) / 2**22).astype(np.float32)

        return Motion(
            joint_positions=numbers(num_frames, joints, 3),
            skeleton=skeleton,
            timegrid=mk.TimeGrid(fps, num_frames, start_seconds=0.25),
            local_rotations=numbers(num_frames, joints, 4) if rotations else None,
            root_translation=numbers(num_frames, 3) if rotations else None,
            captions=(Caption("a person waves"), Caption("ends", 0.3, 0.5, "ends/VERB")),
            action="wave",
            split=split,
            sequence_id=sequence_id,
            provenance=Provenance(
                source="made",
                subset="by-hand",
                source_path=f"{sequence_id}.bvh",
                source_sha256="ab" * 32,
                source_format="bvh",
                licence="CC0",
                subject="s1",
                stated_fps="0.033333",
                operations=("read", "units: centimetres"),
            ),
        )

    return make


@pytest.fixture
def small_store(tmp_path: Path, make_motion: MakeMotion) -> Path:
    """A store of six motions: three framerates, some with rotations, one longer than all others."""
    rates = (Fraction(30), Fraction(120), Fraction(30000, 1001))
    with mk.StoreWriter.create(tmp_path / "store") as writer:
        for i in range(6):
            writer.add(
                make_motion(
                    f"take-{i}",
                    600 if i == 3 else 40 + i,
                    fps=rates[i % 3],
                    rotations=i % 2 == 0,
                    split="test" if i == 5 else "train",
                )
            )
    return tmp_path / "store"
