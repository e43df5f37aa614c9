"""A set known at a low framerate, fairly brought to a high one: by SLERP on joint rotations, or any other encoder."""

from fractions import Fraction

import numpy as np
from jaxtyping import Float32

from eval.samples import SampleSet
from motionkit.completion import SLERP, upsample
from motionkit.motion import Motion
from motionkit.motionfield import MotionEncoder
from motionkit.skeleton import SMPL22
from motionkit.timegrid import TimeGrid


def upsampled(samples: SampleSet, fps: Fraction, name: str, encoder: MotionEncoder = SLERP) -> SampleSet:
    """Every sequence at a higher framerate; it keeps its id, so that it may be compared with the real one of that id.

    SLERP: joint rotations (from inverse kinematics) on great arcs, the root on straight lines, positions by forward
    kinematics. Raises `ValueError` where `fps` is below the set's.
    """
    made = [upsampled_positions(sequence, samples.fps, fps, encoder) for sequence in samples.sequences()]
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
