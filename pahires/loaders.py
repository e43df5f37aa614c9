"""PA-HiRes as other packages find it: a motion encoder (`motionkit.encoders`)."""

from motionkit.complete.encoders import EncoderLoader
from pahires.stage import NAME, STAGE, load

ENCODER = EncoderLoader(NAME, (STAGE.name,), load, order=STAGE.order, preferred=True)
