"""Settings of the stage `codebook` (no torch)."""

from dataclasses import dataclass

from motionkit.timegrid import parse_fps
from motionkit.training.config import Precision


@dataclass(frozen=True)
class CodebookConfig:
    """The VQ-VAE whose codes enrich the coordinates: T2M-GPT's (Zhang et al. 2023a; appendix B.1).

    `published_weights` names T2M-GPT's own checkpoint, which is then taken instead of trained, whatever the sizes here;
    `published_statistics` the folder of its mean.npy and std.npy (the evaluator's), which the field doesn't need.
    """

    fps: int = 20
    window_frames: int = 64
    width: int = 512
    code_dimension: int = 512
    num_codes: int = 512
    residual_layers: int = 3
    ema_decay: float = 0.99
    reset_below: float = 1.0
    position_weight: float = 0.5
    commitment_weight: float = 0.02
    steps: int = 300_000
    batch: int = 256
    rate: float = 2e-4
    rate_drop_at: int = 200_000
    rate_drop: float = 0.05
    weight_decay: float = 0.0
    precision: Precision = "float32"
    published_weights: str = ""
    published_statistics: str = ""
    where: str = "split = 'train'"

    def __post_init__(self) -> None:
        parse_fps(self.fps)
        for name in ("window_frames", "batch", "steps"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)}")
