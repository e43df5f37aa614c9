"""Rotations, forward and inverse kinematics, vectorised over frames. Quaternions are (w, x, y, z)."""

from collections.abc import Callable
from functools import lru_cache
from typing import Literal

import numpy as np
import numpy.typing as npt

from motionkit.core.shapes import Bool, Float, Float64
from motionkit.core.skeleton import Skeleton

Array = npt.NDArray[np.floating]
# With these steps the largest root is known to rounding where ζ is larger (10 do for singular values of 1, 0.03 and 0).
_NEWTON_STEPS, _SMALLEST_ZETA = 12, 0.03


def quaternion_multiply(a: Float[np.ndarray, "*n 4"], b: Float[np.ndarray, "*m 4"]) -> Float[np.ndarray, "*k 4"]:
    """Hamilton product a·b: the rotation b followed by a. Shapes broadcast."""
    aw, ax, ay, az = (a[..., component] for component in range(4))
    bw, bx, by, bz = (b[..., component] for component in range(4))
    return np.stack(
        (
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ),
        axis=-1,
    )


def quaternion_conjugate(q: Float[np.ndarray, "*n 4"]) -> Float[np.ndarray, "*n 4"]:
    """The inverse of a unit quaternion."""
    inverse: Array = q * np.array([1.0, -1.0, -1.0, -1.0], dtype=q.dtype)
    return inverse


def quaternion_rotate(q: Float[np.ndarray, "*n 4"], v: Float[np.ndarray, "*m 3"]) -> Float[np.ndarray, "*k 3"]:
    """Rotate vectors by unit quaternions. Shapes broadcast."""
    w, qx, qy, qz = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    tx, ty, tz = 2.0 * (qy * z - qz * y), 2.0 * (qz * x - qx * z), 2.0 * (qx * y - qy * x)
    return np.stack(
        (x + w * tx + (qy * tz - qz * ty), y + w * ty + (qz * tx - qx * tz), z + w * tz + (qx * ty - qy * tx)), axis=-1
    )


def rotate_about_y(vectors: Float[np.ndarray, "*n 3"], angle: Float[np.ndarray, "*m"]) -> Float[np.ndarray, "*k 3"]:
    """Rotate vectors about Y by angles in radians, which turn Z+ towards X+. Shapes broadcast."""
    # Sines of float32 angles differ in their last digit between processors.
    cosine, sine = (part(angle, dtype=np.float64).astype(vectors.dtype) for part in (np.cos, np.sin))
    x, y, z = np.moveaxis(vectors, -1, 0)
    rotated = np.empty((*np.broadcast_shapes(x.shape, cosine.shape), 3), vectors.dtype)
    rotated[..., 0] = cosine * x + sine * z
    rotated[..., 1] = y
    rotated[..., 2] = cosine * z - sine * x
    return rotated


