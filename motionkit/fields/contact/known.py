"""Contacts that a motion field knows itself: what its model has learnt, where its paths say less."""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, Float64

from motionkit.fields.motion_field import MotionField


@runtime_checkable
class KnowsContacts(Protocol):
    """A motion field that says itself when feet are on the ground."""

    def contacts(self, times_seconds: Float64[np.ndarray, "times"]) -> Float32[np.ndarray, "times 2 2"] | None:
        """How probably ankle and toe of left and right foot are on the ground; None where it doesn't know."""
        ...


def contacts_of(
    field: MotionField, times_seconds: Float64[np.ndarray, "times"]
) -> Float32[np.ndarray, "times 2 2"] | None:
    """What a field says of its contacts; None where it says nothing."""
    return field.contacts(times_seconds) if isinstance(field, KnowsContacts) else None
