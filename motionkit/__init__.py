"""Human motion at native framerates: what a motion is, how it gets in and out, where it rests, what continues it.

    import motionkit as mk

    motion = mk.read("walk.bvh")
    motion[1.5:2.0].resample(60).save("step.glb")

docs/python.md shows all of it. Names are imported when they are first used, so importing motionkit is quick. What is
imported from deeper modules is for those who extend motionkit (docs/extending.md).
"""

from typing import TYPE_CHECKING

from motionkit.core import __version__
from motionkit.core.public_names import give_names, provide

if TYPE_CHECKING:
    from motionkit.core.errors import FormatError, MotionkitError, UsageError
    from motionkit.core.motion import Caption, Motion
    from motionkit.core.skeleton import KIT21, SMPL22, Skeleton
    from motionkit.core.timegrid import TimeGrid
    from motionkit.data.dataset import ClipDataset
    from motionkit.edit.complete import complete
    from motionkit.edit.convert import convert
    from motionkit.edit.plant import plant
    from motionkit.fields.resample import resample
    from motionkit.generate.constraints import Constraint
    from motionkit.generate.models import SamplingOptions
    from motionkit.generate.motion import MotionModel, generate, load_model
    from motionkit.io.files import read, read_all
    from motionkit.io.registry import write
    from motionkit.store.reader import Store
    from motionkit.store.writer import StoreWriter
    from motionkit.viz.view import view

__all__ = [
    "KIT21",
    "SMPL22",
    "Caption",
    "ClipDataset",
    "Constraint",
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
    "convert",
    "generate",
    "load_model",
    "plant",
    "read",
    "read_all",
    "resample",
    "view",
    "write",
]

give_names(
    __name__,
    {
        "Caption": "motionkit.core.motion",
        "ClipDataset": "motionkit.data.dataset",
        "Constraint": "motionkit.generate.constraints",
        "FormatError": "motionkit.core.errors",
        "KIT21": "motionkit.core.skeleton",
        "Motion": "motionkit.core.motion",
        "MotionModel": "motionkit.generate.motion",
        "MotionkitError": "motionkit.core.errors",
        "SMPL22": "motionkit.core.skeleton",
        "SamplingOptions": "motionkit.generate.models",
        "Skeleton": "motionkit.core.skeleton",
        "Store": "motionkit.store.reader",
        "StoreWriter": "motionkit.store.writer",
        "TimeGrid": "motionkit.core.timegrid",
        "UsageError": "motionkit.core.errors",
        "complete": "motionkit.edit.complete",
        "convert": "motionkit.edit.convert",
        "generate": "motionkit.generate.motion",
        "load_model": "motionkit.generate.motion",
        "plant": "motionkit.edit.plant",
        "read": "motionkit.io.files",
        "read_all": "motionkit.io.files",
        "resample": "motionkit.fields.resample",
        "view": "motionkit.viz.view",
        "write": "motionkit.io.registry",
    },
)
provide(
    resample="motionkit.fields.resample:resample",
    save="motionkit.io.registry:write",
    notebook_view="motionkit.viz.view:notebook_view",
)
