"""One to four accidents to a file, of the kinds that its content can have; everything random comes from one generator.

An input of the fuzz part is known by (reader, seed, number): `generator` makes the same one again.
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
    """Where all randomness of one input comes from."""
    return Random(f"{reader}/{seed}/{number}")


def mutate(rng: Random, name: str, content: bytes) -> bytes:
    """A file's bytes after one to four accidents; mostly one, for a file with many faults is refused at the first."""
    accident = accident_of(name, content)
    for _ in range(rng.choice((1, 1, 1, 1, 2, 2, 3, 4))):
        try:
            content = accident(rng, content)
        except RecursionError:  # what an earlier accident has nested deeply
            content = mutate_bytes(rng, content)
    return content


def accident_of(name: str, content: bytes) -> Accident:
    """The kind of accident that fits a file, by what it is."""
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
