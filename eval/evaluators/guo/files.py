"""Where the files of a published evaluator lie, and how motions are to be padded for it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

REACH_FRAMES = 3
"""How far past the frames that it stands for the last token's convolutions see."""

Padding = Literal["masked", "zeros", "frames"]
"""What the last token sees past a motion's end: nothing (`masked`), standardised zeros up to frame 196 (`zeros`: the
published protocol), or the frames that follow there, then zeros (`frames`: where generated ones were left in)."""


@dataclass(frozen=True)
class GuoFiles:
    """What `eval.evaluators.guo.evaluator.load_guo` loads: `statistics` None means those beside the weights."""

    weights: Path
    glove: Path | None = None
    statistics: Path | None = None
    padding: Padding = "masked"
