"""Human motion at native framerates: what a motion is, how it gets in and out, where it rests, what continues it.

    import motionkit as mk

    motion = mk.read("walk.bvh")
    motion[1.5:2.0].resample(60).save("step.glb")

docs/python.md shows all of it. Names are imported when they are first used, so importing motionkit is quick. What is
imported from deeper modules is for those who extend motionkit (docs/extending.md).
"""

from typing import TYPE_CHECKING

from motionkit.core.late_functions import provide
from motionkit.core.public_names import give_names
from motionkit.core.version import __version__

if TYPE_CHECKING:
    from motionkit.completing.motion import complete
    from motionkit.errors import FormatError, MotionkitError, UsageError
    from motionkit.formats.writing import write
    from motionkit.generate.motion_model import MotionModel, generate, load_model
    from motionkit.generation import SamplingOptions
    from motionkit.motion import Caption, Motion
    from motionkit.named_motions.reading import read, read_all
    from motionkit.resample import resample
    from motionkit.skeleton import KIT21, SMPL22, Skeleton
    from motionkit.store.reader import Store
    from motionkit.store.writer import StoreWriter
    from motionkit.timegrid import TimeGrid
    from motionkit.viewing.motions import view

__all__ = [
    "KIT21",
    "SMPL22",
    "Caption",
    "FormatError",
    "Motion",
    "MotionModel",
    "MotionkitError",
    "SamplingOptions",
    "Skeleton",
    "Store",
    "StoreWriter",
    "TimeGrid",
    "UsageError",
    "__version__",
    "complete",
    "generate",
    "load_model",
    "read",
    "read_all",
    "resample",
    "view",
    "write",
]

give_names(
    __name__,
    {
        "Caption": "motionkit.motion",
        "FormatError": "motionkit.errors",
        "KIT21": "motionkit.skeleton",
        "Motion": "motionkit.motion",
        "MotionModel": "motionkit.generate.motion_model",
        "MotionkitError": "motionkit.errors",
        "SMPL22": "motionkit.skeleton",
        "SamplingOptions": "motionkit.generation",
        "Skeleton": "motionkit.skeleton",
        "Store": "motionkit.store.reader",
        "StoreWriter": "motionkit.store.writer",
        "TimeGrid": "motionkit.timegrid",
        "UsageError": "motionkit.errors",
        "complete": "motionkit.completing.motion",
        "generate": "motionkit.generate.motion_model",
        "load_model": "motionkit.generate.motion_model",
        "read": "motionkit.named_motions.reading",
        "read_all": "motionkit.named_motions.reading",
        "resample": "motionkit.resample",
        "view": "motionkit.viewing.motions",
        "write": "motionkit.formats.writing",
    },
)
provide(
    resample="motionkit.resample:resample",
    save="motionkit.formats.writing:write",
    notebook_view="motionkit.viewing.notebook:notebook_view",
)
