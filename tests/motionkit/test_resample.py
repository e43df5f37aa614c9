from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from motionkit import kinematics, resample
from motionkit.motion import Caption, Motion
from motionkit.motionfield import to_motion
from motionkit.skeleton import SMPL22
from motionkit.timegrid import TimeGrid

MakeField = Callable[[Motion], resample.FrameField]
FIELDS: list[MakeField] = [resample.linear_field, resample.slerp_field, resample.cubic_field]
NTSC = Fraction(30000, 1001)


def random_motion(seed: int, num_frames: int = 20, fps: Fraction = Fraction(30), rotations: bool = True) -> Motion:
    """Joints that turn by up to half a radian a frame about fixed axes, along a random path."""
    rng = np.random.default_rng(seed)
    turns = rng.uniform(-0.5, 0.5, (1, 22, 3)) * np.arange(num_frames)[:, None, None] + rng.normal(size=(1, 22, 3))
    local = Rotation.from_rotvec(turns.reshape(-1, 3)).as_quat(scalar_first=True).reshape(num_frames, 22, 4)
    local = (local * rng.choice([-1, 1], (num_frames, 22, 1))).astype(np.float32)
    root = np.cumsum(rng.normal(scale=0.02, size=(num_frames, 3)), axis=0).astype(np.float32)
    return Motion(
        joint_positions=kinematics.forward_kinematics(local, root, SMPL22),
        skeleton=SMPL22,
        timegrid=TimeGrid(fps, num_frames, start_seconds=1.25),
        local_rotations=local if rotations else None,
        root_translation=root if rotations else None,
        captions=(Caption("a person turns"),),
        sequence_id="turn",
    )


@pytest.mark.parametrize("make_field", FIELDS)
@pytest.mark.parametrize("rotations", [True, False])
def test_given_frames_are_exact(make_field: MakeField, rotations: bool) -> None:
    motion = random_motion(0, fps=NTSC, rotations=rotations)
    poses = make_field(motion).query(motion.timegrid.seconds())
    assert np.abs(poses.joint_positions - motion.joint_positions).max() < 1e-6


@pytest.mark.parametrize("make_field", FIELDS)
def test_the_order_of_a_query_does_not_matter(make_field: MakeField) -> None:
    field = make_field(random_motion(1))
    rng = np.random.default_rng(0)
    times = rng.uniform(field.start_seconds, field.end_seconds, 101)
    order = rng.permutation(101)
    straight, shuffled = field.query(times), field.query(times[order])
    assert np.allclose(straight.joint_positions[order], shuffled.joint_positions, atol=1e-6, rtol=0)
    one_by_one = np.concatenate([field.query(times[[k]]).joint_positions for k in range(5)])
    assert np.allclose(one_by_one, straight.joint_positions[:5], atol=1e-6, rtol=0)


@pytest.mark.parametrize("make_field", FIELDS)
def test_half_the_framerate_is_every_second_pose(make_field: MakeField) -> None:
    field = make_field(random_motion(2, fps=Fraction(25)))
    at_30, at_60 = (to_motion(field, Fraction(fps)).joint_positions for fps in (30, 60))
    assert np.array_equal(at_30, at_60[::2][: len(at_30)])


@pytest.mark.parametrize("make_field", FIELDS)
def test_the_domain_is_the_observed_span(make_field: MakeField) -> None:
    field = make_field(random_motion(3, num_frames=4))
    assert field.end_seconds - field.start_seconds == pytest.approx(0.1)
    with pytest.raises(ValueError, match=r"1 of 2 times lie outside the motion, the first at 1\.36"):
        field.query(np.array([1.3, 1.36]))


@pytest.mark.parametrize("make_field", FIELDS)
@pytest.mark.parametrize("num_frames", [1, 2, 3])
def test_very_short_motions(make_field: MakeField, num_frames: int) -> None:
    motion = random_motion(4, num_frames=num_frames)
    sampled = to_motion(make_field(motion), Fraction(90))
    assert sampled.num_frames == 3 * (num_frames - 1) + 1
    assert np.allclose(sampled.joint_positions[::3], motion.joint_positions, atol=1e-6)


