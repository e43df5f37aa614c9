"""Training the VQ-VAE on the store resampled to 20 fps (T2M-GPT, train_vq.py)."""

from collections.abc import Mapping

import torch
from torch.nn.functional import smooth_l1_loss

from motionkit.core.shapes import Float32, Int64
from motionkit.training.devices import ALONE, Ranks, autocast
from motionkit.training.loop import seeded_initialisation, set_rate
from motionkit.training.tensors import load_training_tensors, training_tensors
from nerm.codebook.network import CodebookNetwork
from nerm.codebook.vectors import VectorCorpus, joint_positions_block
from nerm.settings import CodebookConfig


class CodebookTraining:
    """A `motionkit.training.loop.Trainable`: the VQ-VAE with its optimiser."""

    def __init__(
        self, corpus: VectorCorpus, config: CodebookConfig, *, seed: int, device: torch.device, ranks: Ranks = ALONE
    ) -> None:
        self.corpus, self.config, self.device, self.ranks = corpus, config, device, ranks
        with seeded_initialisation(seed, "codebook"):
            self.network = CodebookNetwork(config.network, len(corpus.mean)).to(device)
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(),
            lr=config.schedule.learning_rate,
            betas=(0.9, 0.99),
            weight_decay=config.schedule.weight_decay,
        )
        self.steps = config.schedule.steps
        self.positions = joint_positions_block((len(corpus.mean) - 1) // 6)

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, torch.Tensor]:
        """SmoothL1 + 0.5·SmoothL1 of joint positions + 0.02·commitment, then update the codes' moving averages."""
        config, schedule, quantiser = self.config, self.config.schedule, self.network.quantiser
        starts = torch.randint(len(self.corpus.first_rows), (schedule.batch_size,), generator=generator)
        starts = starts[self.ranks.rows_of(schedule.batch_size)]
        share = len(starts) / schedule.batch_size
        vectors = self.corpus.windows(starts, config.window_frames).to(self.device)
        with autocast(config.precision, self.device):
            features = self.network.encode(vectors).float()
        everywhere = self.ranks.all_rows(features.detach(), schedule.batch_size)
        quantiser.start(everywhere, generator)
        quantised = quantiser(features)
        with autocast(config.precision, self.device):
            decoded = self.network.decode(quantised.values).float()
        reconstruction = smooth_l1_loss(decoded, vectors)
        positions = smooth_l1_loss(decoded[..., self.positions], vectors[..., self.positions])
        terms = reconstruction + config.loss.position_weight * positions
        loss = share * (terms + config.loss.commitment_weight * quantised.commitment)
        self.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        dropped = step * schedule.steps >= schedule.drop_at * self.steps
        set_rate(self.optimizer, schedule.learning_rate * (schedule.drop if dropped else 1.0))
        self.ranks.add_up_gradients(self.network.parameters())
        self.optimizer.step()
        which = self.ranks.all_rows(quantised.which, schedule.batch_size)
        quantiser.update(everywhere, which, generator)
        return {
            "loss": loss,
            "reconstruction": share * reconstruction,
            "commitment": share * quantised.commitment,
            "perplexity": share * perplexity(which, config.network.num_codes),
        }

    def state_tensors(self) -> dict[str, torch.Tensor]:
        """Weights, codes and moments."""
        return training_tensors("network", self.network, self.optimizer)

    def load_state_tensors(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Restore what `state_tensors` returned."""
        load_training_tensors("network", self.network, self.optimizer, tensors)


def perplexity(which: Int64[torch.Tensor, "*shape"], num_codes: int) -> Float32[torch.Tensor, ""]:
    """exp of the entropy of the codes' use: the effective number of codes."""
    shares = torch.bincount(which.reshape(-1), minlength=num_codes).float() / which.numel()
    return torch.exp(-torch.xlogy(shares, shares).sum())
