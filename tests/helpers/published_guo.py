"""Files in the published layout of Guo et al.'s evaluator, with random weights: finest.tar, our_vab_*, mean and std."""

import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

VOCABULARY = (
    *("sos", "eos", "unk", "a", "person", "man", "walk", "slowly", "forward", "and", "turn", "left", "in", "circle"),
    *("foot", "chair", "is", "two", "arm", "then"),
)


class GuoWidths(NamedTuple):
    """Widths of the networks; published are 512, 1024, 512, 512."""

    movement: int
    motion: int
    text: int
    shared: int


# The std of the seven blocks and the root's mean height in the published statistics.
T2M = ((5.1467e-4, 6.7693e-4, 6.1208e-3, 0.122555, 0.300386, 0.0195406, 0.0140949), 0.91752)
PLAIN = ((0.012866, 0.016923, 0.153022, 0.122555, 0.300386, 0.0195406, 0.352374), 0.93855)
KIT = ((9.9157e-4, 1.172767, 4.58643, 93.6202, 0.342471, 29.1116, 5.26644e-3), 559.62)


def gru(prefix: str, width: int) -> Iterator[tuple[str, tuple[int, ...]]]:
    for suffix in ("", "_reverse"):
        for part in ("ih", "hh"):
            yield f"{prefix}.weight_{part}_l0{suffix}", (3 * width, width)
            yield f"{prefix}.bias_{part}_l0{suffix}", (3 * width,)


def sequence_encoder(numbers: int, width: int, shared: int) -> Iterator[tuple[str, tuple[int, ...]]]:
    yield "hidden", (2, 1, width)
    yield from (("input_emb.weight", (width, numbers)), ("input_emb.bias", (width,)))
    yield from gru("gru", width)
    yield from (("output_net.0.weight", (width, 2 * width)), ("output_net.0.bias", (width,)))
    yield from (("output_net.1.weight", (width,)), ("output_net.1.bias", (width,)))
    yield from (("output_net.3.weight", (shared, width)), ("output_net.3.bias", (shared,)))


def tensors(shapes: Iterator[tuple[str, tuple[int, ...]]], rng: np.random.Generator) -> dict[str, torch.Tensor]:
    made = {}
    for name, shape in shapes:
        scale = 1.0 if len(shape) == 1 or name == "hidden" else np.prod(shape[1:]) ** -0.5
        made[name] = torch.from_numpy((scale * rng.standard_normal(shape, dtype=np.float32)).astype(np.float32))
    return made


def checkpoint(num_inputs: int, widths: GuoWidths, seed: int = 0) -> dict[str, object]:
    """What finest.tar holds, the optimisers' states and counters included."""
    rng = np.random.default_rng(seed)
    movement = (
        *(("main.0.weight", (widths.movement, num_inputs, 4)), ("main.0.bias", (widths.movement,))),
        *(("main.3.weight", (widths.movement, widths.movement, 4)), ("main.3.bias", (widths.movement,))),
        *(("out_net.weight", (widths.movement, widths.movement)), ("out_net.bias", (widths.movement,))),
    )
    text = tensors(sequence_encoder(300, widths.text, widths.shared), rng)
    text |= tensors(iter((("pos_emb.weight", (300, 15)), ("pos_emb.bias", (300,)))), rng)
    optimiser = {"state": {0: {"step": 3, "exp_avg": torch.zeros(2)}}, "param_groups": [{"lr": 1e-4, "params": [0]}]}
    return {
        "movement_encoder": tensors(iter(movement), rng),
        "motion_encoder": tensors(sequence_encoder(widths.movement, widths.motion, widths.shared), rng),
        "text_encoder": text,
        "opt_text_encoder": optimiser,
        "opt_motion_encoder": optimiser,
        "epoch": 7,
        "iter": 1234,
    }


def write_statistics(
    folder: Path, signature: tuple[tuple[float, ...], float] = T2M, names: tuple[str, str] = ("mean.npy", "std.npy")
) -> Path:
    """Mean and std of a signature: one std per block; 263 numbers, 251 for KIT, the first four blocks for MARDM."""
    block_std, height = signature
    joints = 21 if height > 1.5 else 22
    sizes = (1, 2, 1, 3 * (joints - 1), 6 * (joints - 1), 3 * joints, 4)[: len(block_std)]
    std = np.repeat(block_std, sizes)
    mean = np.random.default_rng(5).normal(0, 0.1, std.size) * std.max()
    mean[3] = height
    folder.mkdir(parents=True, exist_ok=True)
    np.save(folder / names[0], mean)
    np.save(folder / names[1], std)
    return folder


def write_glove(folder: Path, seed: int = 1) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    np.save(folder / "our_vab_data.npy", rng.normal(0, 0.4, (len(VOCABULARY), 300)).astype(np.float32))
    (folder / "our_vab_words.pkl").write_bytes(pickle.dumps(list(VOCABULARY)))
    places = {word: index for index, word in enumerate(VOCABULARY)}
    (folder / "our_vab_idx.pkl").write_bytes(pickle.dumps(places, protocol=3))
    return folder


def write_archive(folder: Path, widths: GuoWidths, num_inputs: int = 259, seed: int = 0) -> Path:
    """DATASET/text_mot_match/model/finest.tar with Comp_v6_KLD01/meta beside it; returns the weights' path."""
    weights = folder / "text_mot_match" / "model" / "finest.tar"
    weights.parent.mkdir(parents=True)
    torch.save(checkpoint(num_inputs, widths, seed), weights)
    write_statistics(folder / "Comp_v6_KLD01" / "meta", T2M if num_inputs == 259 else KIT)
    return weights


def pose_vectors(num_frames: int, seed: int) -> np.ndarray:
    """263 numbers per frame of about the published means and deviations, in their own units."""
    rng = np.random.default_rng(seed)
    std = np.repeat(PLAIN[0], (1, 2, 1, 63, 126, 66, 4))
    vectors = rng.normal(size=(num_frames, 263)) * std
    vectors[:, 3] = PLAIN[1] + 0.3 * vectors[:, 3]
    return vectors.astype(np.float32)
