"""The published recognisers against loops over units, joints, frames and kernel taps, with random weights; refusals."""

import math
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from eval.actions.published import (
    GruNetwork,
    StgcnNetwork,
    clip_rows,
    humanact12_inputs,
    load_humanact12,
    load_uestc,
    uestc_inputs,
)
from eval.actions.recogniser import ActionRecogniser
from eval.sets.sets import SampleSet, sample_set
from motionkit.core.errors import MotionkitError
from motionkit.io.smpl_body import SMPL
from motionkit.training.loop import CheckpointError

Weights = dict[str, np.ndarray]


def random_gru(path: Path) -> Weights:
    """Write a checkpoint in the published file's (legacy) form and return its numbers."""
    torch.manual_seed(5)
    tensors = {name: 0.15 * torch.randn_like(tensor) for name, tensor in GruNetwork(72, 12).state_dict().items()}
    torch.save({"model": tensors, "iteration": 3}, path, _use_new_zipfile_serialization=False)
    return {name: tensor.double().numpy() for name, tensor in tensors.items()}


def random_stgcn(path: Path) -> Weights:
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


def sigmoid(x: float) -> float:
    return 1.0 / (1.0 + math.exp(-x))


def gru_by_hand(clip: np.ndarray, weights: Weights) -> tuple[np.ndarray, np.ndarray]:
    """Features and scores of one clip of 24 joints, unit by unit (Cho et al. 2014, torch's order of gates: r, z, n)."""
    layer_inputs = list(((clip - clip[0, 0]) * [1.0, -1.0, -1.0]).reshape(len(clip), -1))
    for layer in range(2):
        w, u = weights[f"recurrent.weight_ih_l{layer}"], weights[f"recurrent.weight_hh_l{layer}"]
        b, c = weights[f"recurrent.bias_ih_l{layer}"], weights[f"recurrent.bias_hh_l{layer}"]
        h, states = np.zeros(128), []
        for x in layer_inputs:
            given_x, given_h = w @ x + b, u @ h + c
            new = np.empty(128)
            for i in range(128):
                reset = sigmoid(given_x[i] + given_h[i])
                update = sigmoid(given_x[128 + i] + given_h[128 + i])
                candidate = math.tanh(given_x[256 + i] + reset * given_h[256 + i])
                new[i] = (1 - update) * candidate + update * h[i]
            h = new
            states.append(h)
        layer_inputs = states
    features = np.tanh(weights["linear1.weight"] @ layer_inputs[-1] + weights["linear1.bias"])
    return features, weights["linear2.weight"] @ features + weights["linear2.bias"]


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


def stgcn_by_hand(rotations: np.ndarray, weights: Weights) -> tuple[np.ndarray, np.ndarray]:
    """Features and scores of one clip of quaternions [60, 24, 4]."""
    matrices = Rotation.from_quat(rotations.reshape(-1, 4), scalar_first=True).as_matrix().reshape(60, 24, 3, 3)
    matrices[:, 0] = np.diag([1.0, -1.0, -1.0]) @ matrices[:, 0]
    poses = matrices[:, :, :2].reshape(60, 24, 6)
    frames, joints, channels = poses.shape
    x = normalised(poses.reshape(frames, -1).T.astype(np.float64), weights, "data_bn")
    x = x.reshape(joints, channels, frames).transpose(1, 2, 0)
    graph = graph_by_hand(SMPL.parents)
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


