"""clip-FID of two sets of motions in memory, in one call."""

from collections.abc import Iterable, Sequence
from fractions import Fraction

import numpy as np

from eval.clip_fid.clips import ClipError, Protocol
from eval.clip_fid.features import kinematic_source
from eval.metrics.number import Number
from eval.sets.sets import SampleSet, sample_set
from motionkit.core.errors import UsageError
from motionkit.core.motion import Motion
from motionkit.core.progress import warn
from motionkit.core.shapes import Float
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import map_joints
from motionkit.core.timegrid import Framerate, parse_fps

Motions = Sequence[Motion] | Sequence[Float[np.ndarray, "_frames 22 3"]]


def clip_fid(
    real: Motions,
    generated: Motions,
    *,
    fps: Framerate | None = None,
    train: Motions | None = None,
    clips: int = 4096,
    replications: int = 20,
    seed: int = 0,
) -> Number:
    """Fréchet distance between random native-rate clips of two sets of motions at one framerate, with its interval.

    Motions are `Motion`s, brought to the 22 joints, or arrays [T, 22, 3] in metres, y up, at `fps`. Each replication
    draws `clips` clips of 16 to 64 poses from either set. The kinematic descriptor is fitted on `train`, by default on
    the real motions; tables fit it on the training split and compare with the test split (docs/evaluators.md).

    Lower is better, and 0 is not reached: the floor is what other real motions score. Scores compare only with the same
    real motions, framerate and number of clips. Warns where both sets are one and the same motion: its clips
    are the same on both sides, and their distance is 0.

    Raises `UsageError` for motions of several framerates or of another one than `fps`, `ClipError` where no motion is
    long enough for a clip, `MotionkitError` for a skeleton that cannot be brought to the 22 joints.

    >>> store = mk.Store.open("store")
    >>> real = [motion.resample(30) for motion in store.read_many(store)]
    >>> slowed = [mk.complete(motion.resample(10), fps=30, model="slerp") for motion in real]
    >>> floor = clip_fid(real, real, clips=256, replications=3)
    >>> score = clip_fid(real, slowed, clips=256, replications=3)
    >>> score.value - score.ci95 > floor.value + floor.ci95
    True
    """
    sets = {"real": real, "generated": generated, "train": real if train is None else train}
    rate = common_framerate(sets.values(), fps)
    samples = {name: samples_of(name, motions, rate) for name, motions in sets.items()}
    if _are_one_motion(samples["real"], samples["generated"]):
        warn(
            "real and generated are the same single motion: both sides draw the same clips, so clip-FID is 0 and says "
            "nothing; compare with other motions, or several real ones with themselves for the floor"
        )
    protocol = Protocol(num_clips=clips, replications=replications, detailed_replications=0, seed=seed)
    comparison = kinematic_source().comparison(samples["real"], samples["train"], protocol)
    return comparison.scores({"generated": samples["generated"]})["generated"]


def _are_one_motion(real: SampleSet, generated: SampleSet) -> bool:
    single = real.num_sequences == generated.num_sequences == 1
    return single and np.array_equal(real.sequences.values, generated.sequences.values)


def common_framerate(sets: Iterable[Motions], fps: Framerate | None) -> Fraction:
    """The one framerate of sets of motions; raises `UsageError` for several, for another than `fps`, or for none."""
    rates = set() if fps is None else {parse_fps(fps)}
    rates |= {motion.fps for motions in sets for motion in motions if isinstance(motion, Motion)}
    if len(rates) != 1:
        found = ", ".join(str(rate) for rate in sorted(rates)) or "none (arrays need fps=…)"
        raise UsageError(f"motions at one framerate are compared, these have {found}: motion.resample(fps) changes it")
    return rates.pop()


def samples_of(name: str, motions: Motions, fps: Fraction) -> SampleSet:
    """Motions as a sample set of 22 joints. Raises `ClipError` for none and `UsageError` for arrays of other shapes."""
    joints = [
        map_joints(each, SMPL22.name) if isinstance(each, Motion) else np.asarray(each, np.float32) for each in motions
    ]
    if not joints:
        raise ClipError(f"{name} holds no motion")
    for number, each in enumerate(joints):
        if each.ndim != 3 or each.shape[1:] != (SMPL22.num_joints, 3):
            raise UsageError(f"{name}[{number}] has the shape {each.shape}, expected [frames, 22, 3] in metres")
    return sample_set(name, fps, joints, [str(number) for number in range(len(joints))])
