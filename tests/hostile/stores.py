"""Hostile stores: links where motionkit writes and deletes, manifests that name foreign files, rows signed again."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from benchmarks.trust.scenarios import STORE, ingest, train
from tests.helpers.signed_again import Edit, rewrite, sign, with_value
from tests.hostile.scene import EVIL, Scene, Spoil, links

EXPORTS = tuple(("export", "out", "--format", name, *STORE) for name in ("npz", "bvh", "humanml3d", "parquet", "csv"))
WRITE = (
    ingest("three"),
    ingest("three", "--overwrite"),
    ("remove", "--where", "sequence_index < 2", *STORE),
    ("compact", *STORE),
    ("split", "--by", "sequence_id", "--shares", "train=0.5,test=0.5", *STORE),
    ("merge", "store", "other"),
    ("merge", "new", "store"),
)
LOOK = (
    ("validate", *STORE),
    ("info", *STORE),
    ("info", "--quality", *STORE),
    ("query", "SELECT * FROM sequences", *STORE),
    ("query", "SELECT sequence_id, source FROM sequences", "--json", *STORE),
    ("view", "--where", "true", *STORE),
    *EXPORTS[:2],
)
TRAIN = ((*train("codebook"), "--overwrite"), (*train("pahires"), "--overwrite"))
EVERYTHING = (*WRITE, *LOOK, *TRAIN)

LINKS: dict[str, dict[str, str]] = {
    "cache is a link": {"store/cache": "folder"},
    "a cache is a link": {"store/cache/*-smpl22-*": "folder"},
    "a cache's file is a link": {"store/cache/*-smpl22-*/positions.npy": "mine.npy"},
    "a part is a link": {"store/motions/part-00000.parquet": "store/motions/part-00000.parquet"},
    "the next part is a link": {
        "store/motions/part-00002.parquet": "mine.txt",
        "store/motions/part-00002.parquet.new": "mine.txt",
    },
    "the manifest is a link": {"store/manifest.json": "store/manifest.json"},
    "tables are links": {
        "store/sequences.parquet": "store/sequences.parquet",
        "store/skeletons.parquet": "store/skeletons.parquet",
    },
    "pending files are links": {
        "store/manifest.json.new": "mine.txt",
        "store/sequences.parquet.new": "mine.txt",
        "store/skeletons.parquet.new": "mine.txt",
        "store/.manifest.json.tmp.json": "mine.txt",
    },
    "the writer's lock is a link": {"store/.writer.lock": "mine.txt"},
}


def _renamed(new: str) -> Callable[[dict[str, Any]], None]:
    def edit(document: dict[str, Any]) -> None:
        files = document["files"]
        files[new] = files.pop("motions/part-00000.parquet")

    return edit


def _next(part: object, sequence: object = 99) -> Callable[[dict[str, Any]], None]:
    return lambda document: document.update({"next": {"part": part, "sequence_index": sequence}})


def _counts(value: object) -> Callable[[dict[str, Any]], None]:
    return lambda document: document.update({"counts": dict.fromkeys(document["counts"], value)})


MANIFESTS: dict[str, Callable[[dict[str, Any]], None]] = {
    "a part above the store": _renamed("../../outside/store/motions/part-00000.parquet"),
    "a part above the folder of motions": _renamed("motions/../../../outside/mine.txt"),
    "the next part is one that is there": _next(0),
    "the next part is enormous": _next(10**30, 10**30),
    "counts of nothing": _counts(0),
    "counts that are texts": _counts(EVIL),
    "an odd tool": lambda document: document.update({"tool": EVIL * 100, "format_version": 2}),
}
SEQUENCES: dict[str, Edit] = {
    "an id above the folder": with_value("sequence_id", 0, "../../outside/mine"),
    "an id of escape sequences": with_value("sequence_id", 0, EVIL),
    "an id of a zero byte": with_value("sequence_id", 0, "a\0b"),
    "an id of 100,000 letters": with_value("sequence_id", 0, "x" * 100_000),
    "a source path above the folder": with_value("source_path", 0, "../../../outside/mine.txt"),
    "a negative framerate": with_value("fps_numerator", 0, -30),
    "an unknown skeleton": with_value("skeleton", 0, "../../outside"),
    "a part that is not there": with_value("part", 0, 2**31 - 1),
    "rows that are not there": with_value("part_row", 0, 2**31 - 1),
    "frames without end": with_value("num_frames", 0, 2**31 - 1),
    "a number of joints that is not its skeleton's": with_value("num_joints", 0, 32_767),
}
SKELETONS: dict[str, Edit] = {
    "a joint name twice": with_value("joint_names", 0, ["a"] * 22),
    "offsets of nan": with_value("offsets", 0, [float("nan")] * 66),
    "parents in a circle": with_value("parents", 0, [*range(1, 22), 0]),
    "a layout map that is no JSON": with_value("layout_map", 0, "{" * 5000),
    "a skeleton's name above the folder": with_value("name", 0, "../../outside/mine"),
}


def _signed(edit: Callable[[dict[str, Any]], None]) -> Spoil:
    return lambda inside, outside: sign(inside / "store", edit)


def _rewritten(name: str, edit: Edit) -> Spoil:
    return lambda inside, outside: rewrite(inside / "store", name, edit)


def _unsigned(inside: Path, outside: Path) -> None:
    path = inside / "store" / "manifest.json"
    document = json.loads(path.read_bytes())
    document["next"] = {"part": 0, "sequence_index": 0}
    path.write_text(json.dumps(document))


def _absolute_part(inside: Path, outside: Path) -> None:
    sign(inside / "store", _renamed(str(outside / "store/motions/part-00000.parquet")))


def _absolute_ids(inside: Path, outside: Path) -> None:
    for row, name in enumerate(("mine", "new")):
        rewrite(inside / "store", "sequences.parquet", with_value("sequence_id", row, str(outside / name)))


def scenes() -> Iterator[Scene]:
    """All of them."""
    for name, places in LINKS.items():
        yield Scene(f"store: {name}", links(places), EVERYTHING)
    for name, edit in MANIFESTS.items():
        yield Scene(f"manifest: {name}", _signed(edit), (*WRITE, *LOOK[:2], EXPORTS[0]))
    yield Scene("manifest: an absolute part", _absolute_part, (*WRITE, *LOOK[:2], EXPORTS[0]))
    yield Scene("sequences: absolute ids", _absolute_ids, (*LOOK, *EXPORTS[2:], *WRITE[2:]))
    yield Scene("manifest: unsigned, the next part is one that is there", _unsigned, (*WRITE, LOOK[0]))
    for name, change in SEQUENCES.items():
        yield Scene(
            f"sequences: {name}", _rewritten("sequences.parquet", change), (*LOOK, *EXPORTS[2:], *WRITE[2:], TRAIN[0])
        )
    for name, change in SKELETONS.items():
        yield Scene(
            f"skeletons: {name}",
            _rewritten("skeletons.parquet", change),
            (*LOOK, *EXPORTS[2:], WRITE[0], WRITE[3], TRAIN[0]),
        )
