"""Mutations of JSON documents: values of another type or size, keys lost, renamed or duplicated, deep nesting."""

import json
from collections import deque
from copy import deepcopy
from random import Random
from typing import Any

from benchmarks.trust.fuzz.binary import mutate_bytes
from benchmarks.trust.fuzz.text import NUMBERS, mutate_text

MARK = "@wild@"
WILD = (
    *NUMBERS,
    *(b"null", b"true", b"false", b'""', b"[]", b"{}", b"[[]]", b"[null]", b'{"": null}', b'"x"', b'"nan"', b'"1e999"'),
    *(b"NaN", b"Infinity", b"-Infinity", b"[" * 900 + b"]" * 900, b'"' + b"x" * 70_000 + b'"', b'"\\ud800"'),
    *(b'"\\u0000"', b'"../../x"', b'"/etc/passwd"', b'"\\u001b[31m"', b"[1, 2, 3]", b"[[1.5]]", b"-1.5", b'"1/0"'),
)
Step = tuple[Any, Any]
MOST_STEPS = 2000
# A document that an earlier mutation has made longer is mutated as text.
MOST_BYTES = 1 << 18


def mutate_json(rng: Random, content: bytes) -> bytes:
    """A JSON document after one mutation, of its text if it is no longer valid JSON."""
    if len(content) > MOST_BYTES:
        return mutate_text(rng, content)
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        return mutate_text(rng, content)
    steps = list(_steps(document))
    if not steps or rng.random() < 0.15:
        return mutate_text(rng, content)
    # In long lists the first elements are as likely as all others together.
    container, key = rng.choice(steps[:40] if rng.random() < 0.5 else steps)
    wild = b""
    fate = rng.randrange(10)
    if fate < 5:
        container[key], wild = MARK, rng.choice(WILD)
    elif fate == 5:
        del container[key]
    elif fate == 6:
        container[key] = [container[key]] * rng.choice((1, 2, 1000))
    elif fate == 7:
        other, name = rng.choice(steps)
        container[key] = deepcopy(other[name])
    elif isinstance(container, dict):
        container[rng.choice(("", "x", key + " ", key.upper(), "../x", key * 3))] = container.pop(key)
    else:
        container.insert(key, container[key])
    try:
        text = json.dumps(document, ensure_ascii=rng.random() < 0.8).encode("utf-8", "surrogatepass")
    except (ValueError, RecursionError):  # numbers of 5,000 digits, deep nesting of an earlier accident
        return mutate_text(rng, content)
    return text.replace(json.dumps(MARK).encode(), wild, 1)


def mutate_json_lines(rng: Random, content: bytes) -> bytes:
    """A file of one JSON document per line, after a mutation of one of them or of the whole."""
    lines = content.splitlines()
    if not lines or rng.random() < 0.3:
        return mutate_text(rng, content)
    place = rng.randrange(len(lines))
    lines[place] = mutate_json(rng, lines[place])
    return b"\n".join(lines) + b"\n"


def _steps(value: Any) -> "list[Step]":
    """Every value's place in a document: its container and key or index."""
    found: list[Step] = []
    waiting = deque([value])
    while waiting and len(found) < MOST_STEPS:
        container = waiting.popleft()
        keys = container.keys() if isinstance(container, dict) else range(len(container))
        for key in list(keys):
            found.append((container, key))
            if isinstance(container[key], (dict, list)):
                waiting.append(container[key])
    return found


def is_json(content: bytes) -> bool:
    """Whether it begins like a JSON document."""
    return content.lstrip()[:1] in (b"{", b"[")


def mutate_safetensors(rng: Random, content: bytes) -> bytes:
    """A safetensors file after one mutation, half of the time of its JSON header."""
    length = int.from_bytes(content[:8], "little")
    if rng.random() < 0.5 or not 0 < length <= len(content) - 8:
        return mutate_bytes(rng, content)
    header = mutate_json(rng, content[8 : 8 + length])
    header += b" " * (-len(header) % 8)
    return len(header).to_bytes(8, "little") + header + content[8 + length :]
