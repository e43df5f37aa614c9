"""Rotations, forward and inverse kinematics beside scipy, and mirror images."""

from dataclasses import replace
from fractions import Fraction
from typing import Literal

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import motionkit as mk
from motionkit.core import kinematics
from motionkit.core.kinematics import forward_kinematics
from motionkit.core.motion import mirror
from tests.helpers.bones import check_rotations


def random_quaternions(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return Rotation.random(int(np.prod(shape)), rng).as_quat(scalar_first=True).reshape(*shape, 4)


def test_quaternion_algebra_agrees_with_scipy() -> None:
    rng = np.random.default_rng(0)
    a, b = random_quaternions(rng, 50), random_quaternions(rng, 50)
    v = rng.normal(size=(50, 3))
    ra, rb = (Rotation.from_quat(q, scalar_first=True) for q in (a, b))
    assert np.allclose(kinematics.quaternion_to_matrix(kinematics.quaternion_multiply(a, b)), (ra * rb).as_matrix())
    assert np.allclose(kinematics.quaternion_rotate(a, v), ra.apply(v))
    assert np.allclose(kinematics.quaternion_to_matrix(kinematics.matrix_to_quaternion(ra.as_matrix())), ra.as_matrix())


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-12), (np.float32, 1e-5)])
def test_rotation_vectors_agree_with_scipy_and_come_back(dtype: type, tolerance: float) -> None:
    vectors = np.random.default_rng(8).uniform(-1.8, 1.8, (50, 3)).astype(dtype)
    vectors[0] = 0.0
    vectors[1] *= 1e-8
    turns = kinematics.rotation_vector_to_quaternion(vectors)
    again = kinematics.quaternion_to_rotation_vector(turns)
    assert turns.dtype == again.dtype == dtype and turns[0].tolist() == [1, 0, 0, 0]
    assert np.allclose(again, vectors, atol=tolerance)
    expected = Rotation.from_rotvec(vectors).as_matrix()
    assert np.allclose(kinematics.quaternion_to_matrix(turns), expected, atol=tolerance)


def test_the_shortest_rotation_between_directions() -> None:
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(100, 3)), rng.normal(size=(100, 3))
    b[0] = -a[0]
    turned = kinematics.quaternion_rotate(kinematics.quaternion_between(a, b), a)
    cosine = np.sum(turned * b, -1) / np.linalg.norm(a, axis=-1) / np.linalg.norm(b, axis=-1)
    assert np.allclose(cosine, 1.0)


@pytest.mark.parametrize("skeleton", [mk.SMPL22, mk.KIT21])
def test_inverse_then_forward_kinematics_restores_chains(skeleton: mk.Skeleton) -> None:
    rng = np.random.default_rng(3)
    rotations = random_quaternions(rng, 12, skeleton.num_joints).astype(np.float32)
    root = rng.normal(size=(12, 3)).astype(np.float32)
    positions = kinematics.forward_kinematics(rotations, root, skeleton)
    recovered = kinematics.inverse_kinematics(positions, skeleton)
    assert np.allclose(kinematics.forward_kinematics(recovered, root, skeleton), positions, atol=2e-5)


def test_along_time_no_bone_turns_about_itself() -> None:
    rng = np.random.default_rng(6)
    steps = Rotation.from_rotvec(rng.normal(scale=0.4, size=(40, 22, 3)).cumsum(axis=0).reshape(-1, 3))
    rotations = steps.as_quat(scalar_first=True).reshape(40, 22, 4).astype(np.float32)
    root = np.zeros((40, 3), np.float32)
    positions = kinematics.forward_kinematics(rotations, root, mk.SMPL22)
    local = kinematics.inverse_kinematics_in_time(positions, mk.SMPL22)
    assert np.allclose(kinematics.forward_kinematics(local, root, mk.SMPL22), positions, atol=2e-5)
    chosen = [joint for joint in range(22) if len(mk.SMPL22.children(joint)) == 1]
    assert len(chosen) > 10

    def twist(local: np.ndarray) -> float:
        """How much farther joints turn from frame to frame than their bones' directions do, radians."""
        found = local.astype(np.float64)[:, chosen]
        rest = np.stack([mk.SMPL22.offsets[mk.SMPL22.children(joint)[0]] for joint in chosen]).astype(np.float64)
        bones = kinematics.quaternion_rotate(found, rest / np.linalg.norm(rest, axis=-1, keepdims=True))
        swing = np.arccos(np.clip(np.sum(bones[1:] * bones[:-1], axis=-1), -1, 1))
        turns = kinematics.quaternion_multiply(kinematics.quaternion_conjugate(found[:-1]), found[1:])
        return float((np.linalg.norm(kinematics.quaternion_to_rotation_vector(turns), axis=-1) - swing).max())

    assert twist(local) < 1e-3 < 1.0 < twist(kinematics.inverse_kinematics(positions, mk.SMPL22))


