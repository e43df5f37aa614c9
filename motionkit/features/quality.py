"""Quality measures and flags of a motion, computed for every sequence of a store.

`measure(motion)` is pure and cheap enough to run at ingest. docs/quality.md has every formula, unit and threshold.
"""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

import numpy as np

from motionkit.core.motion import Motion
from motionkit.core.shapes import Float, Float32, Float64, Int64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError, body_axis, joint_map
from motionkit.core.timegrid import COMMON_FPS, runs

# Above these a sequence is flagged, not refused: real captures hold glitches and floors that are off, and the reader
# decides. docs/quality.md says where each figure comes from, docs/results/quality.md what it hits in real captures.
MAX_JOINT_SPEED = 30.0
MAX_FLOOR_HEIGHT = 0.25
MAX_JITTER = 400.0
MAX_FROZEN_SECONDS = 0.25
MAX_FOOT_SKATE_SHARE = 0.5
MAX_BONE_LENGTH_DRIFT = 0.1
# 30 degrees.
MAX_LYING_ELEVATION = 0.5


# Squares of larger numbers leave float32; a motion that reaches this far carries flags for it in any case.
FAR_METRES = 1e9


@dataclass(frozen=True)
class Quality:
    """Quality measures of a motion, and flags for suspicious ones.

    Times are from the first frame; None if not measurable: too short or too slow a take, a skeleton without known feet,
    no jump, no held frame. `effective_fps` is the estimated
    framerate of the capture, at most the file's. All values are finite.
    """

    max_joint_speed_metres_per_second: float
    num_teleports: int
    first_teleport_seconds: float | None
    jitter_metres_per_second_cubed: float | None
    frozen_seconds: float
    frozen_start_seconds: float | None
    held_share: float
    foot_skate_metres_per_second: float | None
    foot_skate_share: float | None
    floor_height_metres: float
    bone_length_drift: float | None
    effective_fps: float | None
    flags: tuple[str, ...]


def measure(motion: Motion) -> Quality:
    """Measure a motion whose numbers are finite: a pure function of its frames, framerate and skeleton.

    Flags: `single_frame`, `joint_speed`, `teleport`, `jitter`, `frozen`, `foot_skate`, `floor_height`, `bone_length`,
    `lying`, `upsampled`.
    """
    positions, fps = motion.joint_positions, float(motion.fps)
    if positions.min() < -FAR_METRES or positions.max() > FAR_METRES:
        positions = np.clip(positions, -FAR_METRES, FAR_METRES, dtype=np.float32)
    squared = squared_differences(positions, 1)
    longest = np.sqrt(squared.max(axis=1, initial=0.0))
    longest[longest <= SAME_METRES] = 0.0
    max_speed = float(longest.max(initial=0.0) * fps)
    jumps = _jumps(np.sqrt(squared), fps)
    held_starts, held_stops = runs(longest == 0.0)
    held_lengths = held_stops - held_starts
    frozen = int(held_lengths.argmax()) if len(held_lengths) else None
    frozen_seconds = 0.0 if frozen is None else float(held_lengths[frozen] / fps)
    noise = jitter(positions, fps)
    skate_speed, skate_share = foot_skate(positions, motion.skeleton, fps) or (None, None)
    floor = float(positions[..., 1].min())
    drift = bone_length_drift(positions, motion.skeleton, fps)
    elevation = head_elevation(positions, motion.skeleton, fps)
    captured = effective_fps(positions, longest, fps)
    flags = {
        "single_frame": motion.num_frames == 1,
        "joint_speed": max_speed > MAX_JOINT_SPEED,
        "teleport": len(jumps) > 0,
        "jitter": noise is not None and noise > MAX_JITTER,
        "frozen": frozen_seconds >= MAX_FROZEN_SECONDS,
        "foot_skate": skate_share is not None and skate_share > MAX_FOOT_SKATE_SHARE,
        "floor_height": abs(floor) > MAX_FLOOR_HEIGHT,
        "bone_length": drift is not None and drift > MAX_BONE_LENGTH_DRIFT,
        "lying": elevation is not None and elevation < MAX_LYING_ELEVATION,
        "upsampled": captured is not None and captured < fps,
    }
    return Quality(
        max_joint_speed_metres_per_second=max_speed,
        num_teleports=len(jumps),
        first_teleport_seconds=float((jumps[0] + 1) / fps) if len(jumps) else None,
        jitter_metres_per_second_cubed=noise,
        frozen_seconds=frozen_seconds,
        frozen_start_seconds=None if frozen is None else float(held_starts[frozen] / fps),
        held_share=float(held_lengths.sum() / len(squared)) if len(squared) else 0.0,
        foot_skate_metres_per_second=skate_speed,
        foot_skate_share=skate_share,
        floor_height_metres=floor,
        bone_length_drift=drift,
        effective_fps=captured,
        flags=tuple(flag for flag, holds in flags.items() if holds),
    )


