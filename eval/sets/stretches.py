"""Normalised motions for comparison: bones of one reference body at 20 fps, low-passed, whole or in stretches."""

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from eval.sets.corruptions import low_pass
from motionkit.core.shapes import Complex64, Float32, Float64, Int64, Shaped
from motionkit.core.skeleton import SMPL22
from motionkit.features.field import heading
from motionkit.fields.resample import resample_positions

FPS = Fraction(20)
SMOOTH_HZ = 5.0
POSE_EVERY = 2
SHORTEST_BONE = 1e-6
PARENTS = np.array(SMPL22.parents[1:])


def _bone_lengths() -> Float64[np.ndarray, "bones 1"]:
    """Of the reference body, left and right alike, so that a mirrored copy has the same bones."""
    lengths = np.linalg.norm(SMPL22.offsets, axis=-1)
    for pair in SMPL22.left_right_pairs:
        lengths[list(pair)] = lengths[list(pair)].mean()
    return np.asarray(lengths[1:, None], dtype=np.float64)


def _other_side() -> Int64[np.ndarray, "bones"]:
    """The bone on the other side of the body."""
    joints = np.arange(SMPL22.num_joints)
    for left, right in SMPL22.left_right_pairs:
        joints[[left, right]] = right, left
    return joints[1:] - 1


BONE_LENGTHS = _bone_lengths()
OTHER_SIDE = _other_side()


@dataclass(frozen=True, eq=False)
class Stretches:
    """Bones of stretches of equally many poses: on the ground plane as z + ix, and upright; metres.

    `turn` sums the directions (z + ix) that the poses face.
    """

    planar: Complex64[np.ndarray, "stretches poses bones"]
    upright: Float32[np.ndarray, "stretches poses bones"]
    turn: Complex64[np.ndarray, "stretches"]

    def transformed(self, mirrored: bool, backwards: bool) -> "Stretches":
        """The stretches, mirrored and reversed if set."""
        step = -1 if backwards else 1
        planar, upright = self.planar[:, ::step], self.upright[:, ::step]
        if not mirrored:
            return Stretches(planar, upright, self.turn)
        return Stretches(planar[..., OTHER_SIDE].conj(), upright[..., OTHER_SIDE], self.turn.conj())

    def rows(self) -> Float32[np.ndarray, "stretches numbers"]:
        """Flattened stretches, rotated to face Z+ on average."""
        planar = flat(self.planar) * unit(self.turn).conj()[:, None]
        return np.concatenate((numbers(planar), flat(self.upright)), axis=1)

    def movement(self) -> Float64[np.ndarray, "stretches"]:
        """Root mean square over poses and bones of a bone's distance from its mean over the stretch, metres."""
        planar = self.planar - self.planar.mean(axis=1, keepdims=True)
        upright = self.upright - self.upright.mean(axis=1, keepdims=True)
        squares = np.abs(planar) ** 2 + upright**2
        return np.asarray(np.sqrt(squares.mean(axis=(1, 2), dtype=np.float64)))


@dataclass(frozen=True, eq=False)
class Track:
    """A motion's bones at 20 fps, as in `Stretches`, and the direction that each pose faces."""

    planar: Complex64[np.ndarray, "frames bones"]
    upright: Float32[np.ndarray, "frames bones"]
    facing: Complex64[np.ndarray, "frames"]

    @classmethod
    def of(cls, positions: Float32[np.ndarray, "frames joints 3"], fps: Fraction) -> "Track":
        """From joint positions of the 22-joint layout; with fps × tempo they are played at that tempo."""
        smooth = low_pass(resample_positions(positions, fps, FPS).astype(np.float64), float(FPS), SMOOTH_HZ)
        bones = smooth[:, 1:] - smooth[:, PARENTS]
        bones *= BONE_LENGTHS / np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), SHORTEST_BONE)
        planar = (bones[..., 2] + 1j * bones[..., 0]).astype(np.complex64)
        facing = np.exp(1j * heading(smooth)).astype(np.complex64)
        return cls(planar, bones[..., 1].astype(np.float32), facing)

    def stretches(self, starts: Int64[np.ndarray, "stretches"], num_poses: int) -> Stretches:
        """Stretches of `num_poses` poses, every second frame, from the given frames on."""
        frames = starts[:, None] + POSE_EVERY * np.arange(num_poses)
        return Stretches(self.planar[frames], self.upright[frames], self.facing[frames].sum(axis=1))


@dataclass(frozen=True, eq=False)
class Tracks:
    """Concatenated tracks; sequence i begins at frame `first[i]`."""

    track: Track
    first: Int64[np.ndarray, "sequences"]
    num_frames: Int64[np.ndarray, "sequences"]

    @classmethod
    def of(cls, sequences: Iterable[Float32[np.ndarray, "_frames joints 3"]], fps: Fraction) -> "Tracks":
        """From sequences at one framerate."""
        tracks = [Track.of(each, fps) for each in sequences]
        lengths = np.array([len(each.facing) for each in tracks], dtype=np.int64)
        joined = (np.concatenate([getattr(each, name) for each in tracks]) for name in ("planar", "upright", "facing"))
        return cls(Track(*joined), np.cumsum(lengths) - lengths, lengths)

    def last_starts(self, num_poses: int) -> Int64[np.ndarray, "sequences"]:
        """The last start frame of a stretch in each sequence; negative if it holds none."""
        return self.num_frames - POSE_EVERY * (num_poses - 1) - 1

    def starts(self, num_poses: int, every: int) -> tuple[Int64[np.ndarray, "n"], Int64[np.ndarray, "n"]]:
        """Start frames of stretches, one every so many frames, and their sequences."""
        numbers = np.maximum(0, self.last_starts(num_poses) // every + 1)
        whose = np.repeat(np.arange(len(numbers)), numbers)
        return every * (np.arange(len(whose)) - np.repeat(np.cumsum(numbers) - numbers, numbers)), whose


def numbers(planar: Complex64[np.ndarray, "stretches numbers"]) -> Float32[np.ndarray, "stretches both"]:
    """Real parts, then imaginary ones."""
    return np.concatenate((planar.real, planar.imag), axis=1)


def flat(bones: Shaped[np.ndarray, "stretches poses bones"]) -> Shaped[np.ndarray, "stretches numbers"]:
    """All numbers of a stretch in one row."""
    return bones.reshape(len(bones), bones.shape[1] * bones.shape[2])


def unit(values: Complex64[np.ndarray, "n"]) -> Complex64[np.ndarray, "n"]:
    """Each divided by its absolute value; 1 for 0."""
    size = np.abs(values)
    return np.where(size > 0, values / np.where(size > 0, size, 1), 1).astype(np.complex64)
