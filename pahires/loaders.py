"""Entry point of PA-HiRes: a motion encoder (`motionkit.encoders`)."""

from pathlib import Path

from motionkit.edit.encoders import EncoderLoader
from motionkit.fields.motion_field import MotionEncoder
from pahires.recipes import PaHiResConfig
from pahires.stage import STAGE, make_network
from pahires.temporal.stage import load_encoder

NAME = "PA-HiRes"


def load(run: Path) -> MotionEncoder:
    """Load a run's trained PA-HiRes; raises `RunError` or `CheckpointError` if there is none."""
    return load_encoder(run, STAGE.name, PaHiResConfig, make_network, NAME)


ENCODER = EncoderLoader(NAME, (STAGE.name,), load, order=STAGE.order, preferred=True)
