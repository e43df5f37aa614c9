"""Stores, runs, samples and results of a stranger's making: nothing outside of their folder is changed or shown.

Every command ends with 0, or says what is wrong in lines without escape sequences.
"""

import csv
import hashlib
import io
import json
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.trust.scenarios import EVAL, GENERATE, RUN, STORE, ingest, train, write_takes
from motionkit.cli.app import run as main
from tests.helpers.outcome import Outcome
from tests.helpers.signed_again import Edit, rewrite, sign, with_value

Run = Callable[..., Outcome]
Spoil = Callable[[Path], None]
# Colours, a window's title, line breaks, a C1 control and a turned direction of writing.
EVIL = "\x1b[31mred\x1b]0;title\x07\r\n\x9b2J\u202e"
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
SECRET = "somebody's own"
FIELD = "runs/drill/field"
MAKE = (*GENERATE[:-6], "--out", "new", *RUN)
TABLE = ("eval", "--table", "4", "--clips", "64", *EVAL)
VALIDATE, INFO = ("validate", *STORE), ("info", *STORE)
EXPORT = ("export", "out", "--format", "npz", *STORE)
REPORT = ("report", "--results", "results")
SAMPLES = ("samples", "samples")


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store, a run, results, generated motions and samples, and a secret beside them."""
    folder = tmp_path_factory.mktemp("hostile")
    inside = folder / "inside"
    write_takes(str(inside / "takes"), "0", "8", "3.0")
    (inside / "samples").mkdir()
    np.save(inside / "samples/0.npy", np.zeros((40, 22, 3), np.float32))
    (inside / "samples/samples.toml").write_text("fps = 20\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(inside)
        for arguments in (ingest("takes"), *map(train, ("codebook", "field", "denoiser")), GENERATE, TABLE):
            patch.setattr(sys, "argv", ["motionkit", *arguments])
            with pytest.raises(SystemExit) as ended:
                main()
            assert not ended.value.code
    (folder / "mine.txt").write_text(SECRET)
    np.savez(folder / "mine.npz", SECRET)
    return folder


def text(place: str, content: str | bytes) -> Spoil:
    return lambda inside: _write(inside / place, content if isinstance(content, bytes) else content.encode())


def _write(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    path.with_name("SHA256SUMS").unlink(missing_ok=True)


def document(place: str, **changes: Any) -> Spoil:
    """A JSON file with other values; keys of inner objects are joined by two underscores."""

    def spoil(inside: Path) -> None:
        content = json.loads((inside / place).read_bytes())
        for name, value in changes.items():
            *outer, last = name.split("__")
            target = content
            for key in outer:
                target = target[int(key) if key.isdigit() else key]
            target[last] = value
        _write(inside / place, json.dumps(content).encode())

    return spoil


def manifest(edit: Callable[[dict[str, Any]], Any]) -> Spoil:
    return lambda inside: sign(inside / "store", edit)


def rows(table: str, edit: Edit) -> Spoil:
    return lambda inside: rewrite(inside / "store", f"{table}.parquet", edit)


def header(edit: Callable[[dict[str, Any]], Any], stage: str = "field") -> Spoil:
    """A model whose safetensors header is changed."""

    def spoil(inside: Path) -> None:
        path = inside / f"runs/drill/{stage}/model.safetensors"
        content = path.read_bytes()
        end = 8 + int.from_bytes(content[:8], "little")
        values = json.loads(content[8:end])
        edit(values)
        _write(path, packed(values, content[end:]))

    return spoil


def packed(values: dict[str, Any], data: bytes) -> bytes:
    content = json.dumps(values).encode()
    return len(content).to_bytes(8, "little") + content + data


def setting(*keys: str, value: Any) -> Callable[[dict[str, Any]], None]:
    """A model's own description says that it is built with another setting."""

    def edit(values: dict[str, Any]) -> None:
        described = json.loads(values["__metadata__"]["description"])
        target = described["config"]
        for key in keys[:-1]:
            target = target[key]
        target[keys[-1]] = value
        values["__metadata__"]["description"] = json.dumps(described)

    return edit


