"""What continuous and frame-based models learn at each instant, in which numbers and at which scale; no torch here."""

from typing import Literal

PoseVectorsName = Literal["field", "native", "rotations"]
