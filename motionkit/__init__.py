"""Human motion at native framerates: what a motion is, how it gets in and out, where it rests, what continues it.

    import motionkit as mk

    motion = mk.read("walk.bvh")
    motion[1.5:2.0].resample(60).save("step.glb")

docs/python.md shows all of it. Names are listed in `__init__.pyi` and imported when they are first used, so importing
motionkit is quick. What is imported from deeper modules is for those who extend motionkit (docs/extending.md).
"""

import copyreg
import sys
from importlib import import_module

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# A function that uses `motionkit` can be sent to workers: its module is pickled by name, as other modules are.
copyreg.pickle(type(sys.modules[__name__]), lambda module: (import_module, (module.__name__,)))
