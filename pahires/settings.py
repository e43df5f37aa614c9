"""Settings of PA-HiRes's network; imports nothing heavy, so that stages and recipes can be listed at once."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

# calibrated: unit variance and slope; staf: STAF's code; siren: sin(x).
Initialisation = Literal["calibrated", "staf", "siren"]


@dataclass(frozen=True)
class NetworkSettings:
    """PA-HiRes's network.

    `frames_per_scale`: N_s, even, one for each of the S scales, fine to coarse. `code`: width of the latent codes z_s,
    cut into `attention_tokens` tokens; `encoder_layers`: activated layers of each F_s. `hidden`, `decoder_layers`: the
    decoder D (paper §4.1: 256, 5). `num_sines`: ζ. `shared_activation`: one σ for all layers (Table 4's ablation).
    `time_band`: the highest frequency of the Fourier features of the place within a segment, radians.
    """

    frames_per_scale: tuple[int, ...] = (2, 6, 14)
    embedding: int = 64
    code: int = 128
    encoder_layers: int = 2
    attention_tokens: int = 8
    hidden: int = 256
    decoder_layers: int = 5
    num_sines: int = 16
    shared_activation: bool = False
    initialisation: Initialisation = "calibrated"
    time_features: int = 16
    time_band: float = 8.0

    def __post_init__(self) -> None:
        scales = self.frames_per_scale
        if not scales or any(count < 2 or count % 2 for count in scales) or any(a >= b for a, b in pairwise(scales)):
            raise ValueError(f"frames_per_scale are even and grow from scale to scale, such as 2,6,14, not {scales}")
        if self.code % self.attention_tokens:
            raise ValueError(f"attention_tokens must divide code, and {self.attention_tokens} not {self.code}")
        for name in ("code", "encoder_layers", "hidden", "decoder_layers", "num_sines", "time_features"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is 1 at least, not {getattr(self, name)}")
