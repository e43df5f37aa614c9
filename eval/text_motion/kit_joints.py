"""Motions of 22 joints as KIT-ML's 21, for its evaluator: by weights of joints, with the real motions' bone lengths.

The spine's joints and the middle of the feet are not among the 22 and are interpolated, which only motions that came as
21 joints, or as pose vectors of them, are spared (`motionkit/skeletons/kit21_from_smpl22.toml`).
"""

import numpy as np
from jaxtyping import Float32

from eval.samples.sets import SampleSet
from motionkit.features.humanml3d_processing import bone_lengths, uniform_skeleton
from motionkit.skeleton import KIT21, SMPL22
from motionkit.skeletons.mapping import joint_map

MADE_OF_22 = "its 21 joints made of 22, with the real motions' bone lengths"


def kit_bone_lengths(real: SampleSet) -> Float32[np.ndarray, "21"] | None:
    """The bones of a real set of KIT's 21 joints in metres: medians over the first poses, for KIT-ML has one body.

    None for a set of 22 joints.
    """
    if real.positions.shape[1] != KIT21.num_joints:
        return None
    lengths = [bone_lengths(sequence[0], KIT21.name) for sequence in real.sequences()]
    return np.asarray(np.median(np.stack(lengths), axis=0), dtype=np.float32)


def as_kit_joints(samples: SampleSet, lengths: Float32[np.ndarray, "21"]) -> SampleSet:
    """22-joint motions as KIT's 21 joints with these bone lengths; the path is scaled by the ratio of leg lengths."""
    weights = joint_map(SMPL22, KIT21.name).weights
    made = [
        uniform_skeleton(np.matmul(weights, sequence), KIT21.name, lengths).astype(np.float32)
        for sequence in samples.sequences()
    ]
    return samples.with_positions(samples.name, samples.fps, made)
