"""Hostile weights: safetensors with absurd headers, and with tensors that fit no model."""

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from benchmarks.trust.scenarios import COMPLETE, EVAL, EVAL_PAHIRES, train
from tests.hostile.runs import MAKE, unfinished
from tests.hostile.scene import EVIL, Scene, Spoil

Header = dict[str, Any]
COMMANDS = {
    "field": (
        MAKE,
        (*train("denoiser"), "--overwrite"),
        ("eval", "--table", "4", "--clips", "64", *EVAL),
    ),
    "denoiser": (MAKE,),
    "codebook": (MAKE, (*train("field"), "--overwrite")),
    "pahires": (COMPLETE, EVAL_PAHIRES),
}


def _parts(content: bytes) -> tuple[Header, bytes]:
    end = 8 + int.from_bytes(content[:8], "little")
    return json.loads(content[8:end]), content[end:]


def packed(header: Header, data: bytes) -> bytes:
    """A safetensors file of this header."""
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + data


def _file(place: str, content: bytes) -> Spoil:
    return lambda inside, outside: _write(inside / place, content)


def _write(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    path.with_name("SHA256SUMS").unlink(missing_ok=True)


def _edited(place: str, edit: Callable[[Header], None]) -> Spoil:
    def spoil(inside: Path, outside: Path) -> None:
        header, data = _parts((inside / place).read_bytes())
        edit(header)
        _write(inside / place, packed(header, data))

    return spoil


def _first(header: Header) -> str:
    return next(name for name in sorted(header) if name != "__metadata__" and header[name]["shape"])


def _described(value: object) -> Callable[[Header], None]:
    text = value if isinstance(value, str) else json.dumps(value)
    return lambda header: header.setdefault("__metadata__", {}).update(description=text)


def _value_described(name: str, value: object) -> Callable[[Header], None]:
    def edit(header: Header) -> None:
        description = json.loads(header["__metadata__"]["description"])
        header["__metadata__"]["description"] = json.dumps({**description, name: value})

    return edit


def _settings(*keys: str, value: object) -> Callable[[Header], None]:
    """A model's own description says that it is built with another setting."""

    def edit(header: Header) -> None:
        description = json.loads(header["__metadata__"]["description"])
        place = description["config"]
        for key in keys[:-1]:
            place = place[key]
        place[keys[-1]] = value
        header["__metadata__"]["description"] = json.dumps(description)

    return edit


def _as_column(header: Header) -> None:
    header[_first(header)]["shape"] = [math.prod(header[_first(header)]["shape"]), 1]


def _renamed(header: Header) -> None:
    header[EVIL] = header.pop(_first(header))


RAW: dict[str, bytes] = {
    "an empty file": b"",
    "a header of 2⁶³ bytes": (2**63).to_bytes(8, "little") + b"{}",
    "nested without end": (200_000).to_bytes(8, "little") + b"[" * 200_000,
    "a shape without end": packed({"a": {"dtype": "F32", "shape": [2**40, 2**40], "data_offsets": [0, 8]}}, bytes(8)),
    "offsets without end": packed({"a": {"dtype": "F32", "shape": [2], "data_offsets": [0, 2**62]}}, bytes(8)),
    "an unknown type": packed({"a": {"dtype": EVIL, "shape": [2], "data_offsets": [0, 8]}}, bytes(8)),
    "a name of escape sequences": packed({EVIL: {"dtype": "F32", "shape": [2], "data_offsets": [0, 8]}}, bytes(8)),
}
EDITS: dict[str, Callable[[Header], None]] = {
    "a tensor of another shape": _as_column,
    "a tensor of another name": _renamed,
    "a description nested without end": _described("[" * 100_000),
    "a description of nothing": _described({}),
    "a step of 400 digits": _value_described("step", 10**400),
}

SETTINGS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "field": (("hidden",), ("layers",)),
    "denoiser": (("network", "ffn_width"), ("network", "num_layers")),
    "pahires": (("network", "hidden"), ("network", "decoder_layers")),
}


def scenes() -> Iterator[Scene]:
    """All of them: models of every stage, and the checkpoints that a training goes on from."""
    for stage, commands in COMMANDS.items():
        place = f"runs/drill/{stage}/model.safetensors"
        for name, content in RAW.items():
            yield Scene(f"{stage}'s model: {name}", _file(place, content), commands)
        for name, edit in EDITS.items():
            yield Scene(f"{stage}'s model: {name}", _edited(place, edit), commands)
    for stage, (width, layers) in SETTINGS.items():
        for name, edit in {
            "wide without end": _settings(*width, value=100_000_000),
            "many layers": _settings(*layers, value=100_000_001),
            "a width of escape sequences": _settings(*width, value=EVIL),
        }.items():
            place = f"runs/drill/{stage}/model.safetensors"
            yield Scene(f"{stage}'s model: {name}", _edited(place, edit), COMMANDS[stage])
    for stage in ("field", "codebook", "pahires"):
        place = f"runs/drill/{stage}/checkpoint.safetensors"
        resume = ((*train(stage), "--resume"),)
        for name, content in RAW.items():
            yield Scene(f"{stage}'s checkpoint: {name}", unfinished(_file(place, content), stage), resume)
        for name, edit in EDITS.items():
            yield Scene(f"{stage}'s checkpoint: {name}", unfinished(_edited(place, edit), stage), resume)