def quaternion_to_matrix(q: Float[np.ndarray, "*n 4"]) -> Float[np.ndarray, "*n 3 3"]:
    """Unit quaternions → rotation matrices."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    matrix = np.empty((*q.shape[:-1], 3, 3), dtype=q.dtype)
    matrix[..., 0, 0] = 1 - 2 * (y * y + z * z)
    matrix[..., 0, 1] = 2 * (x * y - w * z)
    matrix[..., 0, 2] = 2 * (x * z + w * y)
    matrix[..., 1, 0] = 2 * (x * y + w * z)
    matrix[..., 1, 1] = 1 - 2 * (x * x + z * z)
    matrix[..., 1, 2] = 2 * (y * z - w * x)
    matrix[..., 2, 0] = 2 * (x * z - w * y)
    matrix[..., 2, 1] = 2 * (y * z + w * x)
    matrix[..., 2, 2] = 1 - 2 * (x * x + y * y)
    return matrix


def matrix_to_quaternion(matrix: Float[np.ndarray, "*n 3 3"]) -> Float[np.ndarray, "*n 4"]:
    """Rotation matrices → unit quaternions with w ≥ 0."""
    from scipy.spatial.transform import Rotation  # deferred: the import takes a quarter of a second

    q = Rotation.from_matrix(matrix.reshape(-1, 3, 3)).as_quat(canonical=True, scalar_first=True)
    return np.asarray(q, dtype=matrix.dtype).reshape(*matrix.shape[:-2], 4)


def _dot(a: Float[np.ndarray, "*n d"], b: Float[np.ndarray, "*n d"]) -> Float[np.ndarray, "*n 1"]:
    # Four times as fast as a sum over an axis of three or four numbers.
    product: Float[np.ndarray, "*n 1"] = np.einsum("...i,...i->...", a, b)[..., None]
    return product


def quaternion_between(a: Float[np.ndarray, "*n 3"], b: Float[np.ndarray, "*m 3"]) -> Float[np.ndarray, "*k 4"]:
    """The shortest rotation that takes direction a to direction b (no twist). Shapes broadcast; lengths are ignored.

    Opposite directions turn by π about an arbitrary perpendicular axis; zero vectors give the identity.
    """
    a, b = np.broadcast_arrays(a, b)
    lengths = _dot(a, a) ** 0.5 * _dot(b, b) ** 0.5
    q = np.concatenate((lengths + _dot(a, b), np.cross(a, b)), axis=-1)
    norm = _dot(q, q) ** 0.5
    opposite = (norm <= 1e-7 * np.maximum(lengths, 1e-30)) & (lengths > 0)
    if np.any(opposite):
        axis = np.cross(
            a, np.where(np.abs(a[..., :1]) < 0.6 * np.linalg.norm(a, axis=-1, keepdims=True), (1, 0, 0), (0, 1, 0))
        )
        half_turn = np.concatenate((np.zeros_like(axis[..., :1]), axis), axis=-1)
        q = np.where(opposite, half_turn, q)
        norm = _dot(q, q) ** 0.5
    is_zero = norm == 0
    q /= np.where(is_zero, 1, norm)
    q[..., :1] += is_zero
    return q


def quaternion_slerp(
    a: Float[np.ndarray, "*n 4"], b: Float[np.ndarray, "*n 4"], fraction: Float[np.ndarray, "*m"]
) -> Float[np.ndarray, "*n 4"]:
    """Spherical linear interpolation on the shorter arc (Shoemake 1985); `fraction` broadcasts over leading axes."""
    dot = np.sum(a * b, axis=-1, keepdims=True)
    b = np.where(dot < 0, -b, b)
    angle = np.arccos(np.clip(np.abs(dot), 0.0, 1.0))
    sine = np.sin(angle)
    t = fraction[..., None]
    near = sine < 1e-6
    safe = np.where(near, 1.0, sine)
    q = np.where(near, 1 - t, np.sin((1 - t) * angle) / safe) * a + np.where(near, t, np.sin(t * angle) / safe) * b
    unit: Array = (q / np.linalg.norm(q, axis=-1, keepdims=True)).astype(a.dtype, copy=False)
    return unit


def euler_to_quaternion(
    angles: Float[np.ndarray, "*n axes"], order: str, *, kind: Literal["intrinsic", "extrinsic"] = "intrinsic"
) -> Float[np.ndarray, "*n 4"]:
    """Euler angles in radians → unit quaternions, for any order of axes such as "ZYX" (repeats allowed).

    Intrinsic: R = R(order[0])·R(order[1])·…, as BVH lists its channels; extrinsic: the reverse product. The
    product is built one axis at a time: q·(cos, sin·axis) needs eight products, not sixteen.
    """
    axes = order if kind == "intrinsic" else order[::-1]
    columns = range(len(order)) if kind == "intrinsic" else range(len(order) - 1, -1, -1)
    half = np.ascontiguousarray(np.moveaxis(angles, -1, 0)) * angles.dtype.type(0.5)
    sine, cosine = np.sin(half), np.cos(half)
    q = np.zeros((4, *angles.shape[:-1]), dtype=angles.dtype)
    q[0] = 1.0
    for position, (axis, column) in enumerate(zip(axes, columns, strict=True)):
        s, c = sine[column], cosine[column]
        k, i, j = {"X": (1, 2, 3), "Y": (2, 3, 1), "Z": (3, 1, 2)}[axis.upper()]
        if position == 0:
            q[0], q[k] = c, s
            continue
        w, along, first, second = q[0] * c - q[k] * s, q[k] * c + q[0] * s, q[i] * c + q[j] * s, q[j] * c - q[i] * s
        q[0], q[k], q[i], q[j] = w, along, first, second
    return np.moveaxis(q, 0, -1)


def rotation_vector_to_quaternion(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 4"]:
    """Rotation vectors (axis times angle in radians) → unit quaternions of the same dtype; zero is the identity."""
    components = np.ascontiguousarray(np.moveaxis(vectors, -1, 0))
    angle = np.sqrt(np.sum(components * components, axis=0))
    half = 0.5 * angle
    scale = np.where(angle > 1e-6, np.sin(half) / np.maximum(angle, 1e-6), 0.5)
    quaternions = np.empty((*vectors.shape[:-1], 4), vectors.dtype)
    quaternions[..., 0] = np.cos(half)
    for axis, component in enumerate(components, start=1):
        quaternions[..., axis] = component * scale
    return quaternions


def quaternion_to_rotation_vector(q: Float[np.ndarray, "*n 4"]) -> Float[np.ndarray, "*n 3"]:
    """Unit quaternions → rotation vectors (axis times angle in radians, at most π)."""
    from scipy.spatial.transform import Rotation  # see matrix_to_quaternion

    vectors = Rotation.from_quat(q.reshape(-1, 4), scalar_first=True).as_rotvec()
    return np.asarray(vectors, dtype=q.dtype).reshape(*q.shape[:-1], 3)


def continuous_quaternions(q: Float[np.ndarray, "frames joints 4"]) -> Float[np.ndarray, "frames joints 4"]:
    """The same rotations with signs that make consecutive quaternions have a non-negative dot product."""
    odd = np.cumsum(np.sum(q[1:] * q[:-1], axis=-1) < 0, axis=0) % 2 == 1
    result = q.copy()
    result[1:][odd] *= -1
    return result


def forward_kinematics(
    local_rotations: Float[np.ndarray, "frames joints 4"],
    root_translation: Float[np.ndarray, "frames 3"],
    skeleton: Skeleton,
    offsets: Float[np.ndarray, "*frames joints 3"] | None = None,
) -> Float[np.ndarray, "frames joints 3"]:
    """Joint positions in metres from local rotations and the root's position.

    `offsets` replaces the skeleton's, and may differ per frame (sources whose bones have translation channels).
    """
    w, x, y, z = np.ascontiguousarray(local_rotations.transpose(2, 1, 0))
    num_frames, num_joints = local_rotations.shape[:2]
    frames = np.empty((3, 4, num_joints, num_frames), dtype=local_rotations.dtype)
    frames[0, 0], frames[1, 1], frames[2, 2] = 1 - 2 * (y * y + z * z), 1 - 2 * (x * x + z * z), 1 - 2 * (x * x + y * y)
    for row, column, product, scalar in ((0, 1, x * y, w * z), (2, 0, x * z, w * y), (1, 2, y * z, w * x)):
        product *= 2
        scalar *= 2
        np.subtract(product, scalar, out=frames[row, column])
        np.add(product, scalar, out=frames[column, row])
    _propagate(frames, root_translation, skeleton, offsets)
    return np.ascontiguousarray(frames[:, 3].transpose(2, 1, 0))


def forward_kinematics_matrices(
    local_matrices: Float[np.ndarray, "frames joints 3 3"],
    root_translation: Float[np.ndarray, "frames 3"],
    skeleton: Skeleton,
    offsets: Float[np.ndarray, "*frames joints 3"],
) -> Float[np.ndarray, "frames joints 3"]:
    """Joint positions in metres from local rotation matrices, the root's position and the bones' offsets."""
    frames = np.empty((3, 4, *local_matrices.shape[1::-1]), dtype=local_matrices.dtype)
    frames[:, :3] = local_matrices.transpose(2, 3, 1, 0)
    _propagate(frames, root_translation, skeleton, offsets)
    return np.ascontiguousarray(frames[:, 3].transpose(2, 1, 0))


def _propagate(
    frames: Float[np.ndarray, "3 4 joints frames"],
    root_translation: Float[np.ndarray, "frames 3"],
    skeleton: Skeleton,
    offsets: Float[np.ndarray, "*frames joints 3"] | None,
) -> None:
    # Local rotations in the first three columns become global ones, and positions come into the fourth, in place.
    # Frames are the last, contiguous axis and joints of equal depth are multiplied together: a handful of array
    # operations for each level of the tree, however many frames there are.
    bones = skeleton.offsets if offsets is None else offsets
    frames[:, 3] = bones.T if bones.ndim == 3 else bones.T[:, :, None]
    frames[:, 3, 0] = root_translation.T
    for joints, parents in _levels(skeleton.parents):
        above = frames.take(parents, axis=2)
        below = frames.take(joints, axis=2)
        product = above[:, 0, None] * below[None, 0]
        product += above[:, 1, None] * below[None, 1]
        product += above[:, 2, None] * below[None, 2]
        product[:, 3] += above[:, 3]
        frames[:, :, joints] = product


@lru_cache(maxsize=256)
def _levels(parents: tuple[int, ...]) -> list[tuple[list[int], list[int]]]:
    # Joints by depth below the root, with their parents.
    depth = [0]
    for parent in parents[1:]:
        depth.append(depth[parent] + 1)
    levels: list[tuple[list[int], list[int]]] = [([], []) for _ in range(max(depth))]
    for joint, parent in enumerate(parents):
        if parent >= 0:
            levels[depth[joint] - 1][0].append(joint)
            levels[depth[joint] - 1][1].append(parent)
    return levels


def global_rotations(
    local_rotations: Float[np.ndarray, "frames joints 4"], skeleton: Skeleton
) -> Float[np.ndarray, "frames joints 4"]:
    """Rotations relative to the world from rotations relative to the parent."""
    result = np.empty_like(local_rotations)
    result[:, 0] = local_rotations[:, 0]
    for joint, parent in enumerate(skeleton.parents[1:], start=1):
        result[:, joint] = quaternion_multiply(result[:, parent], local_rotations[:, joint])
    return result


def inverse_kinematics(
    joint_positions: Float[np.ndarray, "frames joints 3"], skeleton: Skeleton
) -> Float[np.ndarray, "frames joints 4"]:
    """Local rotations that point the skeleton's rest bones along the observed ones, each frame by itself.

    A joint with one child takes the shortest rotation (its twist is not observable); a joint with several takes the
    least-squares rotation of all its bones; a leaf keeps its parent's. Forward kinematics with the observed bone
    lengths restores the positions of every joint whose parent has one child. Source: Kabsch 1976 for the least squares.
    """
    return _pointed(joint_positions, skeleton, quaternion_between)


def inverse_kinematics_in_time(
    joint_positions: Float[np.ndarray, "frames joints 3"], skeleton: Skeleton
) -> Float[np.ndarray, "frames joints 4"]:
    """`inverse_kinematics` with continuous twist over time, for interpolation.

    The shortest rotation from rest has a pole: near the opposite of the rest direction (an arm overhead) its twist
    spins, and interpolation swings the bone's children by decimetres. Here a joint with one child is rotated from frame
    to frame by the shortest rotation of its bone. Over a long motion the twist drifts from the anatomical one, so the
    result is not for display or export.
    """
    return _pointed(joint_positions, skeleton, _carried_along)


def _pointed(
    joint_positions: Float[np.ndarray, "frames joints 3"],
    skeleton: Skeleton,
    point: Callable[[Float[np.ndarray, "3"], Float[np.ndarray, "frames 3"]], Float[np.ndarray, "frames 4"]],
) -> Float[np.ndarray, "frames joints 4"]:
    positions = joint_positions.astype(np.float64)
    num_frames, num_joints = positions.shape[:2]
    world = np.zeros((num_frames, num_joints, 4))
    local = np.zeros_like(world)
    identity = np.array([1.0, 0.0, 0.0, 0.0])
    rest = skeleton.offsets.astype(np.float64)
    for joint in range(num_joints):
        parent = skeleton.parents[joint]
        above = world[:, parent] if parent >= 0 else np.broadcast_to(identity, (num_frames, 4))
        children = [child for child in skeleton.children(joint) if np.linalg.norm(rest[child]) > 1e-6]
        if not children:
            local[:, joint], world[:, joint] = identity, above
            continue
        bones = quaternion_rotate(quaternion_conjugate(above)[:, None], positions[:, children] - positions[:, [joint]])
        if len(children) == 1:
            local[:, joint] = point(rest[children[0]], bones[:, 0])
        else:
            local[:, joint] = fit_rotation(rest[children], bones)
        world[:, joint] = quaternion_multiply(above, local[:, joint])
    return local.astype(np.float32)


def _carried_along(
    rest: Float[np.ndarray, "3"], observed: Float[np.ndarray, "frames 3"]
) -> Float[np.ndarray, "frames 4"]:
    q = np.concatenate((quaternion_between(rest, observed[:1]), quaternion_between(observed[:-1], observed[1:])))
    reach = 1
    while reach < len(q):  # products of all steps so far, in log₂ frames passes
        q[reach:] = quaternion_multiply(q[reach:], q[:-reach])
        reach *= 2
    # Correct once more to the bone's direction: products drift, and a bone without length has no direction.
    return quaternion_multiply(quaternion_between(quaternion_rotate(q, rest), observed), q)


def fit_rotation(
    rest: Float[np.ndarray, "*frames bones 3"], observed: Float[np.ndarray, "frames bones 3"], inertia: float = 0.0
) -> Float[np.ndarray, "frames 4"]:
    """The least-squares rotation from bones at rest to observed ones (Wahba 1965), float64.

    For collinear bones the twist is free; `inertia`, a share of the bones' lengths, then keeps it at zero.
    """
    covariance = np.einsum("...bi,...bj->...ij", observed, rest, dtype=np.float64)
    if inertia:
        covariance += (inertia * np.sum(rest * rest, axis=(-2, -1)))[..., None, None] * np.eye(3)
    matrix, is_known = _rotations_of(covariance)
    if not is_known.all():
        # Kabsch 1976; among equally good rotations it chooses any.
        u, _, vt = np.linalg.svd(covariance[~is_known])
        u[..., :, 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
        matrix[~is_known] = u @ vt
    return matrix_to_quaternion(matrix)


def _rotations_of(
    covariance: Float64[np.ndarray, "frames 3 3"],
) -> tuple[Float64[np.ndarray, "frames 3 3"], Bool[np.ndarray, "frames"]]:
    """The rotation R with the largest tr(Rᵀ·B) for each B, and whether it is known to rounding.

    λ, the largest root of the quaternion's characteristic polynomial, by Newton's method from above; then R is
    polynomial in λ and B (FOAM, Markley 1993). ζ = (s₁ + s₂)(s₂ + s₃)(s₃ + s₁) of the singular values (s₃ with the
    sign of det B) is near zero where R is hardly determined.
    """
    b = np.moveaxis(covariance, 0, -1)  # frames are the last, contiguous axis
    size = np.sqrt(np.einsum("ijn,ijn->n", b, b))
    b = b / np.where(size > 0, size, 1.0)
    cofactors = np.stack([np.cross(b[row - 2], b[row - 1], axis=0) for row in range(3)])
    determinant = np.einsum("in,in->n", b[0], cofactors[0])
    constant = 1.0 - 4.0 * np.einsum("ijn,ijn->n", cofactors, cofactors)
    root = np.full(len(covariance), np.sqrt(3.0))
    for _ in range(_NEWTON_STEPS):
        square = root * root
        value = square * (square - 2.0) - 8.0 * determinant * root + constant
        root -= value / (4.0 * root * (square - 1.0) - 8.0 * determinant)
    half = 0.5 * (root * root - 1.0)
    zeta = half * root - determinant
    is_known = zeta > _SMALLEST_ZETA
    cube = np.einsum("ijn,kjn,kln->iln", b, b, b, optimize=True)
    matrix = ((half + 1.0) * b + root * cofactors - cube) / np.where(is_known, zeta, 1.0)
    return np.moveaxis(matrix, -1, 0), is_known


def two_columns(quaternions: Float[np.ndarray, "*poses joints 4"]) -> Float[np.ndarray, "*poses numbers"]:
    """The first two columns of each rotation matrix, joint after joint: (R₁₁, R₂₁, R₃₁, R₁₂, R₂₂, R₃₂)."""
    columns = quaternion_to_matrix(quaternions)[..., :2].swapaxes(-1, -2)
    return np.ascontiguousarray(columns).reshape(*quaternions.shape[:-2], 6 * quaternions.shape[-2])


def closest_rotations(columns: Float[np.ndarray, "*poses numbers"]) -> Float64[np.ndarray, "*poses joints 3 3"]:
    """Rotation matrices from pairs of columns by Gram-Schmidt, float64; columns need not be of unit length or square.

    Columns without a direction (no length, or parallel) become any rotation that contains the first one.
    """
    joints = columns.shape[-1] // 6
    pairs = columns.astype(np.float64).reshape(*columns.shape[:-1], joints, 2, 3)
    first = _unit(pairs[..., 0, :], np.array([1.0, 0.0, 0.0]))
    second = pairs[..., 1, :]
    second = second - np.sum(first * second, axis=-1, keepdims=True) * first
    # A fallback perpendicular to the first column, from the axis that it points along least.
    axis = np.eye(3)[np.argmin(np.abs(first), axis=-1)]
    second = _unit(second, axis - np.sum(first * axis, axis=-1, keepdims=True) * first)
    second = _unit(second, second)
    return np.stack((first, second, np.cross(first, second)), axis=-1)


def _unit(vectors: Float64[np.ndarray, "*n 3"], otherwise: Float64[np.ndarray, "*m 3"]) -> Float64[np.ndarray, "*n 3"]:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-8, vectors / np.maximum(length, 1e-8), otherwise)
