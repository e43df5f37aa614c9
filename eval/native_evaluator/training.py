"""Training of the native text–motion evaluator: clips of captioned motion are matched with their sentences.

A step takes clips of one framerate and one length, each inside the seconds that its sentence describes. Sequences with
a native rate below a framerate are excluded at it, those above are downsampled by the anti-aliased resampling of the
metrics' real sets. A bank is bounded in seconds, so a store of any size can be trained on.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import ceil

import numpy as np
import torch
from torch import Tensor

from eval.native_evaluator.evaluator import MIN_POSES, VERSIONS, EvaluatorNetwork, motion_input
from eval.native_evaluator.stage import EvaluatorConfig
from eval.sets.sets import Ragged
from motionkit.core.errors import UsageError
from motionkit.core.motion import Caption
from motionkit.core.progress import warn
from motionkit.core.shapes import Float, Float32, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import parse_fps
from motionkit.fields.resample import resample_positions
from motionkit.store.cache import cache_root, open_cache
from motionkit.training.config import to_plain
from motionkit.training.loop import Learner, dropout_from, run_training, save_tensors, seeded_initialisation
from motionkit.training.networks import resolve_device
from motionkit.training.run import StageContext
from motionkit.training.text import embed_texts, load_text_encoder


@dataclass(frozen=True, eq=False)
class ClipBank:
    """Described windows of motion at one framerate; `sentences` are the rows of each one's sentence embeddings."""

    fps: Fraction
    motions: Ragged
    sentences: tuple[Int64[np.ndarray, "_sentences"], ...]

    def draw(
        self, rng: np.random.Generator, num_clips: int, num_poses: int
    ) -> tuple[Float32[np.ndarray, "clips poses 22 3"], Int64[np.ndarray, "clips"]]:
        """Random clips of at most `num_poses` poses, every place equally likely, and a random sentence of each."""
        num_poses = min(num_poses, int(self.motions.num_frames.max()))
        places = np.cumsum(np.maximum(self.motions.num_frames - num_poses + 1, 0))
        place = rng.integers(places[-1], size=num_clips)
        motion = np.searchsorted(places, place, side="right")
        first = self.motions.start_row[motion] + places[motion] - 1 - place
        sentence = np.array([rng.choice(self.sentences[index]) for index in motion], dtype=np.int64)
        return self.motions.clips(first, num_poses), sentence


def build_bank(
    sequences: Ragged,
    rates: Sequence[Fraction],
    captions: Sequence[Sequence[Caption]],
    fps: Fraction,
    max_seconds: float,
    rng: np.random.Generator,
    row_of: dict[str, int],
) -> ClipBank | None:
    """A bank from captioned sequences of at least a framerate, in random order up to `max_seconds`; None without any.

    New sentences are added to `row_of`, the rows of their embeddings.
    """
    motions, sentences, seconds = [], [], 0.0
    for index in rng.permutation(len(sequences)).tolist():
        described: dict[tuple[float, float | None], list[str]] = {}
        for caption in captions[index]:
            if caption.text.strip():
                described.setdefault((caption.start_seconds, caption.end_seconds), []).append(caption.text)
        if rates[index] < fps or not described or seconds >= max_seconds:
            continue
        positions = resample_positions(np.asarray(sequences[index]), rates[index], fps)
        for (start, end), texts in described.items():
            first, last = (None if each is None else ceil(each * float(fps) - 1e-6) for each in (start, end))
            if len(described_positions := positions[first:last]) >= MIN_POSES:
                motions.append(described_positions)
                sentences.append(np.array([row_of.setdefault(text, len(row_of)) for text in texts]))
                seconds += len(described_positions) / float(fps)
    return ClipBank(fps, Ragged.of(motions), tuple(sentences)) if motions else None


def matching_loss(
    motions: Float[Tensor, "pairs shared"],
    texts: Float[Tensor, "pairs shared"],
    sentences: Float[Tensor, "pairs text"],
    temperature: float,
    same_above: float,
) -> Float[Tensor, ""]:
    """Symmetric InfoNCE on −d²/(2·temperature), d the distance of a motion and a text; of unit vectors that is TMR's.

    Other pairs whose sentences score above `same_above` (½ + ½ · cosine) are excluded. Distances, because the metrics
    that use these embeddings (R-Precision, MM-Dist) are Euclidean.
    """
    logits = -(torch.cdist(texts, motions) ** 2) / (2.0 * temperature)
    unit = torch.nn.functional.normalize(sentences, dim=1)
    own = torch.eye(len(logits), dtype=torch.bool, device=logits.device)
    logits = logits.masked_fill((unit @ unit.T > 2.0 * same_above - 1.0) & ~own, float("-inf"))
    target = torch.arange(len(logits), device=logits.device)
    cross_entropy = torch.nn.functional.cross_entropy
    return 0.5 * (cross_entropy(logits, target) + cross_entropy(logits.T, target))


