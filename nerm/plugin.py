"""NeRM's stages, its model, motion encoder, ablations and the runs that it ships (`motionkit.core.plugins`)."""

from pathlib import Path

from motionkit.core.plugins import lazily
from motionkit.training.run import Loader

STAGES = {"codebook": "nerm.recipes:CODEBOOK", "field": "nerm.recipes:FIELD", "denoiser": "nerm.recipes:DENOISER"}
ALL = tuple(STAGES)
MODELS = {
    "nerm": Loader("NeRM", ("field", "denoiser"), lazily("nerm.model:load"), fixed_fps_setting="field.clips.fixed_fps")
}
ENCODERS = {"nerm": Loader("NeRM", ("field",), lazily("nerm.encoding:load"), tasks=("reconstruction",))}
ABLATIONS = {"nerm": "nerm.recipes:NERM"}
# `motionkit pack` writes them.
RUNS = {summary.parents[1].name: summary.parents[1] for summary in Path(__file__).parent.glob("runs/*/*/summary.json")}
