"""Sets known at a low framerate and brought to a high one: by an encoder, as vectors, low-passed."""

from collections.abc import Iterator, Sequence
from fractions import Fraction

import numpy as np

from eval.sets.corruptions import low_pass
from eval.sets.sets import SampleSet
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid, num_frames_within
from motionkit.features import humanml3d
from motionkit.features.humanml3d import at_origin, facing_forward, on_floor
from motionkit.fields.completion import SLERP, upsample
from motionkit.fields.motion_field import MotionEncoder

# Frames converted to rotations at once: enough to amortise the cost of a call.
FRAMES_AT_ONCE = 2048
# Framerates whose common instants are further apart than this, in frames, are not worth batching.
MOST_PADDING = 16


def upsampled(samples: SampleSet, fps: Fraction, name: str, encoder: MotionEncoder = SLERP) -> SampleSet:
    """Upsample every sequence by SLERP; ids are kept, for comparison with the real sequences.

    Joint rotations (from inverse kinematics) on great arcs, the root on straight lines, positions by forward
    kinematics. Raises `ValueError` if `fps` is below the set's.
    """
    sequences = list(samples.sequences)
    if encoder is SLERP:
        return samples.with_positions(name, fps, list(each_upsampled(sequences, samples.fps, fps)))
    made = [upsampled_positions(sequence, samples.fps, fps, encoder) for sequence in sequences]
    return samples.with_positions(name, fps, made)


def upsampled_positions(
    positions: Float32[np.ndarray, "frames joints 3"],
    fps_from: Fraction,
    fps_to: Fraction,
    encoder: MotionEncoder = SLERP,
) -> Float32[np.ndarray, "new_frames joints 3"]:
    """Joint positions of the 22-joint layout at a higher framerate; raises `ValueError` for a lower one."""
    motion = Motion(positions, SMPL22, TimeGrid(fps_from, len(positions)))
    return upsample(motion, fps_to, encoder).joint_positions


def each_upsampled(
    sequences: Sequence[Float32[np.ndarray, "_frames joints 3"]], fps_from: Fraction, fps_to: Fraction
) -> Iterator[Float32[np.ndarray, "_new_frames joints 3"]]:
    """As `upsampled_positions`, for many sequences of one framerate at a time.

    They are concatenated, each starting at an instant of both grids. SLERP is local to two neighbouring poses, so only
    the gaps between sequences are wasted, and dropped.
    """
    step = (fps_to / fps_from).denominator
    start = 0
    while start < len(sequences):
        stop, places, length = start, [], 0
        room = FRAMES_AT_ONCE if step <= MOST_PADDING else 0
        while stop < len(sequences) and (stop == start or length + len(sequences[stop]) <= room):
            length = -(-length // step) * step
            places.append(length)
            length += len(sequences[stop])
            stop += 1
        joined = np.empty((length, *sequences[start].shape[1:]), dtype=np.float32)
        for place, following, sequence in zip(places, [*places[1:], length], sequences[start:stop], strict=True):
            joined[place : place + len(sequence)] = sequence
            joined[place + len(sequence) : following] = sequence[-1]
        made = upsampled_positions(joined, fps_from, fps_to)
        for place, sequence in zip(places, sequences[start:stop], strict=True):
            first = int(place * fps_to / fps_from)
            yield made[first : first + num_frames_within((len(sequence) - 1) / float(fps_from), fps_to)]
        start = stop


def upsample_as_vectors(samples: SampleSet, fps: Fraction, name: str) -> SampleSet:
    """HumanML3D vectors interpolated linearly, their per-frame root velocities left as they are, then recovered.

    The root's path and turns grow by the upsampling factor: a flaw of the procedure, not of the motion. It would
    explain how published baselines grow with the framerate, and is shown beside SLERP for that reason only.
    """
    if fps < samples.fps:
        raise ValueError(f"{samples.name} is at {samples.fps} fps, which is more than {fps}")
    made = [_through_vectors(sequence, samples.fps, fps) for sequence in samples.sequences]
    return samples.with_positions(name, fps, made)


def _through_vectors(
    positions: Float32[np.ndarray, "frames joints 3"], fps_from: Fraction, fps_to: Fraction
) -> Float32[np.ndarray, "new_frames joints 3"]:
    placed = facing_forward(at_origin(on_floor(positions)), SMPL22.name)
    vectors = humanml3d.vectors(placed, SMPL22.name)
    ratio = float(fps_from / fps_to)
    num_rows = int((len(vectors) - 1) * (fps_to / fps_from)) + 1
    place = np.arange(num_rows) * ratio
    below = np.minimum(place.astype(np.int64), len(vectors) - 1)
    above = np.minimum(below + 1, len(vectors) - 1)
    fraction = (place - below)[:, None]
    mixed = (1.0 - fraction) * vectors[below] + fraction * vectors[above]
    return humanml3d.positions(mixed.astype(np.float32), SMPL22.name)


def low_passed(samples: SampleSet, cutoff_hz: float) -> SampleSet:
    """Every sequence through the same zero-phase low-pass, half amplitude at `cutoff_hz`.

    A cut-off at or above the set's Nyquist frequency leaves it as it is.
    """
    if cutoff_hz >= float(samples.fps) / 2:
        return samples
    smooth = [low_pass(sequence, float(samples.fps), cutoff_hz) for sequence in samples.sequences]
    return samples.with_positions(samples.name, samples.fps, smooth)
