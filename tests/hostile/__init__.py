"""What strangers may send: hostile stores, runs, samples folders and tables, made in a copy of good ones."""

from tests.hostile import outputs, runs, sources, stores, weights
from tests.hostile.scene import Scene

SCENES: tuple[Scene, ...] = (
    *stores.scenes(),
    *runs.scenes(),
    *weights.scenes(),
    *outputs.scenes(),
    *sources.scenes(),
)
