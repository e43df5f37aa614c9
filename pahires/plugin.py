"""PA-HiRes: its stage, its motion encoder and its ablations (`motionkit.core.plugins`)."""

from motionkit.core.plugins import lazily
from motionkit.training.run import Loader

STAGES = {"pahires": "pahires.stage:STAGE"}
ENCODERS = {"pahires": Loader("PA-HiRes", ("pahires",), lazily("pahires.stage:load"), preferred=True)}
ABLATIONS = {"pahires": "pahires.ablations:PAHIRES"}
