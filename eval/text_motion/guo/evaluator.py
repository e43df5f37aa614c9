"""Guo et al.'s evaluator: published weights, statistics and word vectors, as a text–motion evaluator and feature set.

It reads `humanml3d` pose vectors at one framerate. Embeddings are not normalised; their distances are Euclidean. Rows
come in the order of the input; the published wrapper returns them sorted by length.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from eval.sets.sets import SampleSet
from eval.text_motion.guo.kind import GuoError, GuoFiles, GuoKind, read_statistics
from eval.text_motion.guo.networks import (
    FRAMES_PER_TOKEN,
    PUBLISHED,
    GuoNetworks,
    GuoWidths,
    MotionNetworks,
    networks_of,
)
from eval.text_motion.guo.words import WordVectors, read_word_vectors
from motionkit.core.motion import Caption
from motionkit.core.shapes import Float, Float32, Float64
from motionkit.features import humanml3d
from motionkit.features.humanml3d import placed, process
from motionkit.features.layout import pose_layout
from motionkit.features.statistics import Statistics
from motionkit.training.loop import read_foreign

VERSION = "guo/1"
MAX_FRAMES = 196
"""Frames of the longest motion in the published protocol, whose loaders drop motions of 200 frames and more."""
ROWS_AT_ONCE = 64
# Standardised heights are negative half of the time, heights above the floor hardly ever.
MAX_NEGATIVE_HEIGHTS = 0.1
# The root of a lying body is at a seventh of its usual height; a wrong unit is a factor of at least 39 (inches).
MOST_HEIGHT_FACTOR = 10.0


@dataclass(frozen=True, eq=False)
class GuoEvaluator:
    """The networks with their statistics and word vectors; `words` is None if no captions are read.

    Other networks of the same inputs embed captions by `captions`, under the name `title`; `pair_score` names the score
    of pairs that their authors report, empty for Euclidean distances.
    """

    networks: MotionNetworks
    statistics: Statistics
    words: WordVectors | None = None
    captions: Callable[[Sequence[Caption]], Float64[np.ndarray, "texts features"]] | None = None
    title: str = ""
    pair_score: str = ""

    @property
    def kind(self) -> GuoKind:
        """The kind of published evaluator."""
        return self.networks.kind

    @property
    def name(self) -> str:
        """Name for tables."""
        return self.title or self.kind.name

    @property
    def fps(self) -> Fraction:
        """The required framerate of the motions: 20, or 12.5 for KIT."""
        return self.kind.fps

    @property
    def layout(self) -> str:
        """Joint layout of the motions that it reads: `smpl22`, or `kit21` for KIT."""
        return self.kind.layout

    @property
    def vector_size(self) -> int:
        """Size of the pose vectors: 263, or 251 for KIT."""
        return self.kind.vector_size

    @cached_property
    def fingerprint(self) -> str:
        """First 16 hex digits of the sha256 over version, weights, statistics and word vectors."""
        digest = hashlib.sha256(f"{VERSION} {self.kind.name} {self.kind.dataset} masked".encode())
        for key, tensors in self.networks.published().items():
            for name in sorted(tensors):
                digest.update(f"{key}/{name}".encode() + tensors[name].numpy().astype("<f8").tobytes())
        arrays = [self.statistics.mean, self.statistics.std]
        if self.words is not None:
            digest.update(" ".join(self.words.row).encode())
            arrays.append(self.words.vectors[list(self.words.row.values())])
        for array in arrays:
            digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return digest.hexdigest()[:16] + ("" if self.captions is None else "-clip")

    def remark_at(self, fps: Fraction) -> str:
        """Empty: other framerates are refused."""
        return ""

    def embed_motions(self, samples: SampleSet) -> Float64[np.ndarray, "sequences features"]:
        """One row per sequence, in the order of the set, by way of `pose_vectors`.

        T poses are T − 1 frames here. Raises `GuoError` for another framerate or layout, and for a sequence of fewer
        than 5 or more than 200 poses.
        """
        self.check_fps(samples.fps, samples.name)
        return self._embed(
            [self.pose_vectors(sequence) for sequence in samples.sequences], samples.sequence_ids.__getitem__, None
        )

    def embed_vectors(
        self,
        motions: Sequence[Float[np.ndarray, "_frames numbers"]] | Float[np.ndarray, "motions frames numbers"],
        lengths: Sequence[int] | None = None,
    ) -> Float64[np.ndarray, "motions features"]:
        """One row per motion given as pose vectors in their own units (not standardised), at the evaluator's framerate.

        As in published comparisons, a generator's vectors, times its std plus its mean, are passed directly to the
        evaluator. `lengths` are the motions' numbers of frames if the arrays are padded. Lengths are truncated to a
        multiple of 4. Raises `GuoError` for vectors of another size, NaN, vectors that are still standardised or in
        another unit, and lengths under 4, over 199 or past the array's end.
        """
        return self._embed(list(motions), "motion {}".format, lengths)

    def embed_texts(self, captions: Sequence[Caption]) -> Float64[np.ndarray, "texts features"]:
        """One row per caption, in order.

        Raises `GuoError` without word vectors, and for a caption without `word/POS` tokens.
        """
        if self.captions is not None:
            return self.captions(captions)
        networks = self.networks
        if self.words is None or not isinstance(networks, GuoNetworks):
            raise GuoError("the word vectors that Guo's text encoder reads were not given: --glove DIR (our_vab_*)")
        sentences = [self.words.sentence(caption) for caption in captions]

        def embed(chosen: list[int]) -> torch.Tensor:
            words = [torch.from_numpy(sentences[index].words) for index in chosen]
            parts = [torch.from_numpy(sentences[index].parts) for index in chosen]
            return networks.embed_texts(words, parts)

        return self._in_batches([len(sentence.words) for sentence in sentences], embed)

    def describe(
        self, clips: Float[np.ndarray, "clips poses joints 3"], fps: Fraction
    ) -> Float64[np.ndarray, "clips features"]:
        """One embedding per clip, in order: each clip is put on the floor, rotated and converted by itself."""
        self.check_fps(fps, "clips")
        return self._embed([self.pose_vectors(clip) for clip in clips], "clip {}".format, None)

    def pose_vectors(
        self, joint_positions: Float[np.ndarray, "poses joints 3"]
    ) -> Float32[np.ndarray, "frames numbers"]:
        """The pose vectors of one motion as HumanML3D makes them: T poses give T − 1, as velocities need a next pose.

        `joint_positions` in metres, y up, in the evaluator's `layout`; the clip is moved to the floor and the origin,
        facing Z+. Bones of the 22 joints are scaled to HumanML3D's lengths. Those of KIT's 21 are unchanged: KIT-ML's
        own files all have its reference lengths. Raises `GuoError` for another layout.
        """
        layout = self.kind.layout
        joints = pose_layout(layout).num_joints
        if joint_positions.shape[1] != joints:
            raise GuoError(
                f"motions of {joint_positions.shape[1]} joints: {self.kind.dataset}'s evaluator reads {joints} "
                f"({layout}), in Table 1 alone; clip-FID compares clips of 22 joints"
            )
        if len(joint_positions) < 2:
            raise GuoError("a motion of one pose has no pose vectors")
        if self.kind.unit_metres == 1.0:
            return humanml3d.vectors(process(joint_positions, layout), layout)
        return humanml3d.vectors(placed(joint_positions / np.float32(self.kind.unit_metres), layout), layout)

    def check_fps(self, fps: Fraction, name: str) -> None:
        """Raise `GuoError` for a framerate other than the evaluator's."""
        if fps != self.fps:
            raise GuoError(
                f"{name}: {fps} fps, but {self.kind.dataset}'s evaluator was trained at {float(self.fps):g} fps and "
                f"means nothing at another: evaluate with --fps {float(self.fps):g}"
            )

    def _embed(
        self,
        motions: Sequence[Float[np.ndarray, "_frames numbers"]],
        title: Callable[[int], str],
        lengths: Sequence[int] | None,
    ) -> Float64[np.ndarray, "motions features"]:
        frames = [len(motion) for motion in motions] if lengths is None else [int(length) for length in lengths]
        if len(frames) != len(motions):
            raise GuoError(f"{len(frames)} lengths for {len(motions)} motions")
        self._check_vectors(motions, title, frames)
        tokens = [length // FRAMES_PER_TOKEN for length in frames]

        def embed(chosen: list[int]) -> torch.Tensor:
            inputs = [torch.from_numpy(self._inputs(motions[index], frames[index])) for index in chosen]
            return self.networks.embed_motions(inputs, [tokens[index] for index in chosen])

        return self._in_batches(tokens, embed)

    def _inputs(
        self, motion: Float[np.ndarray, "frames numbers"], num_frames: int
    ) -> Float64[np.ndarray, "inputs read"]:
        """Standardised frames of whole tokens; nothing past a motion's end, so an embedding is the motion's own."""
        own, num_inputs = num_frames // FRAMES_PER_TOKEN * FRAMES_PER_TOKEN, self.kind.num_inputs
        seen = motion[:own, :num_inputs].astype(np.float64)
        return np.asarray((seen - self.statistics.mean[:num_inputs]) / self.statistics.std[:num_inputs])

    def _in_batches(
        self, sizes: Sequence[int], embed: Callable[[list[int]], torch.Tensor]
    ) -> Float64[np.ndarray, "rows features"]:
        """Rows in the order of the input; batches have inputs of similar size."""
        result = np.empty((len(sizes), self.networks.num_features))
        with torch.inference_mode():
            by_size = np.argsort(sizes, kind="stable").tolist()
            for start in range(0, len(by_size), ROWS_AT_ONCE):
                chosen = by_size[start : start + ROWS_AT_ONCE]
                result[chosen] = embed(chosen).numpy()
        return result

    def _check_vectors(
        self, motions: Sequence[Float[np.ndarray, "_frames numbers"]], title: Callable[[int], str], frames: list[int]
    ) -> None:
        sizes = {self.kind.vector_size, self.kind.num_statistics}
        height = pose_layout(self.kind.layout).vector.root_height
        below = total = 0
        middle_heights = []
        for index, (motion, length) in enumerate(zip(motions, frames, strict=True)):
            if motion.ndim != 2 or motion.shape[1] not in sizes:
                expected = " or ".join(map(str, sorted(sizes)))
                raise GuoError(
                    f"{title(index)}: vectors of shape {motion.shape}; {self.kind.dataset}'s have {expected} numbers"
                )
            if not FRAMES_PER_TOKEN <= length <= len(motion):
                raise GuoError(
                    f"{title(index)}: {length} frames of {len(motion)}; the evaluator needs at least {FRAMES_PER_TOKEN}"
                )
            if length >= MAX_FRAMES + FRAMES_PER_TOKEN:
                raise GuoError(
                    f"{title(index)}: {length} frames; the evaluator knows motions of at most {MAX_FRAMES} "
                    f"({float(MAX_FRAMES / self.fps):.1f} s), and the published protocol drops longer ones"
                )
            if not np.isfinite(motion).all():
                raise GuoError(f"{title(index)}: holds NaN or infinity")
            below += int((motion[:length, height] < 0).sum())
            total += length
            middle_heights.append(float(np.median(motion[:length, height])))
        if total and below > MAX_NEGATIVE_HEIGHTS * total:
            raise GuoError(
                f"the root is below the floor in {below / total:.0%} of the frames, so these vectors are still "
                "standardised: multiply by the std and add the mean that they were standardised with"
            )
        usual = float(np.median(middle_heights)) if middle_heights else self.kind.root_height
        if not 1 / MOST_HEIGHT_FACTOR < usual / self.kind.root_height < MOST_HEIGHT_FACTOR:
            raise GuoError(
                f"the root's height is {usual:.3g} in the typical motion, {self.kind.root_height:.3g} in "
                f"{self.kind.dataset}: these motions are in another unit"
            )


def load_guo(files: GuoFiles, widths: GuoWidths = PUBLISHED) -> GuoEvaluator:
    """Load `text_mot_match/model/finest.tar`, and the statistics and word vectors that belong to it.

    Without a folder of statistics (mean.npy, std.npy) the published archive's location is searched. The weights' sizes
    distinguish HumanML3D's evaluator from KIT's, and Guo's from MARDM's. Raises `CheckpointError` for invalid weights
    and `GuoError` for other invalid files.
    """
    networks = networks_of(read_foreign(files.weights), files.weights, widths)
    folder = files.statistics or _published_statistics(files.weights)
    if folder is None:
        raise GuoError(
            f"{files.weights}: the statistics that belong to these weights are not beside them; name their folder with "
            "--statistics DIR (Comp_v6_KLD01/meta of the published archive; docs/evaluators.md)"
        )
    words = None if files.glove is None else read_word_vectors(files.glove)
    return GuoEvaluator(networks, read_statistics(folder, networks.kind), words)


def _published_statistics(weights: Path) -> Path | None:
    """The folder `meta` of a model beside DATASET/text_mot_match/model/finest.tar, where published archives have it.

    text-to-motion's own models for HumanML3D and KIT, and the one that T2M-GPT takes it from.
    """
    dataset = weights.absolute().parent.parent.parent
    models = ("Comp_v6_KLD01", "Comp_v6_KLD005", "VQVAEV3_CB1024_CMT_H1024_NRES3")
    return next((dataset / model / "meta" for model in models if (dataset / model / "meta").is_dir()), None)
