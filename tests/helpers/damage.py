"""Files after accidents: the fuzz's mutations, each of a seed that hypothesis draws."""

from random import Random

from hypothesis import strategies as st

from benchmarks.trust.mutate import mutate


def damaged(content: bytes) -> st.SearchStrategy[bytes]:
    """A file's bytes after one to four accidents; of an archive, mostly to one of its members."""
    return st.integers(0, 2**32).map(lambda seed: mutate(Random(seed), "", content))
