"""Pose vectors as InterHuman and MotionStreamer lay them out, made frame by frame from a motion that is known."""

from fractions import Fraction

import numpy as np
from scipy.spatial.transform import Rotation

from motionkit.core.motion import Motion
from motionkit.fields.motion_field import to_motion
from tests.helpers.analytic import analytic_motion


def walk(fps: int = 30, seconds: float = 3.0) -> Motion:
    """A walk in a circle with rotations, of the 22 joints."""
    return to_motion(analytic_motion("circle", seconds), Fraction(fps))


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()


def interhuman_rows(motion: Motion) -> np.ndarray:
    """[T − 1, 262]: positions, steps to the next frame, two columns of 21 rotations, contacts."""
    rows = []
    for now, after, turns in zip(
        motion.joint_positions[:-1], motion.joint_positions[1:], motion.local_rotations[:-1], strict=True
    ):
        sixes = [_matrix(turn)[:2].ravel() for turn in turns[1:]]
        still = np.linalg.norm((after - now)[[7, 10, 8, 11]], axis=1) < 0.03
        rows.append(np.concatenate([now.ravel(), (after - now).ravel(), *sixes, still]))
    return np.array(rows, np.float32)


def motionstreamer_rows(motion: Motion) -> np.ndarray:
    """[T, 272]: the root's step and the turn since the frame before, joints and rotations seen from the heading."""
    ahead = [_matrix(turn)[:, 2] for turn in motion.local_rotations[:, 0]]
    seen_from = [Rotation.from_rotvec([0, -np.arctan2(x, z), 0]) for x, _, z in ahead]
    rows = np.zeros((motion.num_frames, 272))
    places = []
    for frame, (joints, turns) in enumerate(zip(motion.joint_positions, motion.local_rotations, strict=True)):
        level = joints - joints[0] * [1, 0, 1]
        places.append(seen_from[frame].apply(level))
        rows[frame, 8:74] = places[-1].ravel()
        body = [_matrix(turn) for turn in turns]
        body[0] = seen_from[frame].as_matrix() @ body[0]
        rows[frame, 140:] = np.concatenate([matrix[:2].ravel() for matrix in body])
        if frame == 0:
            rows[frame, 2:8] = 1, 0, 0, 0, 1, 0
            continue
        step = seen_from[frame - 1].apply(joints[0] - motion.joint_positions[frame - 1, 0])
        rows[frame, :2] = step[[0, 2]]
        rows[frame, 2:8] = (seen_from[frame] * seen_from[frame - 1].inv()).as_matrix()[:2].ravel()
        rows[frame, 74:140] = (places[-1] - places[-2]).ravel()
    return rows


def hymotion_rows(motion: Motion, rest_pelvis: np.ndarray) -> np.ndarray:
    """[T, 201]: translation, local rotations as interleaved columns, joints from the pelvis."""
    rows = []
    for joints, turns in zip(motion.joint_positions, motion.local_rotations, strict=True):
        sixes = [[_matrix(turn)[row, column] for row in range(3) for column in (0, 1)] for turn in turns]
        rows.append(np.concatenate([joints[0] - rest_pelvis, np.ravel(sixes), (joints - joints[0]).ravel()]))
    return np.array(rows, np.float32)


def dart_rows(motion: Motion, *, vimogen: bool = False) -> np.ndarray:
    """[T − 1, 276], z up: DART's order of the same blocks, or ViMoGen's."""
    up = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    world = motion.joint_positions @ up.T
    rows = []
    for frame in range(motion.num_frames - 1):
        now, after = ([_matrix(turn) for turn in motion.local_rotations[at]] for at in (frame, frame + 1))
        now[0], after[0] = up @ now[0], up @ after[0]
        sixes = np.concatenate([matrix[:2].ravel() for matrix in now])
        turned = (after[0] @ now[0].T)[:2].ravel()
        joints, steps = world[frame].ravel(), (world[frame + 1] - world[frame]).ravel()
        if vimogen:
            blocks = [sixes[6:], joints, steps, sixes[:6], turned, joints[:3], steps[:3]]
        else:
            blocks = [joints[:3], sixes, steps[:3], turned, joints, steps]
        rows.append(np.concatenate(blocks))
    return np.array(rows, np.float32)


def ardy_rows(positions: np.ndarray, world: np.ndarray) -> np.ndarray:
    """[T, 5 + 12·J − 3 + 4] of positions [T, J, 3] and world rotations [T, J, 3, 3]; heading, velocities are zeros."""
    rows = []
    for joints, matrices in zip(positions, world, strict=True):
        level = joints[1:] - joints[0] * [1, 0, 1]
        columns = [np.concatenate([matrix[:, 0], matrix[:, 1]]) for matrix in matrices]
        rows.append(np.concatenate([joints[0], [1, 0], level.ravel(), *columns, np.zeros(3 * len(joints) + 4)]))
    return np.array(rows, np.float32)


def flowmdm_rows(translation: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """[T, 135] of translations [T, 3], z up, and local quaternions [T, 22, 4]: height, steps, two rows a rotation."""
    rows = []
    for frame, place in enumerate(translation):
        step = (place - translation[frame - 1])[:2] if frame else [0.0, 0.0]
        rows.append([place[2], *step, *np.ravel([_matrix(turn)[:2] for turn in turns[frame]])])
    return np.array(rows, np.float32)
