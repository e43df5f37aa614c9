"""NeRM as other packages find it: a generative model (`motionkit.models`) and a motion encoder (`motionkit.encoders`).

Nothing heavy is imported before something is loaded.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from motionkit.complete.encoders import EncoderLoader
from motionkit.generate.models import ModelLoader

if TYPE_CHECKING:
    from nerm.field.motion_encoder import NermEncoder
    from nerm.model import NermModel


def _load_model(run: Path) -> "NermModel":
    from nerm.model import load

    return load(run)


def _load_encoder(run: Path) -> "NermEncoder":
    from nerm.field.motion_encoder import load

    return load(run)


MODEL = ModelLoader("NeRM", ("field", "denoiser"), _load_model, order=30, fixed_fps_setting="field.clips.fixed_fps")
ENCODER = EncoderLoader(
    "NeRM (latents by optimisation)", ("field",), _load_encoder, order=90, tasks=("reconstruction",)
)
