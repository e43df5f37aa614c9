"""Data sets of BVH files: LaFAN1 and 100STYLE.

LaFAN1 is in centimetres at 30 fps, `walk1_subject1.bvh`. Source:
https://github.com/ubisoft/ubisoft-laforge-animation-dataset (README.md: names and themes; evaluate.py: the actors of
both sets). The same names at 60 fps are https://github.com/orangeduck/lafan1-resolved, read the same way.

100STYLE is at 60 fps, `Style/Style_FW.bvh`, cut to the frames listed in `Frame_Cuts.csv`. The table has a row for each
style: `STYLE_NAME`, then for each kind of movement `BR_START`, `BR_STOP`, … (`N/A` if there is no such file); frames
outside are calibration and approach. Source: I. Mason, S. Starke, T. Komura, "Real-Time Style Modelling of Human
Locomotion via Feature-Wise Transformations and Local Motion Phases", 2022, https://www.ianxmason.com/100style/.
"""

import csv
import re
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from motionkit.core.errors import FormatError, shown
from motionkit.core.files import whole_number
from motionkit.core.timegrid import TimeGrid
from motionkit.io import source_file
from motionkit.io.bvh import BvhDocument, read_document
from motionkit.io.registry import FileHead, ReadOptions

# LaFAN1
THEMES = (
    *("aiming", "dance", "fallAndGetUp", "fight", "fightAndSports", "ground", "jumps", "multipleActions", "obstacles"),
    *("push", "pushAndFall", "pushAndStumble", "run", "sprint", "walk"),
)
LAFAN1_NAME = re.compile(rf"(?P<theme>{'|'.join(THEMES)})(?P<take>\d+)_(?P<subject>subject\d+)", re.IGNORECASE)
TRAIN_SUBJECTS = ("subject1", "subject2", "subject3", "subject4")
TEST_SUBJECTS = ("subject5",)
# 100STYLE
CUTS_FILE = "Frame_Cuts.csv"
STYLE_COLUMN = "STYLE_NAME"
ACTIONS: dict[str, str] = source_file.shipped("io/bodies.toml")["100style"]
STYLE_AND_KIND = re.compile(rf"(?P<style>[A-Za-z0-9]+)_(?P<kind>{'|'.join(ACTIONS)})", re.IGNORECASE)
ABSENT = ("", "n/a", "nan", "none")


def read_lafan1(path: Path, options: ReadOptions = ReadOptions(), *, strict: bool = False) -> BvhDocument:
    """Read one take with its theme as the action, its subject, and the benchmark's split: subject 5 is the test set.

    The root's OFFSET, a take's starting position, is set to zero, so that takes of one subject share their skeleton;
    position channels replace it anyway. Raises `FormatError` as `read_document` does.
    """
    document = read_document(path, options, strict=strict)
    motion = document.motion
    offsets = motion.skeleton.offsets.copy()
    offsets[0] = 0.0
    name = LAFAN1_NAME.fullmatch(path.stem)
    subject = name["subject"].lower() if name else ""
    motion = replace(
        motion,
        skeleton=replace(motion.skeleton, name="lafan1", offsets=offsets),
        action=name["theme"] if name else "",
        split="test" if subject in TEST_SUBJECTS else "train" if subject in TRAIN_SUBJECTS else "",
        provenance=replace(motion.provenance, source_format="lafan1", subject=subject),
    )
    return replace(document, motion=motion)


def find_cuts(path: Path) -> Path | None:
    """The table of cuts of a file: in its folder, or in the one above."""
    return next((folder / CUTS_FILE for folder in path.parents[:2] if (folder / CUTS_FILE).is_file()), None)


def read_100style(path: Path, options: ReadOptions = ReadOptions(), *, strict: bool = False) -> BvhDocument:
    """Read frames [START, STOP) of one take, counted from 0, with its style and movement.

    Times count from the first frame kept. Raises `FormatError` as `read_document` does, and with the reason
    `frame-cuts` if the table has no cut for the take, or one outside it.
    """
    document = read_document(path, options, strict=strict)
    name, table = STYLE_AND_KIND.fullmatch(path.stem), find_cuts(path)
    if name is None or table is None:
        message = f"expected a name such as Aeroplane_FW and {CUTS_FILE} beside it or one folder above"
        raise FormatError(message, path=path, reason="frame-cuts")
    dropped = int(document.has_reference)
    total = document.motion.num_frames + dropped
    kind = name["kind"].upper()
    cut = _cuts(table, table.stat().st_mtime_ns).get((name["style"].lower(), kind))
    if cut is None:
        message = f"{table.name} has no {kind}_START and {kind}_STOP for the style {name['style']}; add them"
        raise FormatError(message, path=path, reason="frame-cuts")
    start, stop = cut
    if not dropped <= start < stop <= total:
        message = f"{table.name} keeps frames [{start}, {stop}) of {total}; expected frames that the file has"
        raise FormatError(message, path=path, reason="frame-cuts")
    kept = document.frames(start - dropped, stop - dropped)
    motion = replace(
        kept.motion,
        timegrid=TimeGrid(kept.motion.fps, stop - start),
        action=ACTIONS[kind],
        style=name["style"],
        provenance=replace(kept.motion.provenance, source_format="100style"),
    )
    return replace(kept, motion=motion.logged(f"frames [{start}, {stop}) of {total} kept, as {table.name} says"))


@lru_cache(maxsize=8)  # read once for the takes of a corpus
def _cuts(table: Path, modified: int) -> Mapping[tuple[str, str], tuple[int, int]]:
    """All cuts of a table by style (lower case) and kind."""
    text = source_file.decode(source_file.read_bytes(table), table)
    cuts: dict[tuple[str, str], tuple[int, int]] = {}
    try:
        reader = csv.DictReader(text.splitlines(), restkey="")
        if STYLE_COLUMN not in (reader.fieldnames or ()):
            message = f"no column {STYLE_COLUMN!r}, expected it and {next(iter(ACTIONS))}_START, …_STOP"
            raise FormatError(message, path=table, reason="frame-cuts", line=1)
        for row in reader:
            for kind in ACTIONS:
                cells = [(row.get(f"{kind}_{end}") or "").strip() for end in ("START", "STOP")]
                if all(cell.lower() in ABSENT for cell in cells):
                    continue
                # Tables saved by a spreadsheet or pandas have 120.0 for 120.
                start, stop = (whole_number(cell.removesuffix(".0")) for cell in cells)
                if start is None or stop is None:
                    message = f"{' and '.join(map(shown, cells))}, expected two frame numbers or N/A"
                    raise FormatError(message, path=table, reason="frame-cuts", line=reader.line_num)
                cuts[(row[STYLE_COLUMN] or "").strip().lower(), kind] = start, stop
    except csv.Error as error:
        raise FormatError(f"not a CSV table ({error})", path=table, reason="frame-cuts") from None
    return cuts


def is_lafan1(head: FileHead) -> bool:
    """Whether a file has LaFAN1's form of name."""
    return LAFAN1_NAME.fullmatch(head.path.stem) is not None


def is_100style(head: FileHead) -> bool:
    """Whether a file has 100STYLE's form of name, and a table of cuts."""
    return STYLE_AND_KIND.fullmatch(head.path.stem) is not None and find_cuts(head.path) is not None
