"""PA-HiRes: its stage, its motion encoder and its ablations (`motionkit.core.plugins`)."""

from functools import partial

from motionkit.core.plugins import lazily
from motionkit.training.run import Loader

TITLE = "PA-HiRes"
STAGES = {"pahires": "pahires.model:SYSTEM.stage"}
ENCODERS = {
    "pahires": Loader(TITLE, ("pahires",), partial(lazily("pahires.model:SYSTEM.load"), title=TITLE), preferred=True)
}
ABLATIONS = {"pahires": "pahires.ablations:PAHIRES"}
