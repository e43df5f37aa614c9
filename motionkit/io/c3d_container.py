"""The C3D container: header, parameters, and the block of points, checked against the file's bytes before use.

All three number formats (Intel, DEC/VAX, MIPS) and both kinds of points (scaled integers, floats) are supported.
Source: "The C3D File Format User Guide", Motion Lab Systems 2021, https://www.c3d.org. No library is used: with the
existing ones, a damaged file may crash or hang the process, and with it an ingest of many files (docs/deviations.md).
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.shapes import Float64
from motionkit.io import source_file

BLOCK = 512
KEY = 0x50
INTEL, DEC, MIPS = 84, 85, 86
MAX_FRAME_WORD = 65535

Parameter = tuple[str, ...] | tuple[float, ...]


@dataclass(frozen=True)
class C3dFile:
    """A file's `parameters` by "GROUP:NAME", and points [frames, points, 4]: x, y, z in file units, residual.

    A negative residual marks a point that is not visible.
    """

    parameters: Mapping[str, Parameter]
    points: Float64[np.ndarray, "frames points 4"]
    header_rate: float

    def texts(self, name: str) -> tuple[str, ...]:
        """A parameter's strings, stripped; empty if there are none."""
        return tuple(value for value in self.parameters.get(name, ()) if isinstance(value, str))

    def numbers(self, name: str) -> tuple[float, ...]:
        """A parameter's numbers; empty if there are none."""
        return tuple(value for value in self.parameters.get(name, ()) if not isinstance(value, str))


@dataclass(frozen=True)
class _Header:
    parameter_block: int
    num_points: int
    num_analog: int
    first_frame: int
    last_frame: int
    scale: float
    data_block: int
    rate: float


def parse_c3d(data: bytes, path: Path) -> C3dFile:
    """Read a whole file; raises `FormatError` (`not-what-it-says`, `truncated`, `parameters`, `no-frames` …)."""
    if len(data) < BLOCK or data[1] != KEY or data[0] == 0:
        short = data[:1] != b"\0" and len(data) > 1 and data[1] == KEY
        found = f"{len(data)} bytes" if short else f"looks like {source_file.describe_content(data)}"
        raise FormatError(
            f"{found}, expected a C3D file",
            path=path,
            reason="truncated" if short else "not-what-it-says",
        )
    start = (data[0] - 1) * BLOCK
    if len(data) < start + 4:
        raise FormatError(
            f"the parameters begin at byte {start}, but the file has {len(data)}", path=path, reason="truncated"
        )
    processor = data[start + 3]
    if processor not in (INTEL, DEC, MIPS):
        raise FormatError(
            f"processor type {processor}, expected {INTEL} (Intel), {DEC} (DEC) or {MIPS} (MIPS)",
            path=path,
            reason="parameters",
        )
    header = _header(data, processor)
    parameters = _parameters(data, start, processor, path)
    return C3dFile(parameters, _points(data, header, parameters, processor, path), header.rate)


def _header(data: bytes, processor: int) -> _Header:
    order = ">" if processor == MIPS else "<"
    points, analog, first, last = struct.unpack_from(f"{order}4H", data, 2)
    (block,) = struct.unpack_from(f"{order}H", data, 16)
    scale, rate = (float(_floats(data[at : at + 4], processor)[0]) for at in (12, 20))
    return _Header(data[0], points, analog, first, last, scale, block, rate)


def _floats(data: bytes, processor: int) -> Float64[np.ndarray, "numbers"]:
    with np.errstate(invalid="ignore"):  # signalling NaN, in bytes that are not floats
        if processor == MIPS:
            return np.frombuffer(data, ">f4").astype(np.float64)
        if processor == INTEL:
            return np.frombuffer(data, "<f4").astype(np.float64)
        # VAX F: the 16-bit words are swapped, and the exponent's bias is larger by two.
        words = np.ascontiguousarray(np.frombuffer(data, "<u2").reshape(-1, 2)[:, ::-1])
        return words.view("<f4")[:, 0].astype(np.float64) / 4.0


def _parameters(data: bytes, start: int, processor: int, path: Path) -> dict[str, Parameter]:
    # Records of groups (negative id) and of their parameters, in any order; each has the offset to the next one.
    end = min(len(data), start + max(data[start + 2], 1) * BLOCK)
    groups: dict[int, str] = {}
    found: list[tuple[int, str, Parameter]] = []
    at = start + 4
    while at + 2 <= end:
        length, number = abs(struct.unpack_from("b", data, at)[0]), struct.unpack_from("b", data, at + 1)[0]
        if length == 0 or number == 0:
            break
        name = data[at + 2 : at + 2 + length].decode("latin-1").strip().upper()
        at += 2 + length
        if at + 2 > end:
            raise _cut_off(path)
        step = struct.unpack_from(">h" if processor == MIPS else "<h", data, at)[0]
        if number < 0:
            groups[-number] = name
        else:
            found.append((number, name, _value(data[at + 2 : end], processor, path)))
        if step <= 0:
            break
        at += step
    return {f"{groups[number]}:{name}": value for number, name, value in found if number in groups}


