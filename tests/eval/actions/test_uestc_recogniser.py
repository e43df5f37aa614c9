"""UESTC's ST-GCN against loops over joints, frames and kernel taps, with random weights."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from eval.actions.recogniser import ActionRecogniser
from eval.actions.uestc import StgcnNetwork, load_uestc, rotation_rows, spatial_graph
from eval.sets.sets import Ragged, SampleSet
from motionkit.core.errors import MotionkitError
from motionkit.io.smpl_body import SMPL
from motionkit.training.loop import CheckpointError

Weights = dict[str, np.ndarray]


def random_weights(path: Path) -> Weights:
    """Write a state dict as ACTOR publishes it, numbers of a size that neither vanish nor explode in ten blocks."""
    generator = torch.Generator().manual_seed(3)
    tensors = StgcnNetwork(SMPL.parents, 6, 40).state_dict()
    for name, tensor in tensors.items():
        if name == "A" or not tensor.is_floating_point():
            continue
        noise = torch.randn(tensor.shape, generator=generator)
        fan_in = max(1, tensor[0].numel()) if tensor.dim() > 1 else 1
        tensor.copy_(noise.abs() + 0.5 if name.endswith("running_var") else noise / fan_in**0.5)
        if "edge_importance" in name:
            tensor.copy_(noise)
    torch.save(tensors, path)
    return {name: tensor.double().numpy() for name, tensor in tensors.items()}


def normalised(x: np.ndarray, weights: Weights, name: str) -> np.ndarray:
    """Batch normalisation in evaluation mode, channels first."""
    shape = (-1, *[1] * (x.ndim - 1))
    mean, variance, gain, shift = (
        weights[f"{name}.{key}"].reshape(shape) for key in ("running_mean", "running_var", "weight", "bias")
    )
    return (x - mean) / np.sqrt(variance + 1e-5) * gain + shift


def graph_by_hand(parents: tuple[int, ...]) -> np.ndarray:
    """Who gives to whom: each joint itself, its neighbours by whether the root is nearer to them."""
    neighbours = {j: {j} | {c for c, p in enumerate(parents) if p == j} for j in range(len(parents))}
    for child, parent in enumerate(parents):
        if parent >= 0:
            neighbours[child].add(parent)
    # Known up to one bone only: 0 the root, 1 its children, else "far".
    far = {j: 0 if j == 0 else 1 if parents[j] == 0 else 9 for j in neighbours}
    graph = np.zeros((3, len(parents), len(parents)))
    for giver in neighbours:
        for taker in neighbours[giver]:
            part = 0 if giver == taker else 2 if far[giver] < far[taker] else 1
            graph[part, giver, taker] = 1 / len(neighbours[taker])
    return graph


def network_by_hand(poses: np.ndarray, weights: Weights, parents: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Features and scores of one clip [frames, joints, 6]."""
    frames, joints, channels = poses.shape
    x = normalised(poses.reshape(frames, -1).T.astype(np.float64), weights, "data_bn")
    x = x.reshape(joints, channels, frames).transpose(1, 2, 0)
    graph = graph_by_hand(parents)
    for place in range(10):
        at = f"st_gcn_networks.{place}"
        edges = graph * weights[f"edge_importance.{place}"]
        kernel, bias = weights[f"{at}.gcn.conv.weight"][:, :, 0, 0], weights[f"{at}.gcn.conv.bias"]
        mixed = np.tensordot(kernel, x, 1) + bias[:, None, None]
        width = len(mixed) // 3
        y = np.zeros((width, x.shape[1], joints))
        for part in range(3):
            for giver in range(joints):
                for taker in range(joints):
                    if edges[part, giver, taker]:
                        y[:, :, taker] += edges[part, giver, taker] * mixed[part * width : (part + 1) * width, :, giver]
        y = np.maximum(normalised(y, weights, f"{at}.tcn.0"), 0)
        stride = 2 if place in (4, 7) else 1
        taps, bias = weights[f"{at}.tcn.2.weight"][..., 0], weights[f"{at}.tcn.2.bias"]
        padded = np.pad(y, ((0, 0), (4, 4), (0, 0)))
        times = range(0, x.shape[1], stride)
        z = np.stack([sum(taps[:, :, k] @ padded[:, t + k] for k in range(9)) for t in times], axis=1)
        z = normalised(z + bias[:, None, None], weights, f"{at}.tcn.3")
        if place in (4, 7):
            past = np.tensordot(weights[f"{at}.residual.0.weight"][:, :, 0, 0], x[:, ::2], 1)
            z = z + normalised(past + weights[f"{at}.residual.0.bias"][:, None, None], weights, f"{at}.residual.1")
        elif place:
            z = z + x
        x = np.maximum(z, 0)
    features = x.mean(axis=(1, 2))
    return features, weights["fcn.weight"][:, :, 0, 0] @ features + weights["fcn.bias"]


