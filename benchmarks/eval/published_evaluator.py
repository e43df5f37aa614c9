"""Guo et al.'s evaluator beside text-to-motion's own code, from a clone of its repository: difference and CPU time.

    python benchmarks/eval/published_evaluator.py CLONE [--checkpoints DIR] [--glove DIR] [--motions 64] [--json]

CLONE is github.com/EricGuo5513/text-to-motion, whose code is imported and run. With --checkpoints (the folder that
holds t2m/text_mot_match) the published weights are compared, otherwise random ones of the published sizes. Sentences
are compared where --glove (by default CLONE/glove) has the word vectors. Motions are random frames of 40 to 196, then
zeros, so the padding is `zeros`; how far `masked` is from that is printed beside. The published code computes in
float32: differences up to some 1e-6 of the embeddings' size are its rounding.
"""

import argparse
import importlib
import json
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch

from eval.report.results import provenance
from eval.text_motion.guo.evaluator import MAX_FRAMES, GuoEvaluator, load_guo
from eval.text_motion.guo.kind import KINDS, GuoFiles
from eval.text_motion.guo.networks import GuoNetworks
from eval.text_motion.guo.words import read_word_vectors
from motionkit.core.motion import Caption
from motionkit.features.statistics import Statistics

WORDS = ("a/DET", "person/NOUN", "walk/VERB", "and/CCONJ", "turn/VERB", "left/ADV", "slowly/ADV", "zebra/NOUN")
KIND = KINDS[259]


def random_evaluator(checkpoints: Path) -> GuoEvaluator:
    """Random weights of the published sizes, written to `checkpoints` as finest.tar too."""
    networks, generator = GuoNetworks(KIND), torch.Generator().manual_seed(0)
    named = networks.published()
    for tensors in named.values():
        for name, tensor in tensors.items():
            scale = 1.0 if tensor.ndim == 1 or name == "hidden" else tensor[0].numel() ** -0.5
            tensor.copy_((scale * torch.randn(tensor.shape, generator=generator)).float())
    folder = checkpoints / "t2m" / "text_mot_match" / "model"
    folder.mkdir(parents=True)
    floats = {key: {name: tensor.float() for name, tensor in tensors.items()} for key, tensors in named.items()}
    torch.save({**floats, "epoch": 0}, folder / "finest.tar")
    mean = np.zeros(KIND.num_statistics)
    mean[3] = 9.0
    return GuoEvaluator(networks, Statistics("humanml3d", mean, np.ones(KIND.num_statistics)), None, "zeros")


def published_wrapper(clone: Path, checkpoints: Path) -> Any:
    sys.path.insert(0, str(clone))
    options = SimpleNamespace(
        dataset_name="t2m",
        device=torch.device("cpu"),
        checkpoints_dir=str(checkpoints),
        dim_movement_enc_hidden=512,
        dim_movement_latent=512,
        unit_length=4,
    )
    return importlib.import_module("networks.evaluator_wrapper").EvaluatorModelWrapper(options)


def timed(work: Callable[[], np.ndarray]) -> tuple[np.ndarray, float]:
    start = time.process_time()
    result = work()
    return result, time.process_time() - start


def compare_motions(evaluator: GuoEvaluator, wrapper: Any, num_motions: int) -> dict[str, float]:
    rng = np.random.default_rng(1)
    lengths = 4 * rng.integers(10, MAX_FRAMES // 4 + 1, num_motions)
    mean, std = evaluator.statistics.mean, evaluator.statistics.std
    standardised = rng.normal(size=(num_motions, MAX_FRAMES, KIND.vector_size))
    standardised *= np.arange(MAX_FRAMES)[None, :, None] < lengths[:, None, None]
    vectors = standardised * std + mean
    ours, our_seconds = timed(lambda: evaluator.embed_vectors(list(vectors), lengths.tolist()))
    batch, sizes = torch.from_numpy(standardised), torch.from_numpy(lengths)
    theirs, their_seconds = timed(lambda: wrapper.get_motion_embeddings(batch, sizes).numpy())
    # The published wrapper sorts its rows by length.
    rows = np.argsort(lengths.tolist())[::-1]
    masked = replace(evaluator, padding="masked").embed_vectors(list(vectors), lengths.tolist())
    return {
        "largest value": float(np.abs(ours).max()),
        "largest difference": float(np.abs(ours[rows] - theirs).max()),
        "masked differs by": float(np.abs(ours - masked).max()),
        "our CPU seconds": our_seconds,
        "their CPU seconds": their_seconds,
    }


def compare_sentences(evaluator: GuoEvaluator, wrapper: Any, glove: Path) -> dict[str, float]:
    rng = np.random.default_rng(2)
    sentences = [list(rng.choice(WORDS, size)) for size in (25, 20, 19, 12, 5, 1)]
    vectorizer = importlib.import_module("utils.word_vectorizer").WordVectorizer(str(glove), "our_vab")
    steps = [["sos/OTHER", *sentence[:20], "eos/OTHER"] for sentence in sentences]
    lengths = torch.tensor([len(each) for each in steps])
    read = [[vectorizer[token] for token in each + ["unk/OTHER"] * (22 - len(each))] for each in steps]
    words = torch.tensor(np.array([[word for word, _ in each] for each in read])).float()
    parts = torch.tensor(np.array([[part for _, part in each] for each in read])).float()
    theirs = wrapper.text_encoder(words, parts, lengths).detach().numpy()
    ours = evaluator.embed_texts([Caption("", tokens=" ".join(sentence)) for sentence in sentences])
    return {
        "largest value": float(np.abs(ours).max()),
        "largest difference": float(np.abs(ours - theirs).max()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clone", type=Path)
    parser.add_argument("--checkpoints", type=Path)
    parser.add_argument("--glove", type=Path)
    parser.add_argument("--motions", type=int, default=64)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    glove = arguments.glove or arguments.clone / "glove"
    with tempfile.TemporaryDirectory() as scratch:
        checkpoints = arguments.checkpoints or Path(scratch)
        if arguments.checkpoints is None:
            evaluator = random_evaluator(checkpoints)
        else:
            weights = checkpoints / "t2m" / "text_mot_match" / "model" / "finest.tar"
            evaluator = load_guo(GuoFiles(weights, padding="zeros"))
        wrapper = published_wrapper(arguments.clone, checkpoints)
    figures = {"motions": compare_motions(evaluator, wrapper, arguments.motions)}
    if (glove / "our_vab_data.npy").is_file():
        read = replace(evaluator, words=read_word_vectors(glove))
        figures["sentences"] = compare_sentences(read, wrapper, glove)
    if arguments.json:
        print(json.dumps(figures | {"provenance": provenance()}, indent=2))
        return
    for what, found in figures.items():
        for name, value in found.items():
            print(f"{what:10} {name:22} {value:.3g}")


if __name__ == "__main__":
    main()
