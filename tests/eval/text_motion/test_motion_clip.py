"""MARDM's MotionCLIP on random weights in the published layout: what is loaded, what is refused, what it computes."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch

from eval.metrics.retrieval import clip_score
from eval.text_motion.guo import KEY, GuoError, load_motion_clip
from motionkit.core.motion import Caption
from motionkit.training.loop import CheckpointError
from tests.helpers.published_guo import pose_vectors, write_statistics

pytest.importorskip("transformers", reason="needs the extra motionkit[text]")

LETTERS = "abcdefghijklmnopqrstuvwxyz"
WORDS = [*LETTERS, *(f"{letter}</w>" for letter in LETTERS), "wa", "lk</w>", "walk</w>"]
WIDTH, FORWARD, LAYERS, VOCABULARY, CONTEXT, POSITIONS = 16, 32, 2, len(WORDS) + 2, 9, 200
STATISTICS = ((0.01283, 0.01693, 0.15378, 0.12224), 0.93862)


def shapes(num_inputs: int) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the published checkpoint, as its classes make them."""
    width, forward = WIDTH, FORWARD
    layer = {
        "self_attn.in_proj_weight": (3 * width, width),
        "self_attn.in_proj_bias": (3 * width,),
        "self_attn.out_proj.weight": (width, width),
        "self_attn.out_proj.bias": (width,),
        "linear1.weight": (forward, width),
        "linear1.bias": (forward,),
        "linear2.weight": (width, forward),
        "linear2.bias": (width,),
        **{f"norm{each}.{part}": (width,) for each in (1, 2) for part in ("weight", "bias")},
    }
    named = {
        "positional_embedding": (CONTEXT, width),
        "logit_scale": (),
        "token_embedding.weight": (VOCABULARY, width),
        "motion_encoder.query_token": (1, width),
        "motion_encoder.embed_motion.weight": (width, num_inputs),
        "motion_encoder.embed_motion.bias": (width,),
        "motion_encoder.sequence_pos_encoder.pe": (POSITIONS, width),
    }
    for norm in ("motion_encoder.out_ln", "text_ln"):
        named |= {f"{norm}.weight": (width,), f"{norm}.bias": (width,)}
    for out in ("motion_encoder.out", "out"):
        named |= {f"{out}.weight": (width, width), f"{out}.bias": (width,)}
    for encoder in ("motion_encoder.transformer", "textTransEncoder"):
        for number in range(LAYERS):
            named |= {f"{encoder}.layers.{number}.{name}": shape for name, shape in layer.items()}
    return named


def write(folder: Path, num_inputs: int = 67) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    tensors = {
        name: torch.randn(shape, generator=generator) * (0.3 if len(shape) > 1 else 0.1)
        for name, shape in shapes(num_inputs).items()
    }
    tensors["motion_encoder.sequence_pos_encoder.pe"] = positions()
    torch.save({KEY: tensors, "epoch": 3}, folder / "finest.tar")
    write_statistics(folder, STATISTICS, ("eval_mean.npy", "eval_std.npy"))
    words = {word: number for number, word in enumerate((*WORDS, "<|startoftext|>", "<|endoftext|>"))}
    (folder / "vocab.json").write_text(json.dumps(words), encoding="utf-8")
    (folder / "merges.txt").write_text("#version: 0.2\nw a\nl k</w>\nwa lk</w>\n", encoding="utf-8")
    return tensors


def positions() -> torch.Tensor:
    table = torch.zeros(POSITIONS, WIDTH)
    for place in range(POSITIONS):
        for number in range(WIDTH):
            angle = place * math.exp(-math.log(10000.0) * (number - number % 2) / WIDTH)
            table[place, number] = math.cos(angle) if number % 2 else math.sin(angle)
    return table


def transformed(x: np.ndarray, w: dict[str, np.ndarray], prefix: str, layers: int, heads: int) -> np.ndarray:
    """A post-norm transformer by plain loops over heads, [steps, width]."""
    width = x.shape[1]
    size = width // heads
    for number in range(layers):
        p = f"{prefix}.layers.{number}."
        qkv = x @ w[p + "self_attn.in_proj_weight"].T + w[p + "self_attn.in_proj_bias"]
        heard = []
        for head in range(heads):
            q, k, v = (qkv[:, part * width + head * size : part * width + (head + 1) * size] for part in range(3))
            scores = q @ k.T / math.sqrt(size)
            weights = np.exp(scores - scores.max(axis=1, keepdims=True))
            heard.append(weights / weights.sum(axis=1, keepdims=True) @ v)
        attended = np.concatenate(heard, axis=1) @ w[p + "self_attn.out_proj.weight"].T
        x = normed(x + attended + w[p + "self_attn.out_proj.bias"], w, p + "norm1")
        hidden = x @ w[p + "linear1.weight"].T + w[p + "linear1.bias"]
        hidden = 0.5 * hidden * (1 + np.vectorize(math.erf)(hidden / math.sqrt(2)))
        x = normed(x + hidden @ w[p + "linear2.weight"].T + w[p + "linear2.bias"], w, p + "norm2")
    return x