# No capture system sees a body stand still to a micrometre; held frames are equal to the last bit, and those of a
# format that stores differences nearly so.
SAME_METRES = 1e-6

# A jump is a step faster by this much than the joint's steps two frames earlier and later. 500 m/s² over two frames is
# more than bodies do: in takes of running, punching and back flips at 16 … 120 fps the most is 240 m/s², while the
# known glitches of the CMU database begin at 750. At low framerates this would allow anything, so 10 m/s is enough.
JUMP_ACCELERATION = 500.0
MAX_JUMP_SPEED = 10.0


def _jumps(lengths: Float32[np.ndarray, "steps joints"], fps: float) -> Int64[np.ndarray, "jumps"]:
    # Steps that some joint makes in a jump. A joint that jumps and comes back makes two long steps, so the steps that
    # they are compared with lie two away; of the outermost steps only one such is there.
    if len(lengths) < 5:
        return np.zeros(0, np.int64)
    excess = lengths.copy()
    excess[2:-2] -= np.maximum(lengths[:-4], lengths[4:])
    excess[:2] -= lengths[2:4]
    excess[-2:] -= lengths[-4:-2]
    return np.flatnonzero(excess.max(axis=1) * fps > min(MAX_JUMP_SPEED, 2.0 * JUMP_ACCELERATION / fps))


def squared_differences(
    positions: Float32[np.ndarray, "rows joints 3"], order: int
) -> Float32[np.ndarray, "differences joints"]:
    """Squared lengths of the differences of an order in time; none where there are not more rows than that."""
    vectors = np.diff(positions, n=order, axis=0)
    return np.asarray(np.einsum("tjc,tjc->tj", vectors, vectors))


# A bin lasts as long as a frame at 30 fps, the slowest rate of native capture: what happens between 30 bins a second is
# there in files of every rate above it, and nothing else is.
BINS_PER_SECOND = 30.0


def bin_means(values: Float32[np.ndarray, "frames *channels"], fps: float) -> Float32[np.ndarray, "bins *channels"]:
    """Means over bins of 1/30 s from the first frame on, each frame standing for 1/fps s; no bin is cut short."""
    frames_per_bin = fps / BINS_PER_SECOND
    if frames_per_bin == 1.0:
        return values
    # The last bin of a file at 29.97 fps may lack a hundredth of a frame.
    num_bins = int(len(values) / frames_per_bin + 0.01)
    edges = np.minimum(np.arange(num_bins + 1) * frames_per_bin, len(values))
    before = np.minimum(edges.astype(np.int64), len(values) - 1)
    into = (edges - before).astype(np.float32).reshape(-1, *(1,) * (values.ndim - 1))
    if not num_bins:
        return values[:0]
    # Whole frames from one edge to the next, without the part before the one and with the part before the other.
    cut = into * values[before]
    sums = np.add.reduceat(values, before, axis=0)[:-1]
    # A bin that begins where the next one does holds no whole frame (framerates under 30).
    sums[before[1:] == before[:-1]] = 0.0
    means = (sums - cut[:-1] + cut[1:]) / np.float32(frames_per_bin)
    return np.asarray(means)


