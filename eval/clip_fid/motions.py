"""clip-FID of two sets of motions in memory, in one call."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

from eval.clip_fid.clips import ClipError, Protocol
from eval.clip_fid.features import Comparison, kinematic_source, native_source
from eval.metrics.checks import Estimate
from eval.sets.sets import SampleSet, sample_set
from motionkit.core.errors import UsageError
from motionkit.core.framerate import Framerate, format_fps, parse_fps
from motionkit.core.motion import Motion
from motionkit.core.progress import warn
from motionkit.core.shapes import Float
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import map_joints

Motions = Sequence[Motion] | Sequence[Float[np.ndarray, "_frames 22 3"]]


def clip_fid(
    real: Motions,
    generated: Motions,
    *,
    fps: Framerate | None = None,
    train: Motions | None = None,
    features: str | Path = "kinematic",
    clips: int = 4096,
    replications: int = 20,
    seed: int = 0,
) -> Estimate:
    """Fréchet distance between random native-rate clips of two sets of motions at one framerate, with its interval.

    Motions are `Motion`s, brought to the 22 joints, or arrays [T, 22, 3] in metres, y up, at `fps`. Each replication
    draws `clips` clips of 16 to 64 poses from either set. `features` is the kinematic descriptor, or a run whose
    learned evaluator is used. The descriptor is fitted on `train`, by default on the real motions; tables fit it on the
    training split and compare with the test split (docs/evaluators.md).

    Lower is better, and 0 is not reached: the floor is what other real motions score. Scores compare only with the same
    real motions, framerate, features and number of clips. Warns where both sets are one and the same motion: its clips
    are the same on both sides, and their distance is 0.

    Raises `UsageError` for motions of several framerates or of another one than `fps`, `ClipError` where no motion is
    long enough for a clip, `MotionkitError` for a skeleton that cannot be brought to the 22 joints.

    >>> store = mk.Store.open("store")
    >>> real = [motion.resample(30) for motion in store.read_many(store)]
    >>> slowed = [mk.complete(motion.resample(10), fps=30, model="slerp") for motion in real]
    >>> floor = clip_fid(real, real, clips=256, replications=3)
    >>> score = clip_fid(real, slowed, clips=256, replications=3)
    >>> score.mean - score.ci95 > floor.mean + floor.ci95
    True
    """
    given = None if fps is None else parse_fps(fps)
    sets = {"real": real, "generated": generated, "train": real if train is None else train}
    rates = {rate for motions in sets.values() for rate in _framerates(motions, given)}
    if len(rates) != 1:
        found = ", ".join(format_fps(rate) for rate in sorted(rates)) or "none (arrays need fps=…)"
        raise UsageError(f"motions at one framerate are compared, these have {found}: motion.resample(fps) changes it")
    rate = rates.pop()
    samples = {name: samples_of(name, motions, rate) for name, motions in sets.items()}
    if _are_one_motion(samples["real"], samples["generated"]):
        warn(
            "real and generated are the same single motion: both sides draw the same clips, so clip-FID is 0 and says "
            "nothing; compare with other motions, or several real ones with themselves for the floor"
        )
    protocol = Protocol(num_clips=clips, replications=replications, detailed_replications=0, seed=seed)
    comparison = comparison_with(samples["real"], samples["train"], protocol, features)
    return comparison.scores({"generated": samples["generated"]})["generated"].clip_fid


def comparison_with(real: SampleSet, train: SampleSet, protocol: Protocol, features: str | Path) -> Comparison:
    """The real side of `clip_fid`, fitted once for any number of sets; raises what it raises."""
    source = kinematic_source() if features == "kinematic" else native_source(Path(features))
    return source.comparison(real, train, protocol)


def _are_one_motion(real: SampleSet, generated: SampleSet) -> bool:
    single = real.num_sequences == generated.num_sequences == 1
    return single and np.array_equal(real.sequences.values, generated.sequences.values)


def _framerates(motions: Motions, given: Fraction | None) -> set[Fraction]:
    own = {motion.fps for motion in motions if isinstance(motion, Motion)}
    return own if given is None else own | {given}


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
