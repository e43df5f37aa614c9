"""Settings of a diffusion process (no torch)."""

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

from motionkit.core.errors import UsageError

NoiseSchedule = Literal["scaled_linear", "cosine"]
Prediction = Literal["noise", "latent", "velocity"]
LossMeasure = Literal["noise", "latent", "velocity", "min_snr"]
Sampler = Literal["ddim", "ddpm"]
SAMPLERS: tuple[Sampler, ...] = get_args(Sampler)


@dataclass(frozen=True)
class DiffusionConfig:
    """The process, the network's prediction, and the sampler; the defaults are the paper's (Eq. 5, B.1).

    The paper's "scaled linearly" is linear in √β, as in latent diffusion models; "cosine" is Nichol & Dhariwal's
    (2021), which ignores `beta_start` and `beta_end`. `prediction` is the network's output: the noise ε (the paper),
    the clean latent z, or the velocity √ᾱ ε − √(1 − ᾱ) z (Salimans & Ho 2022); `loss` is the quantity whose squared
    error is minimised, for any output ("min_snr": that of z, weighted by min(SNR, 5); Hang et al. 2023).

    With `sampling_spacing` "trailing" inference starts at the noisiest step, which z_K ~ N(0, I) corresponds to;
    "leading" (offset 1) starts up to num_steps / sampling_steps earlier, as in motion-latent-diffusion.
    `guidance_scale` is r of Eq. 6.
    """

    num_steps: int = 1000
    schedule: NoiseSchedule = "scaled_linear"
    beta_start: float = 8.5e-4
    beta_end: float = 0.012
    prediction: Prediction = "noise"
    loss: LossMeasure = "noise"
    sampler: Sampler = "ddim"
    sampling_steps: int = 50
    sampling_spacing: Literal["trailing", "leading"] = "trailing"
    guidance_scale: float = 7.5

    def __post_init__(self) -> None:
        if not 0 < self.beta_start <= self.beta_end < 1:
            raise ValueError(f"betas must rise inside (0, 1), not from {self.beta_start} to {self.beta_end}")
        if not 1 <= self.sampling_steps <= self.num_steps:
            raise ValueError(f"sampling_steps must lie in 1 … {self.num_steps}, not {self.sampling_steps}")

    def adjusted(self, sampler: str | None, steps: int | None, guidance_scale: float | None) -> "DiffusionConfig":
        """These settings with other sampling options (None: unchanged); raises `UsageError` for invalid ones."""
        steps = self.sampling_steps if steps is None else steps
        if not 1 <= steps <= self.num_steps:
            raise UsageError(f"{steps} sampling steps: this model's diffusion has 1 … {self.num_steps}")
        chosen = next((each for each in SAMPLERS if each == (sampler or self.sampler)), None)
        if chosen is None:
            raise UsageError(f"no sampler is called {sampler!r}; there are {', '.join(SAMPLERS)}")
        scale = self.guidance_scale if guidance_scale is None else guidance_scale
        if not math.isfinite(scale):
            raise UsageError(f"a guidance scale must be a finite number (1: no guidance), not {scale}")
        return replace(self, sampler=chosen, sampling_steps=steps, guidance_scale=scale)