# Below this framerate the bins of 1/30 s would hold interpolated values (29.97 fps is still measured).
MIN_FPS = 29.9
MIN_BINS = 8


def jitter(positions: Float32[np.ndarray, "frames joints 3"], fps: float) -> float | None:
    """Jerk that three quarters of all joints at all instants exceed, in m/s³; None below 29.9 fps or under 0.3 s.

    Jerk is the third difference of means over 1/30 s, so that the figure means the same from 30 fps upwards: raw
    differences grow with the cube of the framerate. Its lower quartile hardly rises with vigorous motion, which leaves
    some joints and instants calm, as noise does not.
    """
    if fps < MIN_FPS:
        return None
    bins = bin_means(positions, fps)
    if len(bins) < MIN_BINS:
        return None
    jerk_squared = squared_differences(bins, 3).ravel()
    quarter = len(jerk_squared) // 4
    return float(np.sqrt(np.partition(jerk_squared, quarter)[quarter]) * BINS_PER_SECOND**3)


# Lengths and posture change slowly: 20 poses a second are enough. Shorter bones than this are points that lie on each
# other.
POSES_PER_SECOND = 20.0
MIN_BONE_METRES = 0.03


def bone_length_drift(
    positions: Float32[np.ndarray, "frames joints 3"], skeleton: Skeleton, fps: float
) -> float | None:
    """The maximum over bones of (longest − shortest) / mean length; None without a bone of 3 cm.

    A joint with a zero rest offset has no bone: markers, which are all children of the first, move freely.
    """
    poses = positions[:: max(1, round(fps / POSES_PER_SECOND))]
    has_bone = np.any(skeleton.offsets != 0, axis=1).tolist()
    joints = np.array(
        [joint for joint, parent in enumerate(skeleton.parents) if parent >= 0 and has_bone[joint]], np.int64
    )
    bones = poses[:, joints] - poses[:, np.array(skeleton.parents, np.int64)[joints]]
    lengths = np.sqrt(np.einsum("tbc,tbc->tb", bones, bones))
    mean = lengths.mean(axis=0)
    known = mean >= MIN_BONE_METRES
    if not known.any():
        return None
    return float(((lengths.max(axis=0) - lengths.min(axis=0))[known] / mean[known]).max())


def head_elevation(positions: Float32[np.ndarray, "frames joints 3"], skeleton: Skeleton, fps: float) -> float | None:
    """The sine of the angle at which the head is above the feet, its 95 % quantile; None for unknown joints.

    It is near 1 for a body that stands for a twentieth of the time, near 0 for one that lies or crawls throughout.
    """
    try:
        vectors = body_axis(skeleton, positions[:: max(1, round(fps / POSES_PER_SECOND))])
    except SkeletonMapError:
        return None
    lengths = np.linalg.norm(vectors, axis=-1)
    has_length = lengths >= MIN_BONE_METRES
    sines = np.sort(vectors[has_length, 1] / lengths[has_length])
    return float(sines[round(0.95 * (len(sines) - 1))]) if len(sines) else None


FOOT_JOINTS = ("left_ankle", "left_foot", "right_ankle", "right_foot")
# A joint of the foot is on the ground while it is within 2 cm of its own lowest level, which is taken from the take
# because floors are off and an ankle stands higher than a toe. Within 5 cm (CondMDI's height) feet of runners swing.
GROUND_METRES = 0.02
GROUND_QUANTILE = 0.05
# A slide is measured over 0.1 s: at a standstill, half a millimetre of noise is 60 mm/s from frame to frame at 120 fps.
SLIDE_BINS = 3
SLIDING_SPEED = 0.25
MIN_GROUNDED = 15


