"""A long row of things in blocks that are made when they are asked for; the last few are kept."""

from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

Block = TypeVar("Block")


class Blocks(Generic[Block]):
    """Blocks by number, made by `make`; owns the `kept` that were asked for last."""

    def __init__(self, make: Callable[[int], Block], kept: int) -> None:
        self._make = make
        self._kept = kept
        self._made: OrderedDict[int, Block] = OrderedDict()

    def __len__(self) -> int:
        return len(self._made)

    def __getitem__(self, number: int) -> Block:
        if number not in self._made:
            made = self._make(number)
            while len(self._made) >= self._kept:
                self._made.popitem(last=False)
            self._made[number] = made
        self._made.move_to_end(number)
        return self._made[number]