def turning(num_frames: int, joints: int = 24, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=(1, joints, 3)) + 0.05 * rng.normal(size=(num_frames, joints, 3)).cumsum(axis=0)
    return np.roll(Rotation.from_rotvec(vectors.reshape(-1, 3)).as_quat(), 1, axis=1).reshape(-1, joints, 4)


def samples_of(*rotations: np.ndarray, fps: int = 30) -> SampleSet:
    lengths = np.array([len(each) for each in rotations])
    positions = np.zeros((int(lengths.sum()), 22, 3), np.float32)
    together = np.concatenate(rotations).astype(np.float32)
    ids = tuple(str(i) for i in range(len(rotations)))
    return SampleSet("some", Fraction(fps), Ragged.laid_out(positions, lengths), ids, local_rotations=together)


def test_the_graph_is_the_bodys() -> None:
    np.testing.assert_allclose(spatial_graph(SMPL.parents), graph_by_hand(SMPL.parents), atol=1e-7)
    np.testing.assert_allclose(spatial_graph(SMPL.parents).sum(axis=(0, 1)), 1.0, atol=1e-6)


def test_features_and_scores_are_those_of_loops(tmp_path: Path) -> None:
    weights = random_weights(tmp_path / "uestc.tar")
    recogniser = load_uestc(tmp_path / "uestc.tar")
    assert isinstance(recogniser, ActionRecogniser) and len(recogniser.actions) == 40
    long, short = turning(75, seed=1), turning(41, seed=2)
    found = recogniser.recognise(samples_of(long, short))
    padded = np.concatenate((short, np.repeat(short[-1:], 19, axis=0)))
    matrices = Rotation.from_quat(np.roll(padded.reshape(-1, 4), -1, axis=1)).as_matrix().reshape(60, 24, 3, 3)
    matrices[:, 0] = np.diag([1.0, -1.0, -1.0]) @ matrices[:, 0]
    features, scores = network_by_hand(matrices[:, :, :2].reshape(60, 24, 6), weights, SMPL.parents)
    size = np.abs(features).max()
    np.testing.assert_allclose(found.features[1] / size, features / size, atol=1e-5)
    np.testing.assert_allclose(found.scores[1] / size, scores / size, atol=1e-5)
    middle = recogniser.recognise(samples_of(long[7:67]))
    np.testing.assert_allclose(middle.features[0] / size, found.features[0] / size, atol=1e-5)


def test_hands_that_lack_are_straight() -> None:
    rows = rotation_rows(turning(3)[None, :, :22].astype(np.float32))
    np.testing.assert_array_equal(rows[0, :, 22:], np.broadcast_to([1, 0, 0, 0, 1, 0], (3, 2, 6)))


def test_other_motions_and_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "uestc.tar"
    random_weights(path)
    recogniser = load_uestc(path)
    bare = samples_of(turning(60))
    positions_only = SampleSet("plain", bare.fps, bare.sequences, bare.sequence_ids)
    with pytest.raises(MotionkitError, match="plain: positions only, but UESTC's recogniser sees the local rotations"):
        recogniser.recognise(positions_only)
    with pytest.raises(MotionkitError, match="rotations of 21 joints"):
        recogniser.recognise(samples_of(turning(60, joints=21)))
    with pytest.raises(MotionkitError, match="20 fps, but the recogniser 'uestc' was trained at 30 fps"):
        recogniser.recognise(samples_of(turning(60), fps=20))
    tensors = torch.load(path, weights_only=True)
    torch.save(tensors | {"fcn.weight": torch.zeros(12, 256, 1, 1)}, path)
    with pytest.raises(CheckpointError, match=r"fcn.weight is \(12, 256, 1, 1\), expected \(40, 256, 1, 1\)"):
        load_uestc(path)
    torch.save({"model": tensors, "iteration": 1}, path)
    with pytest.raises(CheckpointError, match=r"whose file is a bare state dict .*; this one holds model, iteration"):
        load_uestc(path)
    del tensors["edge_importance.9"]
    torch.save(tensors, path)
    with pytest.raises(CheckpointError, match=r"lacks weights/edge_importance\.9"):
        load_uestc(path)
