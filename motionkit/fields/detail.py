"""Detail: motion above 10 Hz, predicted from slow motion, learnt from captures and added to a motion field.

Everything is on a 120 Hz grid and uses finite filters, so each sample depends on `MARGIN` samples on either side and on
nothing else. `fit_detail` learns in closed form (ridge regression); `detailed` adds what was learnt to a field.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from functools import cache, lru_cache, partial

import numpy as np
import numpy.typing as npt

from motionkit.core.errors import UsageError
from motionkit.core.kinematics import quaternion_between, quaternion_rotate, rotation_vector_to_quaternion
from motionkit.core.shapes import Float, Float32, Float64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.fields.motion_field import (
    DerivedField,
    MotionField,
    Poses,
    Times,
    at_fps,
    query_in_blocks,
    turned_rotations,
)
from motionkit.fields.resample import kernel_matrix, kernel_shape

GRID_FPS = 120
MARGIN = 192
"""Samples on both sides that the filters below need, and a few more."""

EDGES_HZ = (10.0, 14.0, 20.0, 28.0, 40.0, 60.0)
NUM_BANDS = len(EDGES_HZ) - 1
BAND_REACH = 60
ENVELOPE_REACH = 4

SLOW_HZ, SLOW_REACH = 6.0, 45
"""With a higher limit detail follows real motion a little closer, and generated motion gets less of it."""
LOWEST_REACH = 120
ENERGY_REACH = 36
LAGS = (-5, 0, 5)

NUM_JOINTS = SMPL22.num_joints
FEET = [7, 8, 10, 11]
WATCHED = [*FEET, 0, 15, 20, 21]
"""Feet, root, head and hands of the 22-joint layout: speed, jerk, vertical velocity and acceleration at three times.
"""
ENERGETIC = [0, 4, 5, 7, 8, 15, 18, 19, 20, 21]
"""Joints whose slow energy over 0.6 s is a feature too."""
HIPS_AND_SHOULDERS = ((1, 2), (16, 17))
NUM_FEATURES = len(LAGS) * (len(FEET) + 4 * len(WATCHED)) + len(ENERGETIC)

FLOOR_METRES = 0.0005
"""Standard deviation of white noise at 120 fps that is added to a power before taking its logarithm."""
LARGEST_FEATURE = 4.0
RIDGE = 0.01
"""The penalty on squared weights, as a share of the number of frames; features have unit variance."""
EMPHASIS = 1.2
"""A factor on predicted deviations of log power: slow motion seen from three folds of training performers predicts fast
motion too weakly, and with it the timing of the detail profile is 1 on their mean."""
MOST_QUANTILE = 0.999
LARGEST_DEVIATION = 4.0
"""Jumps of a capture are clipped at this many standard deviations."""
MOTIONS_KEPT = 4
Displacements = Callable[[], Float64[np.ndarray, "instants coordinates"]]
_NO_LENGTH = 1e-9


@dataclass(frozen=True, eq=False)
class SlowMotion:
    """The state of a body at every sample of the grid.

    `features` are logarithms of heights, speeds, jerks and energies, and vertical velocities and
    accelerations below a limit; `facing` is the direction across the body, a unit vector (x, z).
    """

    features: Float64[np.ndarray, "instants features"]
    facing: Float64[np.ndarray, "instants 2"]


def with_ends(positions: Float[np.ndarray, "instants joints 3"]) -> Float64[np.ndarray, "padded joints 3"]:
    """Pads a motion by `MARGIN` samples on both ends by point reflection, which keeps velocity continuous."""
    if len(positions) == 1:
        return np.repeat(positions.astype(np.float64), 1 + 2 * MARGIN, axis=0)
    pad = ((MARGIN, MARGIN), (0, 0), (0, 0))
    return np.asarray(np.pad(positions.astype(np.float64), pad, mode="reflect", reflect_type="odd"))


def slow_motion(positions: Float64[np.ndarray, "padded joints 3"]) -> SlowMotion:
    """The state at all samples except `MARGIN` at both ends, for the 22 joints, in metres, y up."""
    from scipy.ndimage import minimum_filter1d

    slow = filtered(positions.reshape(len(positions), -1), low_pass(SLOW_HZ, SLOW_REACH)[None])[0]
    slow = slow.reshape(len(slow), *positions.shape[1:])
    velocity = np.gradient(slow, 1.0 / GRID_FPS, axis=0)
    acceleration = np.gradient(velocity, 1.0 / GRID_FPS, axis=0)
    jerk = np.gradient(acceleration, 1.0 / GRID_FPS, axis=0)
    lowest = minimum_filter1d(slow[:, FEET, 1].min(axis=1), 2 * LOWEST_REACH + 1, mode="nearest")
    now = np.concatenate(
        (
            np.log(np.clip(slow[:, FEET, 1] - lowest[:, None], 0.0, 0.5) + 0.02),
            np.log(np.linalg.norm(velocity[:, WATCHED], axis=-1) + 0.05),
            np.arctan(velocity[:, WATCHED, 1] / 0.5),
            np.arctan(acceleration[:, WATCHED, 1] / 8.0),
            np.log(np.linalg.norm(jerk[:, WATCHED], axis=-1) + 10.0),
        ),
        axis=1,
    )
    energy = np.square(acceleration[:, ENERGETIC]).sum(axis=-1)
    energy = filtered(energy, hann(ENERGY_REACH)[None])[0]
    here = slice(MARGIN - SLOW_REACH, len(slow) - (MARGIN - SLOW_REACH))
    lagged = [now[here.start + lag : here.stop + lag] for lag in LAGS]
    log_energy = np.log(_inner(energy, MARGIN - SLOW_REACH - ENERGY_REACH) + 0.25)
    across = sum(slow[here][:, right] - slow[here][:, left] for left, right in HIPS_AND_SHOULDERS)[:, [0, 2]]
    facing = np.asarray(across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9))
    return SlowMotion(np.concatenate((*lagged, log_energy), axis=1), facing)


def band_motion(signals: Float64[np.ndarray, "padded columns"]) -> Float64[np.ndarray, "bands instants columns"]:
    """Signals filtered into bands, at all samples except `BAND_REACH` at both ends."""
    return filtered(signals, band_filters())


def band_power(positions: Float64[np.ndarray, "padded joints 3"]) -> Float64[np.ndarray, "instants bands joints"]:
    """Squared displacement (m²) in every band, averaged over 0.07 s, except `MARGIN` samples at both ends."""
    bands = band_motion(positions.reshape(len(positions), -1))
    power = np.square(bands).reshape(*bands.shape[:2], -1, 3).sum(axis=-1)
    power = np.moveaxis(power, 0, 1).reshape(bands.shape[1], -1)
    smooth = filtered(power, hann(ENVELOPE_REACH)[None])[0]
    return _inner(smooth, MARGIN - BAND_REACH - ENVELOPE_REACH).reshape(-1, NUM_BANDS, positions.shape[1])


def filtered(
    signals: Float64[np.ndarray, "instants columns"], filters: Float64[np.ndarray, "filters taps"]
) -> Float64[np.ndarray, "filters inner columns"]:
    """Symmetric filters applied to signals, valid samples only."""
    import scipy.fft

    taps = filters.shape[1]
    size = scipy.fft.next_fast_len(len(signals), real=True)
    spectrum = scipy.fft.rfft(signals, n=size, axis=0)
    result = np.empty((len(filters), len(signals) - taps + 1, signals.shape[1]))
    for each, gain in zip(result, scipy.fft.rfft(filters, n=size, axis=1), strict=True):
        each[:] = scipy.fft.irfft(spectrum * gain[:, None], n=size, axis=0)[taps - 1 : len(signals)]
    return result


@cache
def low_pass(cutoff_hz: float, reach: int) -> Float64[np.ndarray, "taps"]:
    """A low-pass filter of 2 · reach + 1 taps, half amplitude at the cut-off."""
    taps = np.arange(-reach, reach + 1)
    weights = np.sinc(2.0 * cutoff_hz / GRID_FPS * taps) * np.hamming(len(taps))
    return np.asarray(weights / weights.sum())


@cache
def hann(reach: int) -> Float64[np.ndarray, "taps"]:
    """Weights of a mean over 2 · reach + 1 samples."""
    window = np.hanning(2 * reach + 3)[1:-1]
    return np.asarray(window / window.sum())


@cache
def band_filters() -> Float64[np.ndarray, "bands taps"]:
    """Differences of low-pass filters; they add up to everything above the lowest edge."""
    whole = np.zeros(2 * BAND_REACH + 1)
    whole[BAND_REACH] = 1.0
    below = [*(low_pass(edge, BAND_REACH) for edge in EDGES_HZ[:-1]), whole]
    return np.diff(np.array(below), axis=0)


@cache
def floors() -> Float64[np.ndarray, "bands"]:
    """Power in every band of white noise of `FLOOR_METRES` in three coordinates, m²."""
    return np.asarray(3.0 * FLOOR_METRES**2 * np.square(band_filters()).sum(axis=1))


def to_body(
    vectors: Float64[np.ndarray, "*before instants joints 3"], facing: Float64[np.ndarray, "instants 2"]
) -> Float64[np.ndarray, "*before instants joints 3"]:
    """Rotates world vectors to the body's frame: across, up, ahead."""
    cosine, sine = facing[:, None, 0], facing[:, None, 1]
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack((x * cosine + z * sine, y, z * cosine - x * sine), axis=-1)