def foot_skate(
    positions: Float32[np.ndarray, "frames joints 3"], skeleton: Skeleton, fps: float
) -> tuple[float, float] | None:
    """Median speed of the steadiest foot joint on the ground, m/s, and the share of that time in which it slides.

    None if the skeleton has no known feet, or these are on the ground for under 0.5 s.
    While a body stands, walks or runs, one joint of the feet on the ground rests: the steadiest of them is measured.
    Instants are those of bins of 1/30 s, so that the figure means the same at every framerate.
    """
    rows = _foot_rows(skeleton)
    if rows is None:
        return None
    bins = bin_means(np.matmul(rows, positions), fps)
    if len(bins) <= SLIDE_BINS:
        return None
    height = bins[..., 1]
    rank = int(GROUND_QUANTILE * (len(bins) - 1))
    low = height <= np.partition(height, rank, axis=0)[rank] + GROUND_METRES
    slide = bins[SLIDE_BINS:, :, ::2] - bins[:-SLIDE_BINS, :, ::2]
    speed = np.hypot(slide[..., 0], slide[..., 1]) * (BINS_PER_SECOND / SLIDE_BINS)
    stays = np.logical_and.reduce([low[first : first + len(speed)] for first in range(SLIDE_BINS + 1)])
    steadiest = np.where(stays, speed, np.inf).min(axis=1)
    grounded = steadiest[np.isfinite(steadiest)]
    if len(grounded) < MIN_GROUNDED:
        return None
    return float(np.median(grounded)), float(np.mean(grounded > SLIDING_SPEED))


@lru_cache(maxsize=1024)
def _foot_rows(skeleton: Skeleton) -> Float32[np.ndarray, "feet joints"] | None:
    # The foot joints that a skeleton has, as weights of its own; made-up toes and unnamed tips are left out.
    try:
        mapping = joint_map(skeleton, SMPL22.name)
    except SkeletonMapError:
        return None
    feet = [SMPL22.index(name) for name in FOOT_JOINTS if name not in mapping.made_up]
    return np.asarray(mapping.weights[[foot for foot in feet if not mapping.tip_weights[foot].any()]], np.float32)


# The framerate of the capture, if it is lower than the file's. Held frames are counted. Interpolation leaves
# a knot at every captured instant: differences of second or fourth order are those of a smooth curve between knots, but
# not across them, so their size pulses at the captured framerate (in images: Gallagher, Detection of linear and cubic
# interpolation in JPEG compressed images, 2005).

Kernel = Callable[[Float64[np.ndarray, "*shape"]], Float64[np.ndarray, "*shape"]]

# Energy between knots relative to that across them, where interpolation is exact and only rounding is left.
FLOOR = 1e-4
MIN_PHASES = 24
MAX_PHASES = 96


def _linear_spline(x: Float64[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(x)))


