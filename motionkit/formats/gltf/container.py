"""The container of a .glb: arrays as accessors in one binary chunk, behind the JSON that describes them.

Source: Khronos, glTF 2.0 specification, §3.6 (accessors, alignment) and §4.4 (GLB).
"""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

MAGIC, VERSION = 0x46546C67, 2
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
COMPONENT_TYPES = {"float32": 5126, "uint16": 5123}
WIDTHS = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
VERTICES = 34962


class GlbBuffer:
    """Collects arrays into one buffer, each aligned to four bytes; owns the bytes and their descriptions."""

    def __init__(self) -> None:
        self._content = bytearray()
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []

    def add(self, array: np.ndarray, *, bounds: bool = False, vertices: bool = False) -> int:
        """Append float32 or uint16 values, an element a row; returns the accessor's index.

        `bounds` states least and greatest values (required of positions and key times), `vertices` marks data of
        vertices. Raises `KeyError` for another type or width.
        """
        rows = np.ascontiguousarray(array.reshape(len(array), -1))
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self._content), "byteLength": rows.nbytes}
        if vertices:
            view["target"] = VERTICES
        accessor: dict[str, Any] = {
            "bufferView": len(self._views),
            "componentType": COMPONENT_TYPES[rows.dtype.name],
            "count": len(rows),
            "type": WIDTHS[rows.shape[1]],
        }
        if bounds:
            accessor |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        self._content += rows.astype(rows.dtype.newbyteorder("<"), copy=False).tobytes()
        self._content += bytes(-len(self._content) % 4)
        self._views.append(view)
        self._accessors.append(accessor)
        return len(self._accessors) - 1

    def write(self, path: Path, document: dict[str, Any]) -> None:
        """Write the .glb: `document` completed by the buffer, its views and accessors."""
        complete = {
            **document,
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self._content)}],
        }
        text = json.dumps(complete, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        size = 12 + 8 + len(text) + 8 + len(self._content)
        with path.open("wb") as file:
            file.write(struct.pack("<III", MAGIC, VERSION, size))
            file.write(struct.pack("<II", len(text), JSON_CHUNK) + text)
            file.write(struct.pack("<II", len(self._content), BINARY_CHUNK) + self._content)