def generated(**cells: str) -> Spoil:
    """motions.csv with other cells in its first row."""

    def spoil(inside: Path) -> None:
        path = inside / "made/motions.csv"
        table = list(csv.DictReader(path.read_text().splitlines()))
        table[0] |= cells
        written = io.StringIO(newline="")
        writer = csv.DictWriter(written, list(table[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)
        path.write_text(written.getvalue())

    return spoil


def names(inside: Path) -> None:
    """A good take and a broken one whose names a terminal would obey, one of them no UTF-8."""
    for name, text in ((f"{EVIL}\udcff", (inside / "takes/take-0.bvh").read_text()), (f"bad{EVIL}", "HIERARCHY\n")):
        (inside / "takes" / f"{name}.bvh").write_text(text)


def _part_above(content: dict[str, Any]) -> None:
    content["files"]["../../mine.txt"] = content["files"].pop("motions/part-00000.parquet")


SHAPE_WITHOUT_END = packed({"a": {"dtype": "F32", "shape": [2**40, 2**40], "data_offsets": [0, 8]}}, bytes(8))
SCENES: dict[str, tuple[Spoil, tuple[str, ...]]] = {
    "store: a part above its folder": (manifest(_part_above), VALIDATE),
    "store: an enormous next part": (manifest(lambda each: each.update(next={"part": 10**30})), ("compact", *STORE)),
    "store: an id above the folder": (rows("sequences", with_value("sequence_id", 0, "../../mine")), EXPORT),
    "store: an id of escape sequences": (rows("sequences", with_value("sequence_id", 0, EVIL)), VALIDATE),
    "store: escape sequences queried": (
        rows("sequences", with_value("sequence_id", 0, EVIL)),
        ("query", "SELECT sequence_id FROM sequences", *STORE),
    ),
    "store: frames without end": (rows("sequences", with_value("num_frames", 0, 2**31 - 1)), EXPORT),
    "store: rows that are not there": (rows("sequences", with_value("part_row", 0, 2**31 - 1)), EXPORT),
    "store: a skeleton's parents in a circle": (
        rows("skeletons", with_value("parents", 0, [*range(1, 22), 0])),
        EXPORT,
    ),
    "store: a layout map nested without end": (rows("skeletons", with_value("layout_map", 0, "[" * 100_000)), INFO),
    "run: a seed of 400 digits": (document(f"{FIELD}/config.json", seed=10**400), MAKE),
    "run: settings of escape sequences": (document(f"{FIELD}/config.json", config={EVIL: EVIL}), MAKE),
    "run: a summary of escape sequences": (document(f"{FIELD}/summary.json", step=EVIL, wall_seconds={"a": 1}), TABLE),
    "model: a header of 2⁶³ bytes": (text(f"{FIELD}/model.safetensors", (2**63).to_bytes(8, "little") + b"{}"), MAKE),
    "model: a shape without end": (text(f"{FIELD}/model.safetensors", SHAPE_WITHOUT_END), MAKE),
    "model: a tensor of another name": (header(lambda each: each.update({EVIL: each.pop(min(each))})), MAKE),
    "model: a width without end": (header(setting("decoder", "width", value=10**8)), MAKE),
    "model: layers without end": (header(setting("network", "num_layers", value=10**8), "denoiser"), MAKE),
    "generated: a file above the folder": (generated(file="../../mine.npz"), ("ingest", "made", "--store", "new")),
    "generated: odd numbers": (generated(fps="1e999", num_frames="9" * 5000), (*GENERATE, "--resume")),
    "generated: captions nested without end": (generated(captions="[" * 100_000), (*GENERATE, "--resume")),
    "generated: a list of files above": (
        document("made/generation.json", files=["../../mine.npz"]),
        (*GENERATE, "--resume"),
    ),
    "results: a value of 400 digits": (
        document("results/nerm-table4.json", blocks__0__rows=[{"name": 10**400}]),
        REPORT,
    ),
    "results: a figure above the folder": (document("results/nerm-table4.json", figure="../../mine.txt"), REPORT),
    "results: a title of script": (document("results/nerm-table4.json", title="<script>alert(1)</script>"), REPORT),
    "results: nested without end": (text("results/deep.json", "[" * 100_000), REPORT),
    "samples: prompts above": (text("samples/samples.toml", 'fps = 20\nprompts = "../../mine.txt"\n'), SAMPLES),
    "samples: a glob of forty stars": (
        text("samples/samples.toml", f'fps = 20\nfiles = ["{"*a" * 40}z.npy"]\n'),
        SAMPLES,
    ),
    "samples: a number of 5,000 digits": (text("samples/samples.toml", f"fps = {'9' * 5000}\n"), SAMPLES),
    "captures: a table names files outside": (
        text("takes/clips.csv", "file,caption,split\n../../mine.txt,x,train\ntake-0.bvh,x,train\n"),
        ("ingest", "takes", "--store", "new", "--workers", "1"),
    ),
    "captures: names of escape sequences": (names, ("ingest", "takes", "--store", "new", "--workers", "1")),
    "captures: names of escape sequences, completed": (names, ("complete", "takes", "--fps", "90", "--out", "new")),
    "captures: names of escape sequences, shown": (names, ("view", "takes", "--out", "new.html", "--json")),
    "captures: captions of escape sequences": (
        text("takes/clips.csv", f'file,caption,split\ntake-0.bvh,"{EVIL}","{EVIL}"\n'),
        ("ingest", "takes", "--store", "new", "--workers", "1"),
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_a_hostile_folder_is_refused_or_harmless(name, motionkit, good, tmp_path, monkeypatch):
    spoil, arguments = SCENES[name]
    folder = tmp_path / "place"
    shutil.copytree(good, folder)
    spoil(folder / "inside")
    monkeypatch.chdir(folder / "inside")
    before = outside(folder)
    done = motionkit(*arguments)
    assert outside(folder) == before
    output = (done.stdout + done.stderr).replace("\r\n", "\n")
    assert done.code in (0, 1, 2) and "Traceback" not in output
    # What `validate` and `samples` find is their output.
    assert done.code == 0 or done.stdout.strip() or "motionkit: " in done.stderr
    assert not CONTROL.search(output) and SECRET not in output
    assert max(map(len, done.stderr.splitlines()), default=0) < 4000


def outside(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file() and not path.is_relative_to(folder / "inside")
    }
