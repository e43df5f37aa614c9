"""Which sequences a store holds, and from which files, in 24 bytes each: what a writer must remember of a million."""

import hashlib
from collections.abc import Iterable

import numpy as np

# So many are kept as text before they are sorted in among the others.
RECENT = 4096
DTYPE = np.dtype([("id", "<u8"), ("id_rest", "<u8"), ("source", "<u8")])


class KnownSequences:
    """Ids and the checksums of their sources, as digests: 128 bits of an id, 64 of its source's checksum."""

    def __init__(self) -> None:
        self._recent: dict[str, str] = {}
        self._sorted = np.empty(0, DTYPE)

    def add(self, sequence_id: str, source_sha256: str) -> None:
        """Remember a sequence that is not among them yet."""
        self._recent[sequence_id] = source_sha256
        if len(self._recent) == RECENT:
            self._merge(self._recent.items())
            self._recent.clear()

    def add_all(self, sequences: Iterable[tuple[str, str]]) -> None:
        """Remember many pairs of an id and its source's checksum."""
        self._merge(sequences)

    def __contains__(self, sequence_id: str) -> bool:
        return sequence_id in self._recent or self._find(sequence_id) is not None

    def is_from(self, sequence_id: str, source_sha256: str) -> bool:
        """Whether this sequence is known, and comes from a file with this checksum."""
        if sequence_id in self._recent:
            return self._recent[sequence_id] == source_sha256
        found = self._find(sequence_id)
        return found is not None and int(found["source"]) == _digest(source_sha256)[0]

    def _find(self, sequence_id: str) -> np.void | None:
        first, rest = _digest(sequence_id)
        places = (np.searchsorted(self._sorted["id"], np.uint64(first), side) for side in ("left", "right"))
        for entry in self._sorted[slice(*places)]:
            if int(entry["id_rest"]) == rest:
                found: np.void = entry
                return found
        return None

    def _merge(self, sequences: Iterable[tuple[str, str]]) -> None:
        more = np.array([(*_digest(name), _digest(source)[0]) for name, source in sequences], DTYPE)
        both = np.concatenate((self._sorted, more))
        # Two runs of which the first is sorted: a stable sort is little more than their merge.
        self._sorted = both[np.argsort(both["id"], kind="stable")]


def _digest(text: str) -> tuple[int, int]:
    content = hashlib.blake2b(text.encode("utf-8", "surrogatepass"), digest_size=16).digest()
    return int.from_bytes(content[:8], "little"), int.from_bytes(content[8:], "little")
