"""Quality measures and flags of a motion, computed for every sequence of a store.

`measure(motion)` is pure and cheap enough to run at ingest. docs/quality.md has every formula, unit and threshold.
"""

from motionkit.features.quality.measure import Quality, measure

__all__ = ["Quality", "measure"]