def test_forward_kinematics_with_offsets_that_move_agrees_with_the_plain_recursion() -> None:
    rng = np.random.default_rng(5)
    rotations = random_quaternions(rng, 6, mk.SMPL22.num_joints)
    offsets = rng.normal(size=(6, mk.SMPL22.num_joints, 3))
    root = rng.normal(size=(6, 3))
    expected, turns = np.empty_like(offsets), []
    for joint, parent in enumerate(mk.SMPL22.parents):
        local = Rotation.from_quat(rotations[:, joint], scalar_first=True)
        turns.append(local if parent < 0 else turns[parent] * local)
        expected[:, joint] = root if parent < 0 else expected[:, parent] + turns[parent].apply(offsets[:, joint])
    positions = kinematics.forward_kinematics(rotations, root, mk.SMPL22, offsets)
    assert np.allclose(positions, expected)
    matrices = kinematics.quaternion_to_matrix(rotations)
    assert np.allclose(kinematics.forward_kinematics_matrices(matrices, root, mk.SMPL22, offsets), expected)


@pytest.mark.parametrize("order", ["XYZ", "ZYX", "YXZ", "ZX", "Y", "XYX"])
@pytest.mark.parametrize("kind", ["intrinsic", "extrinsic"])
def test_euler_orders_agree_with_scipy(order: str, kind: Literal["intrinsic", "extrinsic"]) -> None:
    angles = np.random.default_rng(6).uniform(-4, 4, size=(3, 5, len(order)))
    q = kinematics.euler_to_quaternion(angles, order, kind=kind)
    written = order if kind == "intrinsic" else order.lower()
    expected = Rotation.from_euler(written, angles.reshape(-1, len(order))).as_matrix().reshape(3, 5, 3, 3)
    assert np.allclose(kinematics.quaternion_to_matrix(q), expected)


def test_quaternions_never_jump() -> None:
    q = np.random.default_rng(7).normal(size=(200, 22, 4))
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    smooth = kinematics.continuous_quaternions(q)
    assert np.all(np.sum(smooth[1:] * smooth[:-1], axis=-1) >= 0)
    assert np.allclose(np.abs(np.sum(smooth * q, axis=-1)), 1.0)


@pytest.mark.parametrize("bones", [2, 3, 5])
@pytest.mark.parametrize("spread", [1.0, 0.1, 1e-3, 1e-6, 0.0])
@pytest.mark.parametrize("noise", [0.0, 0.05, 3.0])
def test_fitted_rotations_are_those_of_the_singular_value_decomposition(bones, spread, noise):
    """Bones in space down to a line, where rotations about it are equally good, with errors up to a mirror image."""
    rng = np.random.default_rng(8)
    rest = rng.normal(size=(bones, 3)) * (1.0, spread, spread)
    turns = Rotation.random(200, rng)
    observed = np.stack([turns.apply(bone) for bone in rest], axis=1)
    observed += noise * rng.normal(size=observed.shape) * (1.0, spread, spread)
    found = kinematics.quaternion_to_matrix(kinematics.fit_rotation(rest, observed))
    covariance = np.einsum("nbi,bj->nij", observed, rest)
    u, sizes, vt = np.linalg.svd(covariance)
    sign = np.linalg.det(u @ vt)
    expected = np.einsum("nij,nj,njk->nik", u, np.stack((sign**0, sign**0, sign), axis=-1), vt)
    best, reached = (np.einsum("nij,nij->n", each, covariance) for each in (expected, found))
    assert np.allclose(reached, best, rtol=1e-12, atol=0.0)
    # Rounding errors grow where a rotation is hardly determined.
    gap = (sizes[:, 1] + sign * sizes[:, 2]) / sizes[:, 0]
    clear = gap > 1e-9
    assert np.all(np.abs(found - expected).max(axis=(1, 2))[clear] < 1e-13 / gap[clear])


def random_motion(skeleton: mk.Skeleton, num_frames: int = 5) -> mk.Motion:
    rng = np.random.default_rng(0)
    rotations = rng.normal(size=(num_frames, skeleton.num_joints, 4)).astype(np.float32)
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    root = rng.normal(size=(num_frames, 3)).astype(np.float32)
    positions = forward_kinematics(rotations, root, skeleton)
    return mk.Motion(positions, skeleton, mk.TimeGrid(Fraction(60), num_frames), rotations, root)


def test_left_and_right_change_places():
    motion = random_motion(mk.SMPL22)
    mirrored = mirror(motion)
    left, right = mk.SMPL22.index("left_wrist"), mk.SMPL22.index("right_wrist")
    x, y, z = np.moveaxis(motion.joint_positions[:, right], -1, 0)
    assert np.array_equal(mirrored.joint_positions[:, left], np.stack((-x, y, z), axis=-1))
    assert np.array_equal(mirrored.joint_positions[:, 0], motion.joint_positions[:, 0] * np.float32([-1, 1, 1]))


def test_mirrored_rotations_give_the_mirrored_positions_on_an_asymmetric_body():
    offsets = mk.SMPL22.offsets + np.random.default_rng(1).normal(scale=0.05, size=(22, 3)).astype(np.float32)
    skeleton = replace(mk.SMPL22, offsets=offsets, end_sites=((20, (0.1, 0.0, 0.02)),))
    mirrored = mirror(random_motion(skeleton))
    check_rotations(mirrored, 2e-6)
    assert mirrored.skeleton.end_sites == ((21, (-0.1, 0.0, 0.02)),)


@pytest.mark.parametrize("pairs", [(), ((4, 2),)])
def test_skeletons_that_cannot_be_mirrored(pairs):
    with pytest.raises(ValueError, match="joints"):
        mirror(random_motion(replace(mk.SMPL22, left_right_pairs=pairs)))
