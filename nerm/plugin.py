"""NeRM's stages, its model and motion encoder and ablations (`motionkit.core.plugins`)."""

from motionkit.core.plugins import lazily
from motionkit.training.run import Loader

STAGES = {"codebook": "nerm.recipes:CODEBOOK", "field": "nerm.recipes:FIELD", "denoiser": "nerm.recipes:DENOISER"}
ALL = tuple(STAGES)
MODELS = {
    "nerm": Loader("NeRM", ("field", "denoiser"), lazily("nerm.model:load"), fixed_fps_setting="field.clips.fixed_fps")
}
ENCODERS = {"nerm": Loader("NeRM", ("field",), lazily("nerm.encoding:load"), tasks=("reconstruction",))}
ABLATIONS = {"nerm": "nerm.recipes:NERM"}
