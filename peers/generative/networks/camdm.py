"""CAMDM (Chen et al. 2024; AIGAnimation/CAMDM, PyTorch/network): stretches of motion after what was, in four steps."""

from collections.abc import Mapping

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor, nn

from motionkit.training.diffusion.settings import DiffusionConfig
from peers.generative.batches import Conditions, ConditionSizes, MotionBatch, PoseSpace, Wanted
from peers.generative.networks.layers import (
    ConditionVector,
    diffusion_sample,
    encoder_layer,
    noisy_at_random,
    sinusoids,
)
from peers.generative.settings import CamdmNetworkConfig

# Ankles and feet of the 22 joints; a true one that moves less in a frame than this, in metres, stands.
FEET, STANDS_METRES = (7, 10, 8, 11), 0.01


class Camdm(nn.Module):
    """x̂₀ of the frames to come, from a transformer encoder over [time; condition; frames before; noisy frames]."""

    def __init__(
        self, config: CamdmNetworkConfig, space: PoseSpace, sizes: ConditionSizes, earlier: Mapping[str, nn.Module]
    ) -> None:
        super().__init__()
        width = config.transformer.width
        self.config, self.diffusion, self.space, self.width = config, config.diffusion, space, width
        self.numbers = space.num_numbers
        self.frame_in, self.past_in = nn.Linear(self.numbers, width), nn.Linear(self.numbers, width)
        self.no_past = nn.Parameter(torch.zeros(width))
        self.condition = ConditionVector(sizes, width)
        self.step_in = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.dropout = nn.Dropout(config.transformer.dropout)
        self.layers = nn.TransformerEncoder(
            encoder_layer(config.transformer), config.transformer.layers, enable_nested_tensor=False
        )
        self.frame_out = nn.Linear(width, self.numbers)

    def forward(
        self,
        noisy: Float[Tensor, "batch frames numbers"],
        steps: Int64[Tensor, "batch"],
        conditions: Conditions,
        past: Float[Tensor, "batch past numbers"],
        has_past: Bool[Tensor, "batch"],
    ) -> Float[Tensor, "batch frames numbers"]:
        """The clean frames after `past`, which a motion's first frames do not have."""
        time = self.step_in(sinusoids(steps, self.width))
        before = torch.where(has_past[:, None, None], self.past_in(past), self.no_past)
        first = torch.stack((time, self.condition(conditions)), dim=1)
        tokens = torch.cat((first, before, self.frame_in(noisy)), dim=1)
        positions = sinusoids(torch.arange(tokens.shape[1], device=tokens.device), self.width)
        tokens = self.layers(self.dropout(tokens + positions))
        clean: Tensor = self.frame_out(tokens[:, -noisy.shape[1] :])
        return clean

    def losses(self, batch: MotionBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Squared errors of numbers, joints and the differences of both from frame to frame, and of standing feet."""
        past, clean = batch.rows[:, : self.config.past], batch.rows[:, self.config.past :]
        seen = batch.seen[:, self.config.past :]
        has_past = (torch.rand(len(past), generator=generator) >= self.config.no_past).to(past.device)
        noisy, steps, _ = noisy_at_random(clean, self.diffusion, generator)
        made = self(noisy * seen[..., None], steps.to(clean.device), batch.conditions, past, has_past)
        both = seen[:, 1:] & seen[:, :-1]
        joints, truth = self.space.joints(made), self.space.joints(clean)
        moved, truly = _differences(joints), _differences(truth)
        stands = (truly[:, :, FEET].norm(dim=-1) <= STANDS_METRES) & both[..., None]
        terms = {
            "pose": (made - clean)[seen].square().mean(),
            "pose_change": (_differences(made) - _differences(clean))[both].square().mean(),
            "joints": (joints - truth)[seen].square().mean(),
            "joint_change": (moved - truly)[both].square().mean(),
            "feet": (moved[:, :, FEET].square().sum(dim=-1) * stands).sum() / stands.sum().clamp(min=1),
        }
        return {"loss": torch.stack(list(terms.values())).sum(), **terms}

    def sample(self, wanted: Wanted, diffusion: DiffusionConfig) -> Float[Tensor, "batch frames numbers"]:
        """Standardised rows, stretch after stretch."""
        count, size = len(wanted.lengths), (self.config.future, self.numbers)
        rows = torch.zeros((count, self.config.past, self.numbers), device=wanted.device)
        for begun in range(0, wanted.frames, self.config.future):
            past = rows[:, -self.config.past :]
            has_past = torch.full((count,), begun > 0, device=wanted.device)

            def output(
                noisy: Tensor, steps: Tensor, told: Conditions, past: Tensor = past, has_past: Tensor = has_past
            ) -> Tensor:
                times = len(noisy) // count
                clean: Tensor = self(noisy, steps, told, past.repeat(times, 1, 1), has_past.repeat(times))
                return clean

            made = diffusion_sample(output, wanted, lambda: wanted.noise(*size), diffusion)
            rows = torch.cat((rows, made.to(wanted.device, torch.float32)), dim=1)
        return rows[:, self.config.past : self.config.past + wanted.frames]


def _differences(values: Float[Tensor, "batch frames *rest"]) -> Float[Tensor, "batch gaps *rest"]:
    return values[:, 1:] - values[:, :-1]