def test_slerp_agrees_with_scipy() -> None:
    motion = random_motion(5)
    field = resample.slerp_field(motion)
    times = np.random.default_rng(1).uniform(field.start_seconds, field.end_seconds, 50)
    poses = field.query(times)
    assert motion.local_rotations is not None and poses.local_rotations is not None
    expected = np.empty((50, 22, 4), np.float32)
    for joint in range(22):
        rotations = Rotation.from_quat(motion.local_rotations[:, joint].astype(np.float64), scalar_first=True)
        reference = Slerp(motion.timegrid.seconds(), rotations)(times)
        expected[:, joint] = reference.as_quat(scalar_first=True)
        found = Rotation.from_quat(poses.local_rotations[:, joint].astype(np.float64), scalar_first=True)
        assert (found.inv() * reference).magnitude().max() < 1e-6
    assert motion.root_translation is not None and poses.root_translation is not None
    root = [np.interp(times, motion.timegrid.seconds(), motion.root_translation[:, axis]) for axis in range(3)]
    assert np.allclose(poses.root_translation, np.stack(root, -1), atol=1e-6)
    positions = kinematics.forward_kinematics(expected, poses.root_translation, SMPL22)
    assert np.allclose(poses.joint_positions, positions, atol=1e-5)


def test_slerp_keeps_bone_lengths_and_linear_does_not() -> None:
    motion = random_motion(6, rotations=False)
    times = motion.timegrid.seconds()[:-1] + 0.5 * motion.timegrid.seconds_between_frames
    parents, rest = list(SMPL22.parents[1:]), np.linalg.norm(SMPL22.offsets[1:], axis=-1)

    def error(make_field: MakeField) -> float:
        positions = make_field(motion).query(times).joint_positions
        return float(np.abs(np.linalg.norm(positions[:, 1:] - positions[:, parents], axis=-1) - rest).max())

    assert error(resample.slerp_field) < 1e-3 < 5e-3 < error(resample.linear_field)


def test_quaternions_never_jump() -> None:
    q = random_motion(7, num_frames=200).local_rotations
    assert q is not None
    smooth = resample.continuous_quaternions(q)
    assert np.all(np.sum(smooth[1:] * smooth[:-1], axis=-1) >= 0)
    assert np.allclose(np.abs(np.sum(smooth * q, axis=-1)), 1.0, atol=1e-5)


def test_a_cubic_motion_is_restored_by_the_cubic_field() -> None:
    seconds = np.arange(12) / 10
    coefficients = np.random.default_rng(8).normal(size=(4, 22, 3))
    polynomial = lambda t: np.einsum("tk,kjc->tjc", t[:, None] ** np.arange(4), coefficients).astype(np.float32)  # noqa: E731
    motion = Motion(polynomial(seconds), SMPL22, TimeGrid(Fraction(10), 12))
    times = np.linspace(0, 1.1, 40)
    assert np.allclose(resample.cubic_field(motion).query(times).joint_positions, polynomial(times), atol=1e-5)


@pytest.mark.parametrize("method", ["linear", "slerp", "cubic"])
def test_upsampling_keeps_frames_captions_and_logs(method: resample.Method) -> None:
    motion = random_motion(9)
    faster = resample.upsample(motion, Fraction(120), method)
    assert faster.fps == 120 and faster.num_frames == 4 * 19 + 1 and faster.timegrid.start_seconds == 1.25
    assert np.allclose(faster.joint_positions[::4], motion.joint_positions, atol=1e-6)
    assert faster.captions == motion.captions and faster.sequence_id == "turn"
    assert faster.provenance.operations == (f"upsample 30 -> 120 fps ({method})",)
    with pytest.raises(ValueError, match="use downsample"):
        resample.upsample(motion, Fraction(20), method)


def test_slerp_upsampling_of_bare_positions_is_the_motion_field() -> None:
    motion = random_motion(10, rotations=False)
    positions = resample.slerp_upsample_positions(motion.joint_positions, SMPL22, Fraction(30), Fraction(75))
    assert np.array_equal(positions, resample.upsample(motion, Fraction(75)).joint_positions)


