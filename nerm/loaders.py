"""Entry points of NeRM: a generative model (`motionkit.models`) and a motion encoder (`motionkit.encoders`).

Heavy imports are deferred until one is loaded.
"""

from motionkit.edit.encoders import EncoderLoader
from motionkit.generate.models import ModelLoader
from motionkit.training.stage import lazily

MODEL = ModelLoader(
    "NeRM", ("field", "denoiser"), lazily("nerm.model:load"), order=30, fixed_fps_setting="field.clips.fixed_fps"
)
ENCODER = EncoderLoader(
    "NeRM",
    ("field",),
    lazily("nerm.field.motion_encoder:load"),
    order=90,
    tasks=("reconstruction",),
)
