"""Contacts predicted by a motion field's model, as an alternative to detection from the feet's paths."""

from typing import Protocol, runtime_checkable

import numpy as np

from motionkit.core.shapes import Float32, Float64
from motionkit.fields.motion_field import MotionField


@runtime_checkable
class PredictsContacts(Protocol):
    """A motion field that predicts contacts."""

    def contacts(self, times_seconds: Float64[np.ndarray, "times"]) -> Float32[np.ndarray, "times 2 2"] | None:
        """Contact probabilities of ankle and toe of left and right foot; None if not available."""
        ...


def contacts_of(
    field: MotionField, times_seconds: Float64[np.ndarray, "times"]
) -> Float32[np.ndarray, "times 2 2"] | None:
    """A field's predicted contacts; None if it has none."""
    return field.contacts(times_seconds) if isinstance(field, PredictsContacts) else None