def _quadratic_spline(x: Float64[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
    x = np.abs(x)
    return np.where(x < 0.5, 0.75 - x**2, 0.5 * np.maximum(0.0, 1.5 - x) ** 2)


def _cubic_spline(x: Float64[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
    x = np.abs(x)
    return np.where(x < 1.0, 2 / 3 - x**2 + 0.5 * x**3, np.maximum(0.0, 2.0 - x) ** 3 / 6)


def _kink_in_fourth(x: Float64[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
    return np.asarray(_linear_spline(x + 1) - 2 * _linear_spline(x) + _linear_spline(x - 1))


def _bend_in_fourth(x: Float64[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
    return np.asarray(_quadratic_spline(x + 0.5) - _quadratic_spline(x - 0.5))


# The difference (of order 2 or 4) at a sample x frames after a knot at which the first, second or third derivative
# jumps: linear and SLERP, piecewise cubic through tangents, and cubic spline interpolation. They are B-splines and
# differences of these (de Boor: a divided difference of a truncated power is a B-spline).
KNOTS: dict[int, tuple[Kernel, ...]] = {
    2: (_linear_spline,),
    4: (_kink_in_fourth, _bend_in_fourth, _cubic_spline),
}


def explained(size: Float64[np.ndarray, "rows"], knot: Kernel, rate: float, fps: float) -> float:
    """Share of the variance of `size` (the log energy of differences) that knots at `rate` explain, best phase taken.

    The pattern may be weaker than that of exact interpolation, as noise or rotations make it, and not stronger: this is
    what tells 30 fps from the 90 that pulse alike in a file at 120.
    """
    spacing = fps / rate
    period = Fraction(spacing).limit_denominator(MIN_PHASES)
    num_phases = min(MAX_PHASES, period.numerator * -(-MIN_PHASES // period.numerator))
    place = np.arange(len(size)) + np.arange(num_phases)[:, None] * (spacing / num_phases)
    after = place % spacing
    reach = range(-int(3 / spacing) - 1, int(3 / spacing) + 2)
    energy = sum((knot(after - before * spacing) ** 2 for before in reach), start=np.zeros_like(after))
    pattern = np.log(energy + FLOOR)
    pattern -= pattern.mean(axis=1, keepdims=True)
    variance = np.einsum("pt,pt->p", pattern, pattern)
    slope = np.clip(pattern @ size / (variance + 1e-9), 0.0, 1.2)
    left = np.mean((size - slope[:, None] * pattern) ** 2, axis=1)
    return float(1.0 - left.min() / np.mean(size**2))


MIN_FRAMES = 60
# A few joints say enough, and this many frames.
NUM_JOINTS = 8
MAX_FRAMES = 8192

# Captured rates that are looked for. The pulse of a rate above half of the file's appears folded, at their difference;
# below 8 Hz bodies pulse by themselves (the step's harmonics), so that nobody can tell 25 fps in a file at 30.
MIN_CAPTURED_FPS = 12.0
MIN_PULSE_HERTZ = 8.0
MAX_CAPTURED_SHARE = 0.9

# A pulse stands out of the spectrum around it by this factor (docs/results/quality.md), and knots at its rate explain
# that much of what happens faster than a tenth of a second.
MIN_PROMINENCE = 60.0
MIN_EXPLAINED = 0.15
ALIKE = 0.01
LINES_RATHER = 0.7
NEIGHBOURS = 15

# Differences that float32 positions of a few metres cannot tell from zero.
ROUNDING_METRES = 1e-6

# Held frames: at most this share is new, and the new ones come this regularly.
MAX_NEW_SHARE = 0.9
MIN_REGULAR = 0.95


def effective_fps(
    positions: Float32[np.ndarray, "frames joints 3"], moved: Float[np.ndarray, "steps"], fps: float
) -> float | None:
    """The estimated framerate of the capture: `fps`, or a lower one.

    `moved` is the longest step (m) of any joint between neighbouring frames, 0 for held frames. Of rates that explain
    the frames equally well the highest is returned. None under 60 frames.
    """
    if len(positions) < MIN_FRAMES:
        return None
    held = _rate_of_held(moved, fps)
    if held is not None:
        return held
    few = positions[:MAX_FRAMES, :: max(1, positions.shape[1] // NUM_JOINTS)]
    difference = few.reshape(len(few), -1)
    second = np.diff(difference, n=2, axis=0)
    lines = _pulses(_log_energy(second, fps), 2, fps)
    curves = _pulses(_log_energy(np.diff(second, n=2, axis=0), fps), 4, fps)
    # Straight lines pulse in both, but only second differences tell which of two rates they join.
    pulses = lines if _best(lines) >= LINES_RATHER * _best(curves) else curves
    if _best(pulses) < MIN_EXPLAINED:
        return fps
    return max(rate for share, rate in pulses if share > _best(pulses) - ALIKE)


def _best(pulses: list[tuple[float, float]]) -> float:
    return max((share for share, _ in pulses), default=0.0)


def _rate_of_held(moved: Float[np.ndarray, "steps"], fps: float) -> float | None:
    # Every captured frame held for ⌊s⌋ or ⌈s⌉ frames. Stretches that are frozen for longer say nothing.
    gaps = np.diff(np.flatnonzero(moved > 0.0))
    if len(gaps) < MIN_FRAMES // 8:
        return None
    gaps = gaps[gaps <= 2.5 * gaps.mean()]
    spacing = float(gaps.mean())
    regular = float(np.mean((gaps == np.floor(spacing)) | (gaps == np.ceil(spacing))))
    if 1.0 / spacing > MAX_NEW_SHARE or regular < MIN_REGULAR:
        return None
    counted = fps / spacing
    known = [fps / factor for factor in range(2, 9)] + [float(rate) for rate in COMMON_FPS if rate.denominator < 1001]
    nearest = min(known, key=lambda rate: abs(rate - counted))
    return nearest if abs(nearest - counted) < 0.02 * counted else counted


@lru_cache(maxsize=64)
def _pulsing_rates(fps: float) -> tuple[tuple[float, ...], Float64[np.ndarray, "rates"]]:
    # Whole fractions of the file's rate, and the rates at which cameras run that are none of these: those whose pulse
    # can be seen, and its frequency in cycles a frame.
    fractions = [fps / factor for factor in range(2, 9)]
    others = (float(rate) for rate in COMMON_FPS if rate.denominator < 1001)
    rates = [*fractions, *(rate for rate in others if min(abs(rate - each) for each in fractions) > 0.005 * rate)]
    hertz = {rate: min(rate % fps, -rate % fps) for rate in rates if rate >= MIN_CAPTURED_FPS}
    seen = tuple(r for r in hertz if r <= MAX_CAPTURED_SHARE * fps and hertz[r] >= MIN_PULSE_HERTZ)
    return seen, np.array([hertz[rate] / fps for rate in seen])


def _log_energy(difference: Float32[np.ndarray, "rows values"], fps: float) -> Float64[np.ndarray, "rows"]:
    # What happens faster than a tenth of a second in the logarithm, in which strong and weak motion pulse alike.
    energy = np.einsum("tc,tc->t", difference, difference).astype(np.float64)
    logarithm = np.log(energy + difference.shape[1] * ROUNDING_METRES**2)
    return without_trend(logarithm, fps)


def without_trend(values: Float64[np.ndarray, "rows"], fps: float) -> Float64[np.ndarray, "rows"]:
    """Values less their running mean over a tenth of a second."""
    width = max(5, round(fps / 10) | 1)
    padded = np.concatenate(([0.0], np.full(width // 2, values[0]), values, np.full(width // 2, values[-1])))
    sums = np.cumsum(padded)
    return np.asarray(values - (sums[width:] - sums[:-width]) / width)


def _pulses(size: Float64[np.ndarray, "rows"], order: int, fps: float) -> list[tuple[float, float]]:
    # (share of the size that knots at the rate explain, rate) of the rates that stand out of the spectrum.
    rates, frequencies = _pulsing_rates(fps)
    spread = 1.5 * float(np.median(np.abs(size))) + 1e-9
    size = np.minimum(np.maximum(size, -4.0 * spread), 4.0 * spread)
    power = np.abs(np.fft.rfft(size * np.hanning(len(size)))) ** 2
    chosen = np.flatnonzero(_prominence(power, frequencies * len(size)) > MIN_PROMINENCE)
    return [(max(explained(size, knot, rates[i], fps) for knot in KNOTS[order]), rates[i]) for i in chosen.tolist()]


def _prominence(
    power: Float64[np.ndarray, "frequencies"], places: Float64[np.ndarray, "rates"]
) -> Float64[np.ndarray, "rates"]:
    # The peaks at some frequencies over the means of their neighbourhoods.
    last = len(power) - 1
    centre = np.minimum(np.rint(places).astype(np.int64), last)
    reach = max(NEIGHBOURS, len(power) // 10)
    sums = np.concatenate(([0.0], np.cumsum(power)))
    low, inner_low = np.maximum(1, centre - reach), np.maximum(1, centre - 3)
    inner_high, high = np.minimum(len(power), centre + 4), np.minimum(len(power), centre + reach)
    high = np.maximum(high, inner_high)
    around = sums[inner_low] - sums[low] + sums[high] - sums[inner_high]
    count = inner_low - low + high - inner_high
    peak = np.maximum(np.maximum(power[centre - 1], power[centre]), power[np.minimum(centre + 1, last)])
    return np.asarray(peak / (around / np.maximum(count, 1) + 1e-30))
