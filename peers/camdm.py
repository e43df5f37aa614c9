"""CAMDM (Chen et al. 2024; AIGAnimation/CAMDM, PyTorch/network): autoregressive diffusion of segments in four steps."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Bool, Float
from motionkit.training.config import DiffusionConfig, Schedule
from motionkit.training.networks import Conditions
from peers import layers
from peers.generating import CLIP, MINILM, SMALL, PeerConfig, PeerStage, cosine
from peers.layers import ConditionVector, NetworkInputs, PeerNetwork, Steps, TransformerSizes, positions, sinusoids
from peers.motions import MotionBatch, MotionsConfig, Rows, SampleBatch

# Ankle and foot joints of the 22-joint skeleton; a foot that moves less than this per frame (metres) is in contact.
FEET, CONTACT_METRES = (7, 10, 8, 11), 0.01


@dataclass(frozen=True)
class CamdmNetworkConfig:
    """CAMDM: predicts `future` frames from `past` ones, which are dropped with probability `no_past`."""

    transformer: TransformerSizes = TransformerSizes(4, 256, 4, 1024)
    past: int = 10
    future: int = 45
    no_past: float = 0.15
    diffusion: DiffusionConfig = DiffusionConfig(
        num_steps=4, schedule="cosine", prediction="latent", sampler="ddpm", sampling_steps=4, guidance_scale=1.0
    )


class Camdm(PeerNetwork):
    """CAMDM: predicts x̂₀ of future frames with a transformer over [time; condition; past frames; noisy frames]."""

    def __init__(self, config: CamdmNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        width = config.transformer.width
        self.config, self.diffusion, self.width = config, config.diffusion, width
        self.space, self.numbers = inputs.space, inputs.space.num_features
        self.frame_in, self.past_in = nn.Linear(self.numbers, width), nn.Linear(self.numbers, width)
        self.no_past = nn.Parameter(torch.zeros(width))
        self.condition = ConditionVector(inputs.conditions, width)
        self.step_in = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.dropout = nn.Dropout(config.transformer.dropout)
        self.layers = layers.encoder(config.transformer)
        self.frame_out = nn.Linear(width, self.numbers)

    def forward(
        self,
        noisy: Rows,
        steps: Steps,
        conditions: Conditions,
        past: Float[Tensor, "batch past numbers"],
        has_past: Bool[Tensor, "batch"],
    ) -> Rows:
        """The clean frames that follow `past`; rows without `has_past` start a motion."""
        time = self.step_in(sinusoids(steps, self.width))
        before = torch.where(has_past[:, None, None], self.past_in(past), self.no_past)
        first = torch.stack((time, self.condition(conditions)), dim=1)
        tokens = torch.cat((first, before, self.frame_in(noisy)), dim=1)
        tokens = self.layers(self.dropout(tokens + positions(tokens)))
        clean: Tensor = self.frame_out(tokens[:, -noisy.shape[1] :])
        return clean

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Squared errors of pose vectors, joints, their frame differences, and the velocity of feet in contact."""
        past, clean = batch.rows[:, : self.config.past], batch.rows[:, self.config.past :]
        mask = batch.mask[:, self.config.past :]
        has_past = (torch.rand(len(past), generator=batch.generator) >= self.config.no_past).to(past.device)
        noisy, steps, _ = layers.noised(clean, self.config.diffusion, batch.generator)
        predicted = self(noisy * mask[..., None], steps, batch.conditions, past, has_past)
        both = mask[:, 1:] & mask[:, :-1]
        joints, truth = self.space.joints(predicted), self.space.joints(clean)
        moved, true_moved = joints.diff(dim=1), truth.diff(dim=1)
        contact = (true_moved[:, :, FEET].norm(dim=-1) <= CONTACT_METRES) & both[..., None]
        terms = {
            "pose": (predicted - clean)[mask].square().mean(),
            "pose_change": (predicted.diff(dim=1) - clean.diff(dim=1))[both].square().mean(),
            "joints": (joints - truth)[mask].square().mean(),
            "joint_change": (moved - true_moved)[both].square().mean(),
            "feet": (moved[:, :, FEET].square().sum(dim=-1) * contact).sum() / contact.sum().clamp(min=1),
        }
        return {"loss": torch.stack(list(terms.values())).sum(), **terms}

    def sample(self, batch: SampleBatch) -> Rows:
        """Standardised rows, segment after segment."""
        count, past = len(batch.lengths), self.config.past
        rows = torch.zeros((count, past, self.numbers), device=batch.device)
        for start in range(0, batch.frames, self.config.future):
            has_past = torch.full((count,), start > 0, device=batch.device)
            network = layers.with_inputs(self, rows[:, -past:], has_past)
            segment = layers.diffusion_sample(network, batch, lambda: batch.noise(self.config.future, self.numbers))
            rows = torch.cat((rows, segment.float()), dim=1)
        return rows[:, past : past + batch.frames]


SEGMENTS, PUBLISHED = MotionsConfig(fps=30.0, max_frames=294, sampled_frames=55), Schedule(epochs=100, batch_size=512)
SIZES, MINILM_15, CLIP_15 = CamdmNetworkConfig(SMALL), replace(MINILM, drop=0.15), replace(CLIP, drop=0.15)
NANO = PeerConfig(SIZES, cosine(6000, 64, 3e-3), MINILM_15, SEGMENTS, precision="auto", ema_decay=0.995)
PAPER = PeerConfig(CamdmNetworkConfig(), PUBLISHED, CLIP_15, SEGMENTS, weight_decay=0.01)
CAMDM = PeerStage("camdm", Camdm, NANO, PAPER)