def _inner(values: Float64[np.ndarray, "instants columns"], margin: int) -> Float64[np.ndarray, "inner columns"]:
    return values[margin : len(values) - margin]


@dataclass(frozen=True, eq=False)
class Detail:
    """Log power of fast motion as a linear function of features of slow motion, and the correlation of joints.

    `centre` and `scale` standardise features; `weights` and `offset` give the log of power (m²) above a floor, of
    `NUM_BANDS` × 22 joints, clipped at `most`; `mixing` maps independent normals to correlated joint components
    (across, up, ahead) of one band, each joint's squares adding up to 1.
    """

    centre: Float64[np.ndarray, "features"]
    scale: Float64[np.ndarray, "features"]
    weights: Float64[np.ndarray, "features outputs"]
    offset: Float64[np.ndarray, "outputs"]
    most: Float64[np.ndarray, "outputs"]
    mixing: Float64[np.ndarray, "bands coordinates coordinates"]

    def arrays(self) -> dict[str, npt.NDArray[np.float64]]:
        """All parameters by name."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    def power(self, slow: SlowMotion) -> Float64[np.ndarray, "instants bands joints"]:
        """Expected squared displacement (m²) in every band, given the state."""
        state = np.clip((slow.features - self.centre) * self.scale, -LARGEST_FEATURE, LARGEST_FEATURE)
        log_power = np.minimum(state @ self.weights + self.offset, self.most)
        power = np.exp(log_power).reshape(-1, NUM_BANDS, NUM_JOINTS) - floors()[:, None]
        return np.asarray(np.maximum(power, 0.0))

    def noise(self, seeds: tuple[int, int], count: int) -> Float64[np.ndarray, "bands instants joints 3"]:
        """Random motion of every band at the first samples of the grid, with unit mean square per joint.

        A sample depends on the two seeds and its index alone, not on `count`.
        """
        white = np.random.default_rng(seeds).standard_normal((count + 2 * BAND_REACH, 3 * NUM_JOINTS))
        bands = band_motion(white) / np.linalg.norm(band_filters(), axis=1)[:, None, None]
        mixed = bands @ np.swapaxes(self.mixing, 1, 2)
        return np.asarray(mixed.reshape(*mixed.shape[:2], NUM_JOINTS, 3))


def fit_detail(
    captures: Sequence[Float[np.ndarray, "_frames joints 3"]], on_capture: Callable[[], None] = lambda: None
) -> Detail:
    """Fit detail on captures at 120 fps, of the 22 joints, in metres, y up; `on_capture` is called twice for each.

    Captures differ in their overall jitter, whatever the body does. So the regression is on deviations from each
    capture's mean, and sampled detail has the mean level of all captures. Raises `ValueError` without captures.
    """
    if not captures:
        raise ValueError("detail is learnt from one capture at least")
    features, log_powers = [], []
    for capture in captures:
        positions = with_ends(capture)
        power = band_power(positions).reshape(len(capture), -1) + np.repeat(floors(), NUM_JOINTS)
        features.append(slow_motion(positions).features.astype(np.float32))
        log_powers.append(np.log(power).astype(np.float32))
        on_capture()
    frames = np.array([len(capture) for capture in captures], dtype=np.float64)
    share = frames / frames.sum()
    means = np.array([each.mean(axis=0, dtype=np.float64) for each in features])
    squares = np.array([np.square(each, dtype=np.float64).mean(axis=0) for each in features])
    centre = share @ means
    scale = 1.0 / np.sqrt(np.maximum(share @ squares - np.square(centre), 1e-6))
    square, product = np.zeros((NUM_FEATURES, NUM_FEATURES)), np.zeros((NUM_FEATURES, NUM_BANDS * NUM_JOINTS))
    for each, log_power in zip(features, log_powers, strict=True):
        state = (each - centre) * scale
        state -= state.mean(axis=0)
        square += state.T @ state
        product += state.T @ (log_power - log_power.mean(axis=0))
    weights = np.linalg.solve(square + RIDGE * frames.sum() * np.eye(NUM_FEATURES), product)
    states = ((each - centre) * scale for each in features)
    weights *= EMPHASIS * np.repeat(_body_slopes(states, log_powers, weights), NUM_JOINTS)
    levels = np.array([each.mean(axis=0, dtype=np.float64) for each in log_powers])
    levels -= (means - centre) * scale @ weights
    most = np.quantile(np.concatenate([each[::4] for each in log_powers]), MOST_QUANTILE, axis=0).astype(np.float64)
    unmixed = np.zeros((NUM_BANDS, 3 * NUM_JOINTS, 3 * NUM_JOINTS))
    detail = Detail(centre, scale, weights, share @ levels, most, unmixed)
    covariance = np.zeros_like(unmixed)
    for capture, level in zip(captures, levels, strict=True):
        covariance += _fast_covariance(capture, replace(detail, offset=level))
        on_capture()
    return replace(detail, mixing=_mixing(covariance))


def _body_slopes(
    states: Iterable[Float64[np.ndarray, "_frames features"]],
    log_powers: Sequence[Float32[np.ndarray, "_frames outputs"]],
    weights: Float64[np.ndarray, "features outputs"],
) -> Float64[np.ndarray, "bands"]:
    """How far the log power of the whole body departs from its mean, as a multiple of what joints' predictions give.

    Each joint is predicted well on average, but the strongest joints at a time, which make up most of the power, are
    underestimated.
    """
    products, squares = np.zeros(NUM_BANDS), np.zeros(NUM_BANDS)
    for state, log_power in zip(states, log_powers, strict=True):
        predicted = state @ weights
        predicted += log_power.mean(axis=0) - predicted.mean(axis=0)
        body, of_joints = (
            np.log(np.exp(each.reshape(-1, NUM_BANDS, NUM_JOINTS)).mean(axis=2)) for each in (log_power, predicted)
        )
        of_joints -= of_joints.mean(axis=0)
        products += (of_joints * body).sum(axis=0)
        squares += np.square(of_joints).sum(axis=0)
    return products / np.maximum(squares, 1e-12)


def _fast_covariance(
    capture: Float[np.ndarray, "frames joints 3"], detail: Detail
) -> Float64[np.ndarray, "bands coordinates coordinates"]:
    """The covariance of fast motion in every band, each joint divided by its predicted strength."""
    positions = with_ends(capture)
    slow = slow_motion(positions)
    flat = _inner(positions.reshape(len(positions), -1), MARGIN - BAND_REACH)
    fast = band_motion(flat).reshape(NUM_BANDS, len(capture), NUM_JOINTS, 3)
    strength = np.sqrt(detail.power(slow) + floors()[:, None])
    relative = to_body(fast, slow.facing) / np.moveaxis(strength, 1, 0)[..., None]
    relative = np.clip(relative, -LARGEST_DEVIATION, LARGEST_DEVIATION).reshape(NUM_BANDS, len(capture), -1)
    return np.asarray(np.swapaxes(relative, 1, 2) @ relative)


def _mixing(
    covariance: Float64[np.ndarray, "bands coordinates coordinates"],
) -> Float64[np.ndarray, "bands coordinates coordinates"]:
    """Cholesky factors of the covariances, scaled so that each joint's squares add up to 1."""
    joints = np.diagonal(covariance, axis1=1, axis2=2).reshape(NUM_BANDS, NUM_JOINTS, 3).sum(axis=2)
    size = np.repeat(np.sqrt(np.maximum(joints, 1e-12)), 3, axis=1)
    correlation = covariance / (size[:, :, None] * size[:, None, :])
    return np.asarray(np.linalg.cholesky(correlation + 1e-6 * np.eye(correlation.shape[1])))


