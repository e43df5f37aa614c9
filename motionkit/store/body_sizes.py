"""Bodies of the same joints whose sizes no two people have: files whose unit was taken for another."""

from collections.abc import Iterable

import numpy as np

from motionkit.skeleton import Skeleton

# Grown people differ by a third, a child from a grown man by less than 2; an inch is 2.54 cm, CMU's unit 2.2 inches.
UNLIKE_FACTOR = 2.0


class BodySizes:
    """Remembers how long the bones are, in sum, of the first skeleton of each set of joints."""

    def __init__(self, known: Iterable[Skeleton]) -> None:
        self._first: dict[tuple[str, ...], tuple[float, str]] = {}
        for skeleton in known:
            self.doubt(skeleton)

    def doubt(self, skeleton: Skeleton) -> str:
        """What to tell of a skeleton of another size than the first with its joints; empty where there is nothing."""
        size = float(np.linalg.norm(skeleton.offsets[1:], axis=-1).sum())
        if size == 0.0:  # markers
            return ""
        first, name = self._first.setdefault(skeleton.joint_names, (size, skeleton.name))
        factor = max(size / first, first / size)
        if factor < UNLIKE_FACTOR:
            return ""
        return (
            f"its body is {factor:.3g} times {'as large' if size > first else 'smaller'} as that of skeleton {name!r}, "
            "which has the same joints: was the unit of one of them taken for another? The log says which it was; "
            "--unit-metres sets it"
        )