def normed(x: np.ndarray, w: dict[str, np.ndarray], name: str) -> np.ndarray:
    centred = x - x.mean(axis=1, keepdims=True)
    return centred / np.sqrt((centred**2).mean(axis=1, keepdims=True) + 1e-5) * w[name + ".weight"] + w[name + ".bias"]


def unit(x: np.ndarray) -> np.ndarray:
    return x / np.linalg.norm(x)


def test_both_encoders_are_the_published_ones(tmp_path: Path) -> None:
    w = {name: tensor.double().numpy() for name, tensor in write(tmp_path).items()}
    evaluator = load_motion_clip(tmp_path)
    assert evaluator.pair_score == "clip_score"
    motions = [pose_vectors(length, length) for length in (41, 60, 43)]
    found = evaluator.embed_vectors(motions)
    mean, std = (np.load(tmp_path / f"eval_{name}.npy") for name in ("mean", "std"))
    pe = w["motion_encoder.sequence_pos_encoder.pe"]
    for row, motion in zip(found, motions, strict=True):
        frames = (motion[: len(motion) // 4 * 4, :67] - mean) / std
        steps = frames @ w["motion_encoder.embed_motion.weight"].T + w["motion_encoder.embed_motion.bias"]
        steps = np.concatenate((w["motion_encoder.query_token"], steps))
        last = transformed(steps + pe[: len(steps)], w, "motion_encoder.transformer", 2, 8)
        first = normed(last[:1], w, "motion_encoder.out_ln")[0]
        expected = unit(w["motion_encoder.out.weight"] @ first + w["motion_encoder.out.bias"])
        np.testing.assert_allclose(row, expected, atol=2e-5)
    captions = ["walk a", "a a a a a a a a a a"]
    start, end = VOCABULARY - 2, VOCABULARY - 1
    walk, a = WORDS.index("walk</w>"), WORDS.index("a</w>")
    tokens = [[start, walk, a, end, 0, 0, 0, 0, 0], [start, *[a] * 7, end]]
    texts = evaluator.embed_texts([Caption(text) for text in captions])
    for row, numbers in zip(texts, tokens, strict=True):
        steps = w["token_embedding.weight"][numbers] + w["positional_embedding"]
        last = normed(transformed(steps, w, "textTransEncoder", 2, 8), w, "text_ln")[numbers.index(end)]
        np.testing.assert_allclose(row, unit(w["out.weight"] @ last + w["out.bias"]), atol=2e-5)
    assert clip_score(texts, found[:2]) == pytest.approx(np.mean([texts[0] @ found[0], texts[1] @ found[1]]), abs=1e-6)


def test_kits_evaluator_reads_64_numbers(tmp_path: Path) -> None:
    write(tmp_path, num_inputs=64)
    write_statistics(tmp_path, ((0.02479, 29.3192, 114.661, 93.6202), 559.62), ("eval_mean.npy", "eval_std.npy"))
    assert load_motion_clip(tmp_path).layout == "kit21"


@pytest.mark.parametrize(
    ("name", "message"), [("out_ln.weight", r"out_ln"), ("embed_motion.weight", "reads 67, 64 numbers")]
)
def test_other_weights_are_refused(tmp_path: Path, name: str, message: str) -> None:
    torch.save({KEY: write(tmp_path) | {f"motion_encoder.{name}": torch.zeros(16, 259)}}, tmp_path / "finest.tar")
    with pytest.raises(CheckpointError, match=message):
        load_motion_clip(tmp_path)


def test_another_vocabulary_is_refused(tmp_path: Path) -> None:
    write(tmp_path)
    words = json.loads((tmp_path / "vocab.json").read_text())
    (tmp_path / "vocab.json").write_text(json.dumps(words | {"more": len(words)}))
    with pytest.raises(GuoError, match=f"{VOCABULARY + 1} word pieces"):
        load_motion_clip(tmp_path)
    (tmp_path / "merges.txt").unlink()
    with pytest.raises(GuoError, match=r"merges\.txt"):
        load_motion_clip(tmp_path)