def _cut_off(path: Path) -> FormatError:
    return FormatError("the parameters end in the middle of one", path=path, reason="truncated")


def _value(data: bytes, processor: int, path: Path) -> Parameter:
    if len(data) < 2:
        raise _cut_off(path)
    kind, num_dimensions = struct.unpack_from("bB", data)
    dimensions = tuple(data[2 : 2 + num_dimensions])
    if len(dimensions) < num_dimensions:
        raise _cut_off(path)
    if kind not in (-1, 1, 2, 4):
        raise FormatError(f"a parameter of type {kind}, expected -1, 1, 2 or 4", path=path, reason="parameters")
    num_bytes = math.prod(dimensions) * abs(kind)
    body = data[2 + num_dimensions : 2 + num_dimensions + num_bytes]
    if len(body) < num_bytes:
        raise _cut_off(path)
    if kind == -1:
        length = dimensions[0] if dimensions else 1
        return tuple(body[i : i + length].decode("latin-1").strip("\0 ") for i in range(0, len(body), max(length, 1)))
    if kind == 4:
        return tuple(_floats(body, processor).tolist())
    code = "b" if kind == 1 else ">i2" if processor == MIPS else "<i2"
    return tuple(float(value) for value in np.frombuffer(body, code).tolist())


def _points(
    data: bytes, header: _Header, parameters: Mapping[str, Parameter], processor: int, path: Path
) -> Float64[np.ndarray, "frames points 4"]:
    num_frames = _num_frames(header, parameters)
    if num_frames < 1:
        raise FormatError("0 frames, expected at least one", path=path, reason="no-frames")
    if header.num_points < 1:
        raise FormatError("0 points, expected markers", path=path, reason="no-markers")
    scale = next((value for value in parameters.get("POINT:SCALE", ()) if isinstance(value, float)), header.scale)
    if not np.isfinite(scale) or scale == 0:
        raise FormatError(f"POINT:SCALE is {scale}, expected a number", path=path, reason="parameters")
    size = 4 if scale < 0 else 2
    values = 4 * header.num_points + header.num_analog
    start = (header.data_block - 1) * BLOCK
    needed, there = num_frames * values * size, len(data) - start
    if start < BLOCK or there < needed:
        raise FormatError(
            f"the header states {num_frames} frames of {header.num_points} points, {needed} bytes from byte {start} "
            f"on, but {max(there, 0)} follow",
            path=path,
            reason="truncated",
        )
    if num_frames == MAX_FRAME_WORD and there > needed + BLOCK:
        raise FormatError(
            f"the header can state no more than 65,535 frames and no TRIAL:ACTUAL_END_FIELD states more, but there are "
            f"bytes for {there // (values * size)}; write the take again with that parameter, or in parts",
            path=path,
            reason="frame-count",
        )
    # Analog values follow the points of each frame, and are often most of a file.
    whole = np.frombuffer(data, f"<u{size}", num_frames * values, start).reshape(num_frames, values)
    body, shape = whole[:, : 4 * header.num_points].tobytes(), (num_frames, header.num_points, 4)
    if size == 4:
        return _floats(body, processor).reshape(shape)
    points = np.frombuffer(body, ">i2" if processor == MIPS else "<i2").reshape(shape).astype(np.float64)
    points[..., :3] *= scale
    return points


def _num_frames(header: _Header, parameters: Mapping[str, Parameter]) -> int:
    # The header's words hold frames up to 65,535; for longer takes parameters have the count, as two words or a number.
    actual = [_words(parameters.get(f"TRIAL:ACTUAL_{end}_FIELD", ())) for end in ("START", "END")]
    if all(len(words) == 2 for words in actual):
        first, last = (low + 65536 * high for low, high in actual)
        return last - first + 1
    stated = header.last_frame - header.first_frame + 1
    if header.last_frame < MAX_FRAME_WORD:
        return stated
    frames = [number for name in ("POINT:LONG_FRAMES", "POINT:FRAMES") for number in _whole(parameters.get(name, ()))]
    return max(stated, *frames, 0)


def _words(values: Parameter) -> list[int]:
    return [number % 65536 for number in _whole(values)]


def _whole(values: Parameter) -> list[int]:
    return [int(value) for value in values if not isinstance(value, str) and np.isfinite(value)]
