"""Any other system's samples: a folder of motions in any format that motionkit reads."""

import hashlib
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from eval.baselines.upsampled import upsampled_positions
from eval.samples import SampleSet, sample_set
from motionkit.errors import MotionkitError
from motionkit.resample import resample_positions
from motionkit.skeleton import SMPL22


class SampleFolderError(MotionkitError):
    """A folder of samples that cannot be used."""


@dataclass(frozen=True, eq=False)
class SampleFolder:
    """Motions of one system in the 22-joint layout, each at the framerate that its file states."""

    name: str
    sequences: tuple[Float32[np.ndarray, "_frames joints 3"], ...]
    fps: tuple[Fraction, ...]
    sequence_ids: tuple[str, ...]

    @property
    def fingerprint(self) -> str:
        """First 16 hex digits of the sha256 over framerates and positions."""
        digest = hashlib.sha256()
        for fps, sequence in zip(self.fps, self.sequences, strict=True):
            digest.update(f"{fps} ".encode() + np.ascontiguousarray(sequence, dtype="<f4").tobytes())
        return digest.hexdigest()[:16]

    def at(self, fps: Fraction) -> SampleSet:
        """All motions at one framerate: those that are slower are upsampled by SLERP, faster ones are anti-aliased."""
        made = [_at(sequence, own, fps) for sequence, own in zip(self.sequences, self.fps, strict=True)]
        return sample_set(self.name, fps, made, self.sequence_ids)

    def describe(self) -> str:
        """How many motions there are, at which framerates."""
        rates = ", ".join(f"{fps} fps" for fps in sorted(set(self.fps)))
        return f"{len(self.sequences)} motions at {rates}; below a column's framerate they are upsampled by SLERP"


def read_sample_folder(name: str, folder: Path) -> SampleFolder:
    """Read every motion of a folder. Raises `SampleFolderError` where there is none, or the first fault of a file."""
    from motionkit.formats.registry import read, scan
    from motionkit.skeleton_map import map_joints

    if not folder.exists():
        raise SampleFolderError(f"--samples {name}: there is no folder {str(folder)!r}")
    found = scan([folder])
    if found.problems:
        raise found.problems[0]
    motions = [read(item) for item in found.items]
    if not motions:
        raise SampleFolderError(f"--samples {name}: no motion was found in {str(folder)!r}")
    return SampleFolder(
        name,
        tuple(map_joints(motion, SMPL22.name) for motion in motions),
        tuple(motion.fps for motion in motions),
        tuple(motion.sequence_id for motion in motions),
    )


def _at(
    positions: Float32[np.ndarray, "frames joints 3"], fps_from: Fraction, fps_to: Fraction
) -> Float32[np.ndarray, "new_frames joints 3"]:
    if fps_from < fps_to:
        return upsampled_positions(positions, fps_from, fps_to)
    return resample_positions(positions, fps_from, fps_to)
