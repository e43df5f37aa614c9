"""Conventions of pose vectors that models learn, and their scaling; no torch here."""

from typing import Literal

PoseVectorsName = Literal["field", "native", "rotations"]
