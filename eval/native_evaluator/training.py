"""Training of the native-rate evaluator: from damage of known strength and captions, or from captions alone (TMR).

A step takes clips of one framerate and one length. The stage `evaluator` corrupts most of them with one family of
`eval.sets.damage` at a random strength, some with added noise, and regresses the strengths by linear heads on the
embedding. Clean clips are matched with their captions (InfoNCE); pairs with the same caption are not negatives.
Classifying the kind of damage saturates at its mildest level (measured), so its log strength is regressed.

The stage `tmr` has TMR's contrastive loss alone: InfoNCE on cosines, in which pairs with nearly the same sentence are
not negatives of each other (Petrovich et al. 2023; src/model/losses.py of Mathux/TMR @ 6d74688). TMR's decoder,
reconstruction loss and Gaussian latents are left out: they serve generation.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from eval.native_evaluator.bank import ClipBank, DrawnClips
from eval.native_evaluator.network import (
    MIN_POSES,
    TARGETS,
    NativeNetwork,
    TextProjection,
    prepare,
    rich_input,
    standardised,
)
from eval.native_evaluator.settings import NativeConfig, NativeTrainingConfig, TmrConfig, TmrTrainingConfig
from eval.sets.damage import Family, families
from motionkit.core.errors import UsageError
from motionkit.core.motion import Caption
from motionkit.core.shapes import Bool, Float, Float32, Float64, Int64
from motionkit.training.config import Schedule
from motionkit.training.loop import (
    load_optimizer_tensors,
    optimizer_tensors,
    prefixed,
    seeded_initialisation,
    set_rate,
    unprefixed,
)

TARGET_OF_FAMILY: Mapping[str, int] = {
    "upsampling-slerp": TARGETS.index("upsampling"),
    "upsampling-linear": TARGETS.index("upsampling"),
    "foot-sliding": TARGETS.index("foot-sliding"),
    "jitter": TARGETS.index("jitter"),
    "low-pass": TARGETS.index("low-pass"),
}
MARGIN_SECONDS = 0.3
MAX_DRAWS = 100
"""Batches of the stage `tmr` that are drawn for two captioned clips before captions are reported as too rare."""


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

    def of_clips(
        self, drawn: DrawnClips, num_clips: int, rng: np.random.Generator
    ) -> tuple[list[int], Int64[np.ndarray, "described"]]:
        """Which of the first clips are described by a sentence at their middle, and a random such sentence of each."""
        rows, sentences = [], []
        for row in range(num_clips):
            utterances = slice(*np.searchsorted(self.take, (drawn.take[row], drawn.take[row] + 1)))
            seconds = drawn.centre_seconds[row]
            is_about = (self.start_seconds[utterances] <= seconds) & (seconds < self.end_seconds[utterances])
            if is_about.any():
                rows.append(row)
                sentences.append(rng.choice(self.sentence[utterances][is_about]))
        return rows, np.array(sentences, dtype=np.int64)


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


def retrieval_loss(
    motions: Float[Tensor, "pairs shared"],
    texts: Float[Tensor, "pairs shared"],
    sentences: Float[Tensor, "pairs text"],
    temperature: float,
    same_above: float,
) -> Float[Tensor, ""]:
    """Symmetric InfoNCE on cosines (TMR); other pairs whose sentences score above `same_above` are excluded."""
    normalize = torch.nn.functional.normalize
    logits = normalize(texts, dim=1) @ normalize(motions, dim=1).T / temperature
    unit = normalize(sentences, dim=1)
    return symmetric_cross_entropy(logits, unit @ unit.T > 2.0 * same_above - 1.0)


def symmetric_cross_entropy(
    logits: Float[Tensor, "pairs pairs"], same: Bool[Tensor, "pairs pairs"]
) -> Float[Tensor, ""]:
    """Mean cross-entropy of both directions with the diagonal as targets; other pairs that are `same` are masked."""
    own = torch.arange(len(logits), device=logits.device)
    logits = logits.masked_fill(same & (own[:, None] != own), float("-inf"))
    cross_entropy = torch.nn.functional.cross_entropy
    return 0.5 * (cross_entropy(logits, own) + cross_entropy(logits.T, own))


class EvaluatorTraining:
    """An evaluator in training; it owns the networks, the input statistics and the optimiser."""

    def __init__(
        self,
        stage: str,
        config: NativeConfig | TmrConfig,
        banks: Sequence[ClipBank],
        sentences: Sentences,
        seed: int,
        device: torch.device,
    ) -> None:
        self.config, self.banks, self.sentences, self.device = config, banks, sentences, device
        self.steps, self.damage = config.training.steps, families()
        with seeded_initialisation(seed, stage):
            self.network = NativeNetwork(config.network).to(device)
            self.text = TextProjection(max(sentences.dimension, 1), config.network).to(device)
        self.mean, self.scale = self._statistics(np.random.default_rng((seed, 1)))
        parameters = [*self.network.parameters(), *self.text.parameters()]
        self.optimizer = torch.optim.AdamW(parameters, lr=0.0, weight_decay=config.training.weight_decay)

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, Tensor]:
        """One batch of one framerate and one clip length."""
        training = self.config.training
        rng = np.random.default_rng(int(torch.randint(2**62, (), generator=generator)))
        if isinstance(training, TmrTrainingConfig):
            losses = self._retrieval(training, rng, generator)
        else:
            losses = self._damage_and_captions(training, rng)
        schedule = Schedule(training.steps, kind="cosine", warmup_fraction=training.warmup_fraction)
        set_rate(self.optimizer, training.learning_rate * schedule.factor(step, training.steps))
        self.optimizer.zero_grad()
        losses["loss"].backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), training.gradient_clip)
        self.optimizer.step()
        return losses

    def state_tensors(self) -> dict[str, Tensor]:
        """Networks, statistics, optimiser."""
        return self.model_tensors() | prefixed("optimizer", optimizer_tensors(self.optimizer))

    def model_tensors(self) -> dict[str, Tensor]:
        """Networks and statistics of inputs, which `load_native` and `load_tmr` read."""
        networks = prefixed("network", self.network.state_dict()) | prefixed("text", self.text.state_dict())
        return networks | {"statistics.mean": self.mean, "statistics.scale": self.scale}

    def load_state_tensors(self, tensors: Mapping[str, Tensor]) -> None:
        """Restore a state of `state_tensors`."""
        self.network.load_state_dict(unprefixed("network", tensors))
        self.text.load_state_dict(unprefixed("text", tensors))
        self.mean = tensors["statistics.mean"].to(self.device)
        self.scale = tensors["statistics.scale"].to(self.device)
        load_optimizer_tensors(self.optimizer, unprefixed("optimizer", tensors))

    def _damage_and_captions(self, training: NativeTrainingConfig, rng: np.random.Generator) -> dict[str, Tensor]:
        """Losses of a batch of clean and damaged clips."""
        batch, drawn, fps = self._damaged(training, rng)
        embeddings = self.network(self._inputs(batch.positions, fps))
        targets = torch.from_numpy(batch.targets).to(self.device)
        strength = torch.nn.functional.smooth_l1_loss(self.network.strengths(embeddings), targets, beta=0.5)
        matching = self._matching(training, embeddings, batch.num_clean, drawn, rng)
        loss = training.strength_weight * strength + training.text_weight * matching
        return {"loss": loss, "strength": strength, "matching": matching}

    def _damaged(
        self, training: NativeTrainingConfig, rng: np.random.Generator
    ) -> tuple[SpoiledClips, DrawnClips, float]:
        """A batch of one framerate and length, most of it damaged."""
        bank = self.banks[int(rng.integers(len(self.banks)))]
        longest = min(training.max_poses, int(bank.sequences.num_frames.max()) // 4 * 4)
        num_poses = 4 * int(rng.integers(training.min_poses // 4, longest // 4 + 1))
        fps = float(bank.fps)
        margin = int(np.ceil(MARGIN_SECONDS * fps))
        drawn = bank.draw(rng, training.batch_size, num_poses, margin)
        num_clean = round(training.clean_fraction * training.batch_size)
        spoiled = spoil(drawn.positions, fps, margin, num_clean, self.damage, training.compound_fraction, rng)
        return spoiled, drawn, fps

    def _matching(
        self,
        training: NativeTrainingConfig,
        embeddings: Float[Tensor, "clips features"],
        num_clean: int,
        drawn: DrawnClips,
        rng: np.random.Generator,
    ) -> Float[Tensor, ""]:
        """Matching loss of the clean clips that have captions, one caption each."""
        rows, sentence = self.sentences.of_clips(drawn, num_clean, rng)
        if len(rows) < 2:
            return embeddings.new_zeros(())
        texts = self.text(torch.from_numpy(self.sentences.embeddings[sentence]).to(self.device))
        motions = self.network.shared(embeddings[torch.tensor(rows, device=self.device)])
        return matching_loss(motions, texts, sentence, training.text_temperature)

    def _retrieval(
        self, training: TmrTrainingConfig, rng: np.random.Generator, generator: torch.Generator
    ) -> dict[str, Tensor]:
        """TMR's loss of a batch of captioned clips."""
        positions, sentence, fps = self._captioned(training, rng)
        inputs = self._inputs(positions, fps)
        inputs = inputs + training.noise * torch.randn(inputs.shape, generator=generator).to(self.device)
        embedded = torch.from_numpy(self.sentences.embeddings[sentence]).to(self.device)
        motions, texts = self.network.shared(self.network(inputs)), self.text(embedded)
        return {"loss": retrieval_loss(motions, texts, embedded, training.temperature, training.same_above)}

    def _captioned(
        self, training: TmrTrainingConfig, rng: np.random.Generator
    ) -> tuple[Float32[np.ndarray, "pairs poses 22 3"], Int64[np.ndarray, "pairs"], float]:
        """Captioned clips of one framerate and length, and a sentence about the middle of each.

        Raises `UsageError` if many batches do not have two captioned clips.
        """
        for _ in range(MAX_DRAWS):
            bank = self.banks[int(rng.integers(len(self.banks)))]
            fps = float(bank.fps)
            seconds = rng.uniform(training.min_seconds, training.max_seconds)
            longest = min(training.max_poses, int(bank.sequences.num_frames.max()))
            drawn = bank.draw(rng, training.batch_size, int(np.clip(round(seconds * fps), MIN_POSES, longest)))
            rows, sentence = self.sentences.of_clips(drawn, training.batch_size, rng)
            if len(rows) > 1:
                return prepare(drawn.positions[rows], fps), sentence, fps
        raise UsageError(
            f"of {MAX_DRAWS} batches of {training.batch_size} clips none has two that a caption is about: caption more "
            "of the training split, or raise training.batch_size"
        )

    def _inputs(self, positions: Float32[np.ndarray, "clips poses 22 3"], fps: float) -> Tensor:
        raw = rich_input(torch.from_numpy(positions).to(self.device), fps)
        return standardised(raw, self.mean, self.scale)

    def _statistics(self, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Mean and 1 / deviation of every channel over batches of all framerates."""
        rows = []
        training = self.config.training
        for _ in range(training.statistics_batches):
            if isinstance(training, TmrTrainingConfig):
                positions, _, fps = self._captioned(training, rng)
            else:
                batch, _, fps = self._damaged(training, rng)
                positions = batch.positions
            inputs = rich_input(torch.from_numpy(positions), fps)
            rows.append(inputs.reshape(-1, inputs.shape[-1]).double())
        everything = torch.cat(rows)
        mean, deviation = everything.mean(dim=0), everything.std(dim=0)
        return mean.float().to(self.device), (1.0 / deviation.clamp_min(1e-3)).float().to(self.device)