def displacements(
    field: MotionField, detail: Detail, seeds: tuple[int, int]
) -> Float64[np.ndarray, "instants coordinates"]:
    """Joint displacements in metres at the samples of the grid inside the field's domain, from its start on."""
    count = int(np.floor((field.end_seconds - field.start_seconds) * GRID_FPS + 1e-6)) + 1
    times = field.start_seconds + np.arange(count) / GRID_FPS
    positions = with_ends(field.query(np.minimum(times, field.end_seconds)).joint_positions)
    slow = slow_motion(positions)
    # Power that the motion already has in a band is not added again.
    strength = np.sqrt(np.maximum(detail.power(slow) - band_power(positions), 0.0))
    in_body = np.einsum("tbj,btjx->tjx", strength, detail.noise(seeds, count))
    return to_body(in_body, slow.facing * (1.0, -1.0)).reshape(count, -1)  # and back


@lru_cache(MOTIONS_KEPT)
def _computed(on_grid: Displacements) -> Float64[np.ndarray, "instants coordinates"]:
    """The displacements of the last motions: thousands of detailed fields may be alive at once."""
    return on_grid()


def detailed(field: MotionField, detail: Detail, *, seed: int, number: int = 0) -> DerivedField:
    """A field with added motion above 10 Hz, as strong as in captures of similar motion: motion `number` of a seed.

    The power is predicted from the slow motion around each sample, per joint and band; the signal is random, given
    the seed. It is one function of time for all framerates: a 120 Hz grid, interpolated by windowed sincs. At a
    framerate it is low-passed below half of that with the kernels of `resample_positions`, so 30 fps is 60 fps
    filtered. Without a framerate, and above 120 fps, it is limited to 60 Hz. Bones keep their length. Raises
    `UsageError` for skeletons other than the 22 joints.
    """
    if field.skeleton.joint_names != SMPL22.joint_names:
        raise UsageError(
            f"detail is known for the joints of {SMPL22.name}, the motion has those of {field.skeleton.name!r}"
        )
    return _detailed(field, partial(displacements, field, detail, (seed, number)), None)


