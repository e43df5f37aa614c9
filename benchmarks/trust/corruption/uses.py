"""Reads of files that no quick command covers: called in separate processes, they print what they find."""

import hashlib
import json
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np


def history(folder: str) -> None:
    """Configuration, figures and summary of a trained stage."""
    from motionkit.training.run import StageFolder

    stage = StageFolder(Path(folder))
    print(json.dumps([stage.read_config(), stage.read_metrics(), stage.read_summary()], sort_keys=True))


def evaluator(run: str) -> None:
    """A trained evaluator's embeddings of fixed clips."""
    from eval.native_evaluator.evaluator import load_native

    clips = np.cumsum(0.01 * np.random.default_rng(2).normal(size=(4, 16, 22, 3)), axis=1) + np.arange(22)[:, None] / 9
    _print(load_native(Path(run)).embed_motions(clips, Fraction(20)))


def kinematic(folder: str) -> None:
    """The features of fitted kinematic descriptors, which are fitted where there are none."""
    from eval.clip_fid.channels import channels
    from eval.clip_fid.kinematic import fit_kinematic, load_kinematic

    path = Path(folder) / "kinematic.npz"
    clips = np.random.default_rng(3).normal(size=(4, 64, 22, 3))
    if not path.exists():
        path.parent.mkdir(exist_ok=True)
        fit_kinematic([channels(clip, Fraction(20)) for clip in clips], Fraction(20)).save(path)
    found = load_kinematic(path)
    _print(found.pose_mean, found.pose_components, found.centre, found.scale, text=str(found.fps))


def embeddings(folder: str) -> None:
    """Cached embeddings of motions."""
    from eval.text_motion.embedding_cache import FOLDER, Embedder

    embedder = Embedder(_Evaluator(), Path(folder) / FOLDER)  # type: ignore[arg-type]
    _print(embedder.kept({"motions": "abc"}, 6, lambda: np.random.default_rng(1).normal(size=(6, 5))))


def texts(folder: str) -> None:
    """Cached embeddings of texts."""
    from motionkit.training.text import embed_texts

    _print(embed_texts(_Encoder(), ("a person walks", "somebody jumps"), Path(folder)))  # type: ignore[arg-type]


def motions(folder: str) -> None:
    """What an ingest would store of a folder of motions."""
    from motionkit.io.scan import read, scan

    found = scan([Path(folder)])
    for problem in found.problems:
        raise problem
    for item in found.items:
        motion = read(item)
        facts = (motion.sequence_id, motion.fps, motion.split, motion.action, motion.style, motion.captions)
        arrays = (motion.joint_positions, motion.local_rotations, motion.root_translation, motion.skeleton.offsets)
        _print(*(array for array in arrays if array is not None), text=repr((facts, motion.skeleton)))


def samples(folder: str) -> None:
    """Write a small folder of samples."""
    path = Path(folder)
    path.mkdir()
    for number in range(2):
        joints = np.cumsum(0.01 * np.random.default_rng(number).normal(size=(40, 22, 3)), axis=0)
        np.save(path / f"sample{number}.npy", (joints + np.arange(22)[:, None] / 13).astype(np.float32))
    (path / "samples.toml").write_text("fps = 20\n")


class _Evaluator:
    name, fingerprint = "drill", "0" * 64


class _Encoder:
    fingerprint, dimension = "1" * 64, 8

    def encode(self, sentences: Sequence[str]) -> np.ndarray:
        return np.stack([np.frombuffer(text.encode()[:8], np.uint8).astype(np.float32) for text in sentences])


def _print(*arrays: object, text: str = "") -> None:
    digest = hashlib.sha256(text.encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(np.asarray(array)).tobytes())
    print(digest.hexdigest())