def sinusoid(hertz: float, fps: Fraction, seconds: float, phase: float = 0.3) -> np.ndarray:
    frames = np.arange(int(seconds * fps) + 1)
    wave = np.sin(2 * np.pi * hertz * frames * fps.denominator / fps.numerator + phase)
    return np.broadcast_to(wave[:, None, None], (len(frames), 1, 3)).copy()


RATES = [
    (Fraction(120), Fraction(20)),
    (Fraction(120), Fraction(50)),
    (Fraction(60), NTSC),
    (Fraction(100), Fraction(40)),
]


@pytest.mark.parametrize(("fps_from", "fps_to"), RATES)
@pytest.mark.parametrize("part", [0.05, 0.3, 0.6, 0.8])
def test_the_passband_is_flat_and_without_delay(fps_from: Fraction, fps_to: Fraction, part: float) -> None:
    hertz = part * float(fps_to) / 2
    result = resample.resample_positions(sinusoid(hertz, fps_from, 10), fps_from, fps_to)
    expected = sinusoid(hertz, fps_to, 10)[: len(result)]
    middle = slice(len(result) // 4, -len(result) // 4)
    assert np.abs(result - expected)[middle].max() < 3e-4


@pytest.mark.parametrize(("fps_from", "fps_to"), RATES)
@pytest.mark.parametrize("part", [1.001, 1.2, 1.9])
def test_nothing_above_the_new_nyquist_frequency_folds_back(fps_from: Fraction, fps_to: Fraction, part: float) -> None:
    hertz = part * float(fps_to) / 2
    result = resample.resample_positions(sinusoid(hertz, fps_from, 10), fps_from, fps_to)
    assert np.abs(result[len(result) // 4 : -len(result) // 4]).max() < 3e-4


def test_upwards_is_band_limited_and_keeps_given_frames() -> None:
    slow = sinusoid(7.0, Fraction(20), 6)
    fast = resample.resample_positions(slow, Fraction(20), Fraction(60))
    assert np.allclose(fast[::3], slow, atol=1e-12)
    expected = sinusoid(7.0, Fraction(60), 6)
    assert np.abs(fast - expected)[90:-90].max() < 3e-4


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 60), st.fractions(5, 120, max_denominator=1001), st.fractions(5, 120, max_denominator=1001))
def test_constants_and_ends_survive_any_pair_of_rates(frames: int, fps_from: Fraction, fps_to: Fraction) -> None:
    still = np.full((frames, 2, 3), 3.5)
    result = resample.resample_positions(still, fps_from, fps_to)
    assert np.allclose(result, 3.5, atol=1e-12)
    grid = TimeGrid(fps_to, len(result))
    assert grid.span_seconds <= (frames - 1) / fps_from + 1e-6 < float(len(result) / fps_to) + 2e-6
    walk = np.cumsum(np.ones((frames, 1, 3)), axis=0)
    assert np.allclose(resample.resample_positions(walk, fps_from, fps_to)[0], 1.0, atol=1e-9)


def test_equal_rates_give_an_equal_copy() -> None:
    positions = random_motion(11).joint_positions
    same = resample.resample_positions(positions, NTSC, NTSC)
    assert np.array_equal(same, positions) and same is not positions


def test_downsampling_filters_rotations_and_positions_together() -> None:
    motion = random_motion(12, num_frames=240, fps=Fraction(120))
    shaken = motion.local_rotations
    assert shaken is not None
    slow = resample.downsample(motion, Fraction(60))
    assert slow.fps == 60 and slow.num_frames == 120
    assert slow.local_rotations is not None and slow.root_translation is not None
    assert np.allclose(np.linalg.norm(slow.local_rotations, axis=-1), 1.0, atol=1e-6)
    again = kinematics.forward_kinematics(slow.local_rotations, slow.root_translation, SMPL22)
    assert np.allclose(again, slow.joint_positions, atol=2e-4)
    with pytest.raises(ValueError, match="use upsample"):
        resample.downsample(motion, Fraction(240))


def test_resample_goes_both_ways() -> None:
    motion = random_motion(13)
    assert resample.resample(motion, Fraction(30)) is motion
    assert resample.resample(motion, Fraction(15)).provenance.operations == ("downsample 30 -> 15 fps (low-pass)",)
    assert resample.resample(motion, Fraction(60)).num_frames == 39
