"""Training of the native-rate evaluator: from damage of known strength, and from captions.

A step takes clips of one framerate and one length, corrupts most of them with one family of `eval.sets.corruptions` at
a random strength, some with added noise, and regresses the strengths by linear heads on the embedding. Clean clips are
matched with their captions (InfoNCE); pairs with the same caption are not negatives. Classifying the kind of damage
saturates at its mildest level (measured), so its log strength is regressed.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from eval.native_evaluator.bank import ClipBank, DrawnClips
from eval.native_evaluator.evaluator import shrunk_whitening
from eval.native_evaluator.network import TARGETS, NativeNetwork, TextProjection, prepare, rich_input, standardised
from eval.native_evaluator.settings import NativeConfig
from eval.sets.corruptions import Family, families
from motionkit.core.motion import Caption
from motionkit.core.shapes import Bool, Float, Float32, Float64, Int64
from motionkit.training.config import rate_factor
from motionkit.training.loop import seeded_initialisation, set_rate
from motionkit.training.tensors import load_optimizer_tensors, optimizer_tensors, prefixed, unprefixed

TARGET_OF_FAMILY: Mapping[str, int] = {
    "upsampling-slerp": TARGETS.index("upsampling"),
    "upsampling-linear": TARGETS.index("upsampling"),
    "foot-sliding": TARGETS.index("foot-sliding"),
    "jitter": TARGETS.index("jitter"),
    "low-pass": TARGETS.index("low-pass"),
}
MARGIN_SECONDS = 0.3


@dataclass(frozen=True, eq=False)
class Sentences:
    """Distinct sentences with their embeddings, and the takes they describe.

    One row per annotation: `take` (ascending), `sentence` (a row of `embeddings`), and the seconds [start_seconds,
    end_seconds) of the take that it describes (infinity: to the end).
    """

    embeddings: Float32[np.ndarray, "sentences text"]
    take: Int64[np.ndarray, "utterances"]
    sentence: Int64[np.ndarray, "utterances"]
    start_seconds: Float64[np.ndarray, "utterances"]
    end_seconds: Float64[np.ndarray, "utterances"]

    @property
    def dimension(self) -> int:
        """Size of a sentence embedding; 0 if there is no text."""
        return int(self.embeddings.shape[1])

    def about(self, take: int, seconds: float) -> Int64[np.ndarray, "found"]:
        """Sentences that describe an instant of a take."""
        rows = slice(*np.searchsorted(self.take, (take, take + 1)))
        said = (self.start_seconds[rows] <= seconds) & (seconds < self.end_seconds[rows])
        return self.sentence[rows][said]


def collect_sentences(
    captions: Sequence[Sequence[Caption]], embed: Callable[[list[str]], Float32[np.ndarray, "sentences text"]]
) -> Sentences:
    """Sentences of all takes, each distinct text embedded once; empty texts are left out."""
    said = [(take, caption) for take, some in enumerate(captions) for caption in some if caption.text.strip()]
    texts = list(dict.fromkeys(caption.text for _, caption in said))
    row = {text: index for index, text in enumerate(texts)}
    ends = [np.inf if caption.end_seconds is None else caption.end_seconds for _, caption in said]
    return Sentences(
        embeddings=embed(texts) if texts else np.zeros((0, 0), dtype=np.float32),
        take=np.array([take for take, _ in said], dtype=np.int64),
        sentence=np.array([row[caption.text] for _, caption in said], dtype=np.int64),
        start_seconds=np.array([caption.start_seconds for _, caption in said], dtype=np.float64),
        end_seconds=np.array(ends, dtype=np.float64),
    )


@dataclass(frozen=True, eq=False)
class SpoiledClips:
    """Input clips, the first `num_clean` of them clean, and the target strengths."""

    positions: Float32[np.ndarray, "clips poses 22 3"]
    targets: Float32[np.ndarray, "clips targets"]
    num_clean: int


def spoil(
    clips: Float64[np.ndarray, "clips longer 22 3"],
    fps: float,
    margin: int,
    num_clean: int,
    damage: Sequence[Family],
    compound_fraction: float,
    rng: np.random.Generator,
) -> SpoiledClips:
    """Corrupt all but the first `num_clean` clips, families in turn, strengths at random; then cut the margins off.

    A fraction of the clips that lost detail get jitter on top: damage must be recognised under noise too. The result is
    prepared for the network's input (`native_input.prepare`).
    """
    spoiled = clips.copy()
    targets = np.zeros((len(clips), len(TARGETS)))
    for index, family in enumerate(damage):
        rows = np.arange(num_clean + index, len(clips), len(damage))
        strength = family.draw(rng, fps, len(rows))
        spoiled[rows] = family.corrupt(clips[rows], fps, strength, rng)
        targets[rows, TARGET_OF_FAMILY[family.name]] = family.severity(strength, fps)
    noise = next(family for family in damage if family.name == "jitter")
    lost_detail = np.flatnonzero(targets[:, [TARGETS.index("upsampling"), TARGETS.index("low-pass")]].any(axis=1))
    rows = rng.choice(lost_detail, size=round(compound_fraction * len(lost_detail)), replace=False)
    strength = noise.draw(rng, fps, len(rows))
    spoiled[rows] = noise.corrupt(spoiled[rows], fps, strength, rng)
    targets[rows, TARGETS.index("jitter")] = noise.severity(strength, fps)
    cut = spoiled[:, margin : spoiled.shape[1] - margin]
    return SpoiledClips(prepare(cut, fps), targets.astype(np.float32), num_clean)


def matching_loss(
    motions: Float[Tensor, "pairs shared"],
    sentences: Float[Tensor, "pairs shared"],
    sentence_ids: Int64[np.ndarray, "pairs"],
    temperature: float,
) -> Float[Tensor, ""]:
    """Symmetric InfoNCE on negative squared distances; other pairs with the same caption are excluded.

    Distances, not cosines, because the metrics that use these embeddings (R-Precision, MM-Dist) are Euclidean.
    """
    logits = -(torch.cdist(motions, sentences) ** 2) / (temperature * motions.shape[1])
    ids = torch.from_numpy(sentence_ids).to(logits.device)
    return symmetric_cross_entropy(logits, ids[:, None] == ids[None])


def symmetric_cross_entropy(
    logits: Float[Tensor, "pairs pairs"], same: Bool[Tensor, "pairs pairs"]
) -> Float[Tensor, ""]:
    """Mean cross-entropy of both directions with the diagonal as targets; other pairs that are `same` are masked."""
    own = torch.arange(len(logits), device=logits.device)
    logits = logits.masked_fill(same & (own[:, None] != own), float("-inf"))
    cross_entropy = torch.nn.functional.cross_entropy
    return 0.5 * (cross_entropy(logits, own) + cross_entropy(logits.T, own))


class NativeTraining:
    """The evaluator in training; it owns the networks, the input statistics and the optimiser."""

    def __init__(
        self, config: NativeConfig, banks: Sequence[ClipBank], sentences: Sentences, seed: int, device: torch.device
    ) -> None:
        self.config, self.banks, self.sentences, self.device = config, banks, sentences, device
        self.damage = families()
        with seeded_initialisation(seed, "evaluator"):
            self.network = NativeNetwork(config.network).to(device)
            self.text = TextProjection(max(sentences.dimension, 1), config.network).to(device)
        self.mean, self.scale = self._statistics(np.random.default_rng((seed, 1)))
        parameters = [*self.network.parameters(), *self.text.parameters()]
        self.optimizer = torch.optim.AdamW(parameters, lr=0.0, weight_decay=config.training.weight_decay)

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, Tensor]:
        """One batch of one framerate and one clip length."""
        training = self.config.training
        rng = np.random.default_rng(int(torch.randint(2**62, (), generator=generator)))
        batch, drawn, fps = self._batch(rng)
        embeddings = self.network(self._inputs(batch.positions, fps))
        targets = torch.from_numpy(batch.targets).to(self.device)
        strength = torch.nn.functional.smooth_l1_loss(self.network.strengths(embeddings), targets, beta=0.5)
        matching = self._matching(embeddings, batch.num_clean, drawn, rng)
        loss = training.strength_weight * strength + training.text_weight * matching
        factor = rate_factor(step, training.steps, schedule="cosine", warmup_fraction=training.warmup_fraction)
        set_rate(self.optimizer, training.learning_rate * factor)
        self.optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), training.gradient_clip)
        self.optimizer.step()
        return {"loss": loss, "strength": strength, "matching": matching}

    def whitening(self, seed: int) -> Float32[np.ndarray, "features features"]:
        """Scale of the embeddings, from clean clips of every framerate and of all lengths."""
        rng = np.random.default_rng((seed, 2))
        by_framerate = []
        with torch.inference_mode():
            for bank in self.banks:
                rows = [self._embed_clean(bank, rng) for _ in range(self.config.training.whitening_batches)]
                by_framerate.append(np.concatenate(rows))
        return shrunk_whitening(by_framerate)

    def state_tensors(self) -> dict[str, Tensor]:
        """Networks, statistics, optimiser."""
        return self.model_tensors() | prefixed("optimizer", optimizer_tensors(self.optimizer))

    def model_tensors(self) -> dict[str, Tensor]:
        """Networks and statistics of inputs, which `load_native` reads besides the whitening."""
        networks = prefixed("network", self.network.state_dict()) | prefixed("text", self.text.state_dict())
        return networks | {"statistics.mean": self.mean, "statistics.scale": self.scale}

    def load_state_tensors(self, tensors: Mapping[str, Tensor]) -> None:
        """Restore a state of `state_tensors`."""
        self.network.load_state_dict(unprefixed("network", tensors))
        self.text.load_state_dict(unprefixed("text", tensors))
        self.mean = tensors["statistics.mean"].to(self.device)
        self.scale = tensors["statistics.scale"].to(self.device)
        load_optimizer_tensors(self.optimizer, unprefixed("optimizer", tensors))

    def _batch(self, rng: np.random.Generator) -> tuple[SpoiledClips, DrawnClips, float]:
        training = self.config.training
        bank = self.banks[int(rng.integers(len(self.banks)))]
        num_poses = self._draw_length(bank, rng)
        fps = float(bank.fps)
        margin = int(np.ceil(MARGIN_SECONDS * fps))
        drawn = bank.draw(rng, training.batch_size, num_poses, margin)
        num_clean = round(training.clean_fraction * training.batch_size)
        spoiled = spoil(drawn.positions, fps, margin, num_clean, self.damage, training.compound_fraction, rng)
        return spoiled, drawn, fps

    def _draw_length(self, bank: ClipBank, rng: np.random.Generator) -> int:
        """Number of poses of a batch's clips: a multiple of 4, at most the longest sequence of the bank."""
        training = self.config.training
        longest = min(training.max_poses, int(bank.sequences.num_frames.max()) // 4 * 4)
        return 4 * int(rng.integers(training.min_poses // 4, longest // 4 + 1))

    def _embed_clean(self, bank: ClipBank, rng: np.random.Generator) -> Float32[np.ndarray, "clips features"]:
        drawn = bank.draw(rng, self.config.training.batch_size, self._draw_length(bank, rng))
        fps = float(bank.fps)
        embeddings: Float32[np.ndarray, "clips features"] = (
            self.network(self._inputs(prepare(drawn.positions, fps), fps)).cpu().numpy()
        )
        return embeddings

    def _inputs(self, positions: Float32[np.ndarray, "clips poses 22 3"], fps: float) -> Tensor:
        raw = rich_input(torch.from_numpy(positions).to(self.device), fps)
        return standardised(raw, self.mean, self.scale)

    def _matching(
        self, embeddings: Float[Tensor, "clips features"], num_clean: int, drawn: DrawnClips, rng: np.random.Generator
    ) -> Float[Tensor, ""]:
        """Matching loss of the clean clips that have captions, one caption each."""
        takes, seconds = drawn.take[:num_clean].tolist(), drawn.centre_seconds[:num_clean].tolist()
        about = [self.sentences.about(take, second) for take, second in zip(takes, seconds, strict=True)]
        rows = [row for row, found in enumerate(about) if len(found)]
        if len(rows) < 2:
            return embeddings.new_zeros(())
        sentence = np.array([rng.choice(about[row]) for row in rows], dtype=np.int64)
        texts = self.text(torch.from_numpy(self.sentences.embeddings[sentence]).to(self.device))
        motions = self.network.shared(embeddings[torch.tensor(rows, device=self.device)])
        return matching_loss(motions, texts, sentence, self.config.training.text_temperature)

    def _statistics(self, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Mean and 1 / deviation of every channel over spoiled and clean clips of all framerates."""
        rows = []
        for _ in range(self.config.training.statistics_batches):
            batch, _, fps = self._batch(rng)
            inputs = rich_input(torch.from_numpy(batch.positions), fps)
            rows.append(inputs.reshape(-1, inputs.shape[-1]).double())
        everything = torch.cat(rows)
        mean, deviation = everything.mean(dim=0), everything.std(dim=0)
        return mean.float().to(self.device), (1.0 / deviation.clamp_min(1e-3)).float().to(self.device)
