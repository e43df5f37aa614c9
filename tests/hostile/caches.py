"""Hostile training caches: signed again with files above their folder, arrays without end, rows that are not there."""

import hashlib
import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.trust.scenarios import STORE, train
from motionkit.core.checksums import sealed
from motionkit.store.cache.build import INDEX_DTYPE
from tests.hostile.scene import EVIL, Scene, Spoil, link

COMMANDS = (
    (*train("field"), "--overwrite"),
    (*train("pahires"), "--overwrite"),
    ("validate", "--deep", *STORE),
    ("info", *STORE),
    ("remove", "--where", "sequence_index < 2", *STORE),
)


def _each(spoil: Callable[[Path, Path], None]) -> Spoil:
    """The same for every cache of the store; `spoil` is given a cache's folder and the folder outside."""

    def spoil_all(inside: Path, outside: Path) -> None:
        folders = sorted((inside / "store/cache").glob("*-smpl22-*"))
        assert folders
        for folder in folders:
            spoil(folder, outside)

    return spoil_all


def _document(name: str, edit: Callable[[dict[str, Any]], None]) -> Spoil:
    def spoil(folder: Path, outside: Path) -> None:
        document = json.loads((folder / name).read_bytes())
        edit(document)
        (folder / name).write_text(json.dumps(sealed(document)))

    return _each(spoil)


def _fact(name: str, value: object) -> Spoil:
    return _document("cache.json", lambda document: document.update({name: value}))


def _content(name: str, content: bytes) -> Spoil:
    """A file of the cache with another content, and the digest of that in cache.json."""

    def spoil(folder: Path, outside: Path) -> None:
        (folder / name).write_bytes(content)
        digest = {"sha256": hashlib.sha256(content).hexdigest(), "num_bytes": len(content)}
        document = json.loads((folder / "cache.json").read_bytes())
        document["files"][name] = digest
        (folder / "cache.json").write_text(json.dumps(sealed(document)))

    return _each(spoil)


def _header(text: str) -> bytes:
    """A .npy file that is only a header."""
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()


def _saved(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def _index(**changes: int) -> bytes:
    """An index of two sequences of which one has these values."""
    index = np.zeros(2, INDEX_DTYPE)
    index["sequence_index"], index["num_frames"], index["start_row"] = (0, 1), 10, (0, 10)
    index["fps_numerator"], index["fps_denominator"] = 30, 1
    for name, value in changes.items():
        index[name][0] = value
    return _saved(index)


def _foreign(folder: Path, outside: Path) -> None:
    """A cache's folder, by its name and its marker that of another version, holds links and folders of a user's."""
    other = folder.with_name(f"{'0' * 16}-smpl22-{'0' * 16}")
    other.mkdir(exist_ok=True)
    (other / ".motionkit-cache").write_text("motionkit training cache, version 999\n")
    for name in ("cache.json", "index.npy", "positions.npy", ".motionkit-cache.tmp", ".mine.lock", "mine.npy"):
        link(other / name, outside / "mine.npy")
    link(other / "folder", outside / "folder")


CACHES: dict[str, Spoil] = {
    "files above the folder": _document(
        "cache.json", lambda document: document["files"].update({"../../../../outside/mine.npy": {}})
    ),
    "files that are none": _fact("files", [EVIL]),
    "sizes without end": _document(
        "cache.json", lambda document: document["files"]["positions.npy"].update({"num_bytes": 10**30})
    ),
    "a layout of escape sequences": _fact("layout", EVIL),
    "skipped that is none": _fact("skipped", 7),
    "skipped of escape sequences": _fact("skipped", [{"sequence_id": EVIL, "reason": EVIL}]),
    "a version of 400 digits": _fact("version", 10**400),
    "positions without end": _content(
        "positions.npy",
        _header("{'descr': '<f4', 'fortran_order': False, 'shape': (4611686018427387904, 22, 3), }\n"),
    ),
    "positions of objects": _content("positions.npy", _saved(np.array([print], object))),
    "a header nested without end": _content("positions.npy", _header("(" * 60_000)),
    "no positions": _content("positions.npy", _saved(np.zeros((0, 22, 3), np.float32))),
    "positions of a joint": _content("positions.npy", _saved(np.zeros((20, 1, 3), np.float32))),
    "an index without end": _content(
        "index.npy", _header(f"{{'descr': {INDEX_DTYPE.descr}, 'fortran_order': False, 'shape': ({10**15},), }}\n")
    ),
    "an index that is another array": _content("index.npy", _saved(np.zeros(3))),
    "an index below zero": _content("index.npy", _index(sequence_index=-1)),
    "an index beyond the store": _content("index.npy", _index(sequence_index=2**31 - 1)),
    "rows below zero": _content("index.npy", _index(start_row=-(2**40))),
    "frames without end": _content("index.npy", _index(num_frames=2**31 - 1)),
    "a framerate over nothing": _content("index.npy", _index(fps_denominator=0)),
    "a foreign marker": _each(_foreign),
    "a marker that is a link": _each(lambda folder, outside: link(folder / ".motionkit-cache", outside / "mine.txt")),
    "a derived file's digest of another kind": _each(
        lambda folder, outside: _of_derived(folder, {"sha256": EVIL, "num_bytes": 10**30})
    ),
    "a derived file's digest that is none": _each(lambda folder, outside: _of_derived(folder, {"a": [1]})),
    "derived files are links": _each(lambda folder, outside: _linked(folder, outside)),
}


def _of_derived(folder: Path, document: dict[str, object]) -> None:
    for path in folder.glob("rotation-rows-*.json"):
        path.write_text(json.dumps(sealed(document)))


def _linked(folder: Path, outside: Path) -> None:
    for path in folder.glob("*rotation-rows-*"):
        link(path, outside / "mine.txt")
    for name in (".cache.json.tmp.json", ".positions.npy.tmp.npy", ".index.npy.tmp.npy"):
        link(folder / name, outside / "mine.txt")
    (folder / "cache.json").unlink()


def scenes() -> Iterator[Scene]:
    """All of them."""
    for name, spoil in CACHES.items():
        yield Scene(f"cache: {name}", spoil, COMMANDS)