class EvaluatorTraining:
    """A `motionkit.training.loop.Trainable`: an evaluator's network, trained on banks of clips and their sentences."""

    def __init__(
        self,
        config: EvaluatorConfig,
        banks: Sequence[ClipBank],
        sentences: Float32[np.ndarray, "sentences text"],
        network: EvaluatorNetwork,
        device: torch.device,
    ) -> None:
        self.config, self.banks, self.device = config, banks, device
        self.steps, self.network = config.schedule.num_steps(1), network.to(device)
        self.sentences = torch.from_numpy(sentences).to(device)
        optimizer = torch.optim.AdamW(network.parameters(), lr=0.0, weight_decay=config.training.weight_decay)
        self.learner = Learner(network, optimizer)
        self.state_tensors, self.load_state_tensors = self.learner.state_tensors, self.learner.load_state_tensors

    def standardise_by(self, rng: np.random.Generator) -> None:
        """Set the network's statistics to those of some batches of all framerates."""
        batches = [self._draw(rng)[0].flatten(0, 1).double() for _ in range(self.config.training.statistics_batches)]
        rows = torch.cat(batches)
        self.network.mean.copy_(rows.mean(dim=0))
        self.network.scale.copy_(1.0 / rows.std(dim=0).clamp_min(1e-3))

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, Tensor]:
        """One optimiser step on clips of one framerate and length."""
        training, schedule = self.config.training, self.config.schedule
        rng = np.random.default_rng(int(torch.randint(2**62, (), generator=generator)))
        raw, sentences = self._draw(rng)
        noise = training.noise * torch.randn(raw.shape, generator=generator)
        inputs = self.network.standardised(raw.to(self.device)) + noise.to(self.device)
        with dropout_from(generator, self.device):
            motions, texts = self.network.embed_motions(inputs), self.network.embed_texts(sentences)
        loss = matching_loss(motions, texts, sentences, training.temperature, training.same_above)
        rate = schedule.factor(step, self.steps) * schedule.learning_rate
        self.learner.descend(loss, step, rate, training.gradient_clip)
        return {"loss": loss.detach()}

    def _draw(self, rng: np.random.Generator) -> tuple[Float[Tensor, "clips poses channels"], Tensor]:
        """Inputs of random clips, and their sentences' embeddings."""
        training, bank = self.config.training, self.banks[int(rng.integers(len(self.banks)))]
        seconds = rng.uniform(training.min_seconds, training.max_seconds)
        num_poses = int(np.clip(round(seconds * float(bank.fps)), MIN_POSES, training.max_poses))
        clips, rows = bank.draw(rng, self.config.schedule.batch_size, num_poses)
        return motion_input(clips, float(bank.fps)), self.sentences[torch.from_numpy(rows).to(self.device)]


def train_evaluator(stage: str, context: StageContext, config: EvaluatorConfig) -> None:
    """Train an evaluator on the captions of the context's store; writes RUN/STAGE/model.safetensors.

    On a store without captions there is nothing to learn: the stage ends with a warning. Raises `UsageError` for one
    whose framerates are all lower than those of the settings.
    """
    store, training = context.open_store(), config.training
    cache = open_cache(store, layout=SMPL22.name, where=training.where or None)
    rows = store.sequences_table["captions"].take(store.rows_of(cache.sequence_index)).to_pylist()
    captions = [[Caption(**caption) for caption in some] for some in rows]
    rates = list(map(cache.exact_fps, range(len(captions))))
    folder = context.begin(stage, config, store_fingerprint=store.fingerprint)
    if not any(caption.text.strip() for some in captions for caption in some):
        warn(f"{folder.path}: the training split has no captions, which an evaluator of text and motion learns from")
        save_tensors(folder.model_path, {}, {"version": VERSIONS[stage]})
        folder.finish({"steps": 0, "sentences": 0})
        return
    sequences = Ragged(cache.positions, cache.start_row, cache.num_frames.astype(np.int64))
    row_of: dict[str, int] = {}
    banks = []
    for fps in map(parse_fps, training.framerates):
        rng = np.random.default_rng((context.seed, fps.numerator, fps.denominator))
        if bank := build_bank(sequences, rates, captions, fps, training.bank_seconds, rng, row_of):
            banks.append(bank)
    if not banks:
        highest = float(max(rates))
        raise UsageError(
            f"no captioned sequence reaches {min(training.framerates):g} fps, the lowest that the evaluator is trained "
            f"at (the highest framerate is {highest:g}): name lower ones with --set training.framerates={highest:g}"
        )
    encoder = load_text_encoder(training.text_encoder)
    sentences = embed_texts(encoder, list(row_of), cache_root(store.path, store.fingerprint))
    with seeded_initialisation(context.seed, stage):
        network = EvaluatorNetwork(config.network, encoder.dimension)
    trainable = EvaluatorTraining(config, banks, sentences, network, resolve_device(context.device))
    trainable.standardise_by(np.random.default_rng((context.seed, 1)))
    latest = run_training(context, trainable, folder)
    header = {
        "version": VERSIONS[stage],
        "config": to_plain(config),
        "store_fingerprint": store.fingerprint,
        "framerates": [str(bank.fps) for bank in banks],
        "text_encoder": encoder.name,
        "text_encoder_fingerprint": encoder.fingerprint,
        "text_dimension": encoder.dimension,
    }
    save_tensors(folder.model_path, trainable.learner.trained_tensors(), header)
    counts = {"steps": trainable.steps, "sequences": len(sequences), "sentences": len(sentences)}
    folder.finish({**latest, **counts, "fps": header["framerates"]})
