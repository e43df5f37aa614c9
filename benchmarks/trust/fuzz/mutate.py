"""One to four mutations of a file, suited to its content; all randomness comes from one generator.

An input of the fuzz part is identified by (reader, seed, number), from which `generator` reproduces it.
"""

from functools import partial
from random import Random

from benchmarks.trust.fuzz.archives import ZIP, Accident, mutate_zip
from benchmarks.trust.fuzz.arrays import NPY, mutate_npy, mutate_pickle
from benchmarks.trust.fuzz.binary import mutate_bytes
from benchmarks.trust.fuzz.documents import is_json, mutate_json, mutate_json_lines, mutate_safetensors
from benchmarks.trust.fuzz.tables import mutate_parquet
from benchmarks.trust.fuzz.text import mutate_text


def generator(reader: str, seed: int, number: int) -> Random:
    """The random generator of one input."""
    return Random(f"{reader}/{seed}/{number}")


def mutate(rng: Random, name: str, content: bytes) -> bytes:
    """A file's bytes after one to four mutations; mostly one, since readers stop at the first fault."""
    accident = accident_of(name, content)
    for _ in range(rng.choice((1, 1, 1, 1, 2, 2, 3, 4))):
        try:
            content = accident(rng, content)
        except RecursionError:  # what an earlier accident has nested deeply
            content = mutate_bytes(rng, content)
    return content


def accident_of(name: str, content: bytes) -> Accident:
    """The mutation for a file, by its type."""
    if content.startswith(ZIP):
        return partial(mutate_zip, accident_of=accident_of)
    if content.startswith(NPY):
        return mutate_pickle if b"'|O'" in content[:200] else mutate_npy
    if content.startswith(b"PAR1"):
        return mutate_parquet
    if content.startswith(b"\x80"):
        return mutate_pickle
    if name.endswith(".safetensors"):
        return mutate_safetensors
    if name.endswith(".jsonl"):
        return mutate_json_lines
    if name.endswith(".json") or is_json(content):
        return mutate_json
    return mutate_bytes if b"\0" in content else mutate_text
