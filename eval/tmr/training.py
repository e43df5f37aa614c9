"""Training of the TMR-style evaluator: pairs of motion and sentence against all other pairs of a batch.

TMR's contrastive loss: InfoNCE on cosines, in which pairs with nearly the same sentence are not negatives of each other
(Petrovich et al. 2023; src/model/losses.py of Mathux/TMR @ 6d74688). Its decoder, reconstruction loss and Gaussian
latents are left out: they serve generation.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from eval.native_evaluator.bank import ClipBank
from eval.native_evaluator.network import MIN_POSES, NativeNetwork, TextProjection, prepare, rich_input, standardised
from eval.native_evaluator.training import Sentences, symmetric_cross_entropy
from eval.tmr.settings import TmrConfig
from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float, Float32, Float64, Int64
from motionkit.training.config import rate_factor
from motionkit.training.loop import seeded_initialisation, set_rate
from motionkit.training.tensors import load_optimizer_tensors, optimizer_tensors, prefixed, unprefixed

MAX_DRAWS = 100
"""Batches that are drawn for two captioned clips before captions are reported as too rare."""


def retrieval_loss(
    motions: Float[Tensor, "pairs shared"],
    texts: Float[Tensor, "pairs shared"],
    sentences: Float[Tensor, "pairs text"],
    temperature: float,
    same_above: float,
) -> Float[Tensor, ""]:
    """Symmetric InfoNCE on cosines; other pairs whose sentences score above `same_above` are excluded."""
    normalize = torch.nn.functional.normalize
    logits = normalize(texts, dim=1) @ normalize(motions, dim=1).T / temperature
    unit = normalize(sentences, dim=1)
    return symmetric_cross_entropy(logits, unit @ unit.T > 2.0 * same_above - 1.0)


class TmrTraining:
    """The evaluator in training; it owns the networks, the input statistics and the optimiser."""

    def __init__(
        self, config: TmrConfig, banks: Sequence[ClipBank], sentences: Sentences, seed: int, device: torch.device
    ) -> None:
        self.config, self.banks, self.sentences, self.device = config, banks, sentences, device
        with seeded_initialisation(seed, "tmr"):
            self.network = NativeNetwork(config.network).to(device)
            self.text = TextProjection(sentences.dimension, config.network).to(device)
        self.mean, self.scale = self._statistics(np.random.default_rng((seed, 1)))
        parameters = [*self.network.parameters(), *self.text.parameters()]
        self.optimizer = torch.optim.AdamW(parameters, lr=0.0, weight_decay=config.training.weight_decay)

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, Tensor]:
        """One batch of one framerate and one duration."""
        training = self.config.training
        rng = np.random.default_rng(int(torch.randint(2**62, (), generator=generator)))
        positions, sentence, fps = self._pairs(rng)
        inputs = standardised(rich_input(torch.from_numpy(positions).to(self.device), fps), self.mean, self.scale)
        inputs = inputs + training.noise * torch.randn(inputs.shape, generator=generator).to(self.device)
        said = torch.from_numpy(self.sentences.embeddings[sentence]).to(self.device)
        motions, texts = self.network.shared(self.network(inputs)), self.text(said)
        loss = retrieval_loss(motions, texts, said, training.temperature, training.same_above)
        factor = rate_factor(step, training.steps, schedule="cosine", warmup_fraction=training.warmup_fraction)
        set_rate(self.optimizer, training.learning_rate * factor)
        self.optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), training.gradient_clip)
        self.optimizer.step()
        return {"loss": loss}

    def state_tensors(self) -> dict[str, Tensor]:
        """Networks, statistics, optimiser."""
        return self.model_tensors() | prefixed("optimizer", optimizer_tensors(self.optimizer))

    def model_tensors(self) -> dict[str, Tensor]:
        """Networks and statistics; embeddings keep their scale."""
        networks = prefixed("network", self.network.state_dict()) | prefixed("text", self.text.state_dict())
        whitening = torch.eye(self.config.network.embedding)
        return networks | {
            "statistics.mean": self.mean,
            "statistics.scale": self.scale,
            "statistics.whitening": whitening,
        }

    def load_state_tensors(self, tensors: Mapping[str, Tensor]) -> None:
        """Restore a state of `state_tensors`."""
        self.network.load_state_dict(unprefixed("network", tensors))
        self.text.load_state_dict(unprefixed("text", tensors))
        self.mean = tensors["statistics.mean"].to(self.device)
        self.scale = tensors["statistics.scale"].to(self.device)
        load_optimizer_tensors(self.optimizer, unprefixed("optimizer", tensors))

    def _pairs(
        self, rng: np.random.Generator
    ) -> tuple[Float32[np.ndarray, "pairs poses 22 3"], Int64[np.ndarray, "pairs"], float]:
        """Captioned clips of one framerate and length, and a sentence about the middle of each.

        Raises `UsageError` if many batches do not have two captioned clips.
        """
        for _ in range(MAX_DRAWS):
            positions, sentence, fps = self._captioned(rng)
            if len(sentence) > 1:
                return prepare(positions, fps), sentence, fps
        training = self.config.training
        raise UsageError(
            f"of {MAX_DRAWS} batches of {training.batch_size} clips none has two that a caption is about: caption more "
            "of the training split, or raise training.batch_size"
        )

    def _captioned(
        self, rng: np.random.Generator
    ) -> tuple[Float64[np.ndarray, "pairs poses 22 3"], Int64[np.ndarray, "pairs"], float]:
        """The captioned clips of one random batch."""
        training = self.config.training
        bank = self.banks[int(rng.integers(len(self.banks)))]
        fps = float(bank.fps)
        seconds = rng.uniform(training.min_seconds, training.max_seconds)
        longest = min(training.max_poses, int(bank.sequences.num_frames.max()))
        num_poses = int(np.clip(round(seconds * fps), MIN_POSES, longest))
        drawn = bank.draw(rng, training.batch_size, num_poses)
        places = zip(drawn.take.tolist(), drawn.centre_seconds.tolist(), strict=True)
        about = [self.sentences.about(take, second) for take, second in places]
        rows = [row for row, found in enumerate(about) if len(found)]
        sentence = np.array([rng.choice(about[row]) for row in rows], dtype=np.int64)
        return drawn.positions[rows], sentence, fps

    def _statistics(self, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Mean and 1 / deviation of every channel over clips of all framerates."""
        rows = []
        for _ in range(self.config.training.statistics_batches):
            positions, _, fps = self._pairs(rng)
            inputs = rich_input(torch.from_numpy(positions), fps)
            rows.append(inputs.reshape(-1, inputs.shape[-1]).double())
        everything = torch.cat(rows)
        mean, deviation = everything.mean(dim=0), everything.std(dim=0)
        return mean.float().to(self.device), (1.0 / deviation.clamp_min(1e-3)).float().to(self.device)
