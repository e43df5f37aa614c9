"""A set known at a low framerate, fairly brought to a high one: SLERP on joint rotations."""

from fractions import Fraction

from eval.samples import SampleSet
from motionkit.resample import slerp_upsample_positions
from motionkit.skeleton import SMPL22


def upsample_by_slerp(samples: SampleSet, fps: Fraction, name: str) -> SampleSet:
    """Joint rotations on great arcs, the root on straight lines, positions by forward kinematics.

    Every sequence keeps its id, so that the result may be compared with the real set of the same sequences.
    Raises `ValueError` where `fps` is below the set's.
    """
    if fps == samples.fps:
        return samples.with_positions(name, fps, list(samples.sequences()))
    made = [slerp_upsample_positions(sequence, SMPL22, samples.fps, fps) for sequence in samples.sequences()]
    return samples.with_positions(name, fps, made)