def _detailed(field: MotionField, on_grid: Displacements, fps: Fraction | None) -> DerivedField:
    def poses(times: Times) -> Poses:
        added = steps(_computed(on_grid), times - field.start_seconds, fps)
        return displaced(field.query(times), added, field.skeleton)

    is_slow = fps is not None and fps <= 2 * EDGES_HZ[0]
    query = field.query if is_slow else partial(query_in_blocks, poses)
    return DerivedField(field, query, lambda fps: _detailed(at_fps(field, fps), on_grid, fps))


def steps(
    on_grid: Float64[np.ndarray, "instants coordinates"], seconds: Times, fps: Fraction | None
) -> Float64[np.ndarray, "times joints 3"]:
    """Joint displacements in metres, before projection onto bones, at seconds from the grid's start."""
    reach, cutoff = kernel_shape(max(Fraction(1), Fraction(GRID_FPS) / (fps or GRID_FPS)))
    # Nothing is added beyond both ends.
    grid = np.pad(on_grid, ((reach, reach + 1), (0, 0)))
    place = seconds * GRID_FPS
    nearest = np.round(place).astype(np.int64)
    weights = kernel_matrix(nearest + reach, np.round(place - nearest, 9), len(grid), reach, cutoff)
    return np.asarray(weights @ grid).reshape(len(seconds), NUM_JOINTS, 3)