def moving(num_frames: int, joints: int = 24, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    steps = 0.1 * rng.normal(size=(num_frames, joints, 3)).cumsum(axis=0)
    return np.asarray(rng.normal(size=(1, joints, 3)) + steps, dtype=np.float32)


def positions(*lengths: int, joints: int = 24, fps: int = 20) -> SampleSet:
    motions = [moving(length, joints, length) for length in lengths]
    return sample_set("some", Fraction(fps), motions, [str(i) for i in range(len(lengths))])


def rotations(*lengths: int, joints: int = 24, fps: int = 30) -> SampleSet:
    bare = positions(*lengths, fps=fps)
    turns = [0.5 * moving(length, joints, length).reshape(-1, 3) for length in lengths]
    quaternions = [Rotation.from_rotvec(each).as_quat(scalar_first=True).reshape(-1, joints, 4) for each in turns]
    together = np.concatenate(quaternions).astype(np.float32)
    return SampleSet(bare.name, bare.fps, bare.sequences, bare.sequence_ids, local_rotations=together)


CASES = (
    pytest.param(random_gru, load_humanact12, positions, gru_by_hand, id="humanact12"),
    pytest.param(random_stgcn, load_uestc, rotations, stgcn_by_hand, id="uestc"),
)


@pytest.mark.parametrize(("write", "load", "samples_of", "by_hand"), CASES)
def test_features_and_scores_are_those_of_loops_whatever_is_beside_a_motion(
    write: Callable[[Path], Weights],
    load: Callable[[Path], ActionRecogniser],
    samples_of: Callable[..., SampleSet],
    by_hand: Callable[[np.ndarray, Weights], tuple[np.ndarray, np.ndarray]],
    tmp_path: Path,
) -> None:
    weights, recogniser = write(tmp_path / "weights.tar"), load(tmp_path / "weights.tar")
    together = recogniser.recognise(samples_of(75, 41))
    for row, length in enumerate((75, 41)):
        alone = samples_of(length)
        values = alone.sequences.values if alone.local_rotations is None else alone.local_rotations
        clip = values[7:67] if length > 60 else np.concatenate((values, np.repeat(values[-1:], 19, axis=0)))
        expected = by_hand(clip.astype(np.float64), weights)
        for found, again, numbers in zip(together, recogniser.recognise(alone), expected, strict=True):
            np.testing.assert_allclose(found[row] / np.abs(numbers).max(), numbers / np.abs(numbers).max(), atol=1e-4)
            np.testing.assert_allclose(again[0], found[row], atol=1e-4 * np.abs(numbers).max())


def test_hands_that_lack_go_on_along_the_forearm_or_are_straight() -> None:
    bare = positions(70, joints=22)
    found = humanact12_inputs(bare, clip_rows(bare)).reshape(60, 24, 3)
    np.testing.assert_allclose(found[:, 22], found[:, 20] + 0.34 * (found[:, 20] - found[:, 18]), atol=1e-6)
    turned = rotations(70, joints=22)
    straight = uestc_inputs(turned, clip_rows(turned))[0, :, 22:]
    np.testing.assert_array_equal(straight, np.broadcast_to([1, 0, 0, 0, 1, 0], (60, 2, 6)))


def test_other_motions_and_other_files_are_refused(tmp_path: Path) -> None:
    gru, stgcn, other = (tmp_path / name for name in ("gru.tar", "stgcn.tar", "other.tar"))
    random_gru(gru)
    random_stgcn(stgcn)
    for recogniser, samples, reason in (
        (load_humanact12(gru), positions(70, fps=30), "30 fps, but the recogniser 'humanact12' was trained at 20 fps"),
        (load_uestc(stgcn), positions(70, fps=30), "positions only"),
    ):
        with pytest.raises(MotionkitError, match=reason):
            recogniser.recognise(samples)
    tensors = torch.load(stgcn, weights_only=True)
    for content, load, reason in (
        ({"model": {"linear1.weight": torch.zeros(30, 128)}}, load_humanact12, r"lacks model/linear1\.bias"),
        (tensors | {"fcn.weight": torch.zeros(12, 256, 1, 1)}, load_uestc, r"fcn.weight is \(12, 256, 1, 1\)"),
    ):
        torch.save(content, other)
        with pytest.raises(CheckpointError, match=reason):
            load(other)
    other.write_bytes(b"nothing of the kind")
    with pytest.raises(CheckpointError, match="not a checkpoint that can be read"):
        load_humanact12(other)
