"""Annotations of arrays with their dtype and axes: `Float32[np.ndarray, "frames joints 3"]`.

They are jaxtyping's, which the tests check at every call. Where nothing has imported jaxtyping they only describe, as
importing it and building its types is a noticeable part of a short command.
"""

import sys
from types import GenericAlias
from typing import TYPE_CHECKING

__all__ = [
    "Bool",
    "Float",
    "Float32",
    "Float64",
    "Int",
    "Int32",
    "Int64",
    "Shaped",
]

if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool, Float, Float32, Float64, Int, Int32, Int64, Shaped
else:

    class Shaped:
        """An array of any dtype."""

        __class_getitem__ = classmethod(GenericAlias)

    Bool = Float = Float32 = Float64 = Int = Int32 = Int64 = Shaped