def displaced(poses: Poses, steps: Float64[np.ndarray, "times joints 3"], skeleton: Skeleton) -> Poses:
    """Moves every joint by `steps` (m), as far as its bone from the displaced parent allows."""
    old = np.ascontiguousarray(poses.joint_positions.transpose(1, 0, 2), dtype=np.float64)
    targets = old + steps.transpose(1, 0, 2)
    reached = targets.copy()
    turned: dict[int, Float64[np.ndarray, "times 4"]] = {}
    for joint in range(skeleton.num_joints):
        children = list(skeleton.children(joint))
        if not children:
            continue
        bones, aims = old[children] - old[joint], targets[children] - reached[joint]
        if len(children) > 1:
            turned[joint] = _turn(bones, aims)
            reached[children] = reached[joint] + quaternion_rotate(turned[joint][None], bones)
            continue
        length, aim = (np.linalg.norm(each[0], axis=-1, keepdims=True) for each in (bones, aims))
        reached[children[0]] = reached[joint] + aims[0] * (length / np.maximum(aim, _NO_LENGTH))
        if poses.local_rotations is not None:
            turned[joint] = quaternion_between(bones[0], aims[0])
    rotations, translation = poses.local_rotations, poses.root_translation
    if rotations is not None:
        rotations = turned_rotations(rotations, turned, skeleton)
    if translation is not None:
        translation = translation + steps[:, 0].astype(np.float32)
    return Poses(reached.transpose(1, 0, 2).astype(np.float32), rotations, translation)


def _turn(
    bones: Float64[np.ndarray, "bones times 3"], aims: Float64[np.ndarray, "bones times 3"]
) -> Float64[np.ndarray, "times 4"]:
    """The small rotation that best aligns bones with their targets: least squares, linear in the angle."""
    squares = np.einsum("bti,bti->t", bones, bones)
    spread = (squares * (1.0 + 1e-9) + _NO_LENGTH)[:, None, None] * np.eye(3) - np.einsum("bti,btj->tij", bones, bones)
    torque = np.cross(bones, aims).sum(axis=0)
    return rotation_vector_to_quaternion(np.linalg.solve(spread, torque[..., None])[..., 0])
