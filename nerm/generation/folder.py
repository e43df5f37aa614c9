"""The folder of one `motionkit generate` call: generation.json says what was asked for, motions.csv what is there.

generation.json is written first and never changes; motions.csv gains a line when a motion's files are complete. So a
call that was stopped goes on where it was, and `motionkit ingest` reads the folder with its captions.
"""

import csv
import json
import os
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any, TextIO

from motionkit.errors import UsageError
from motionkit.export.files import TABLE, captions_json
from motionkit.generate.samples import GeneratedSample
from motionkit.plain_text import parse_json
from motionkit.timegrid import format_fps
from motionkit.training.run import write_json
from nerm.generation.files import OUTPUTS

MANIFEST = "generation.json"
FORMAT = "motionkit-generation"
# As motionkit.formats.annotations reads them; seconds and num_frames are for people.
COLUMNS = ("file", "captions", "action", "fps", "seconds", "num_frames")
# What may differ between a call and the one that it resumes.
ABOUT_THE_MACHINE = "versions"


class GeneratedFolder:
    """Writes motions.csv line by line; `num_done` motions were complete when it was opened."""

    def __init__(self, path: Path, num_done: int) -> None:
        self.path, self.num_done = path, num_done
        self._handle: TextIO = (path / TABLE).open("a", encoding="utf-8", newline="")
        self._table = csv.DictWriter(self._handle, COLUMNS, lineterminator="\n")
        if not self._handle.tell():
            self._table.writeheader()

    def __enter__(self) -> "GeneratedFolder":
        return self

    def __exit__(self, *raised: object) -> None:
        self._handle.close()

    def add(self, place: PurePosixPath, sample: GeneratedSample) -> None:
        """Note that a motion's files are complete."""
        self._table.writerow(
            {
                "file": place.as_posix(),
                "captions": captions_json(sample.captions),
                "action": sample.action,
                "fps": "" if sample.fps is None else format_fps(sample.fps),
                "seconds": repr(sample.duration_seconds),
                "num_frames": len(sample.seconds),
            }
        )
        self._handle.flush()


def begin_folder(path: Path, manifest: Mapping[str, Any]) -> GeneratedFolder:
    """Begin a new or empty folder; raises `UsageError` for one that holds something."""
    if path.exists() and not path.is_dir():
        raise UsageError(f"{path} is a file: name a folder with --out")
    if path.exists() and any(path.iterdir()):
        if (path / MANIFEST).is_file():
            raise UsageError(
                f"{path} holds generated motions: --resume goes on with them, --overwrite replaces them, --out FOLDER "
                "keeps both"
            )
        raise UsageError(f"{path} is not empty: name another folder with --out")
    path.mkdir(parents=True, exist_ok=True)
    write_json(path / MANIFEST, dict(manifest))
    return GeneratedFolder(path, 0)


def resume_folder(path: Path, manifest: Mapping[str, Any]) -> GeneratedFolder:
    """Go on with a folder that the same call began, or begin it; raises `UsageError` where another call made it."""
    if not (path / MANIFEST).is_file():
        return begin_folder(path, manifest)
    _refuse_links(path)
    found, asked = _read_manifest(path), json.loads(json.dumps(dict(manifest)))
    differing = [
        name
        for name in {**asked, **found}
        if name != ABOUT_THE_MACHINE and found.get(name, ABOUT_THE_MACHINE) != asked.get(name, ABOUT_THE_MACHINE)
    ]
    if differing:
        name = differing[0]
        raise UsageError(
            f"{path} was begun with another {name} ({_short(found.get(name))}, now {_short(asked.get(name))}): repeat "
            "the same call, or name another folder with --out"
        )
    return GeneratedFolder(path, len(_complete_rows(path / TABLE)))


def replace_folder(path: Path, manifest: Mapping[str, Any]) -> GeneratedFolder:
    """Delete the files of a former call, and nothing else, then begin again."""
    if not (path / MANIFEST).is_file():
        return begin_folder(path, manifest)
    _refuse_links(path)
    former = OUTPUTS[str(_read_manifest(path)["file_format"])]
    places = [PurePosixPath(name) for name in former.shared]
    for row in _complete_rows(path / TABLE):
        # By its name alone: whatever a table says, nothing outside the folder is touched.
        places += former.files(PurePosixPath(row["file"]).stem)
    for place in places:
        (path / place).unlink(missing_ok=True)
    (path / TABLE).unlink(missing_ok=True)
    write_json(path / MANIFEST, dict(manifest))
    return GeneratedFolder(path, 0)


def _read_manifest(path: Path) -> dict[str, Any]:
    try:
        value = parse_json((path / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"{path / MANIFEST} cannot be read ({error}): name another folder with --out") from None
    if not isinstance(value, dict) or value.get("format") != FORMAT or str(value.get("file_format")) not in OUTPUTS:
        raise UsageError(f"{path / MANIFEST} is not of `motionkit generate`: name another folder with --out")
    return value


def _complete_rows(table: Path) -> list[dict[str, str]]:
    """The rows of motions.csv; a last line that was cut short is cut off."""
    if not table.is_file():
        return []
    data = table.read_bytes()
    whole = data[: data.rfind(b"\n") + 1]
    if len(whole) < len(data):
        table.write_bytes(whole)
    try:
        rows = list(csv.DictReader(whole.decode("utf-8").splitlines()))
    except (UnicodeDecodeError, csv.Error) as error:
        raise UsageError(f"{table} cannot be read ({error}): name another folder with --out") from None
    if not all(row.get("file") and "\0" not in row["file"] for row in rows):
        raise UsageError(f"{table} has a row without a file: name another folder with --out")
    return rows


def _refuse_links(path: Path) -> None:
    """Raise `UsageError` for a link below the folder: what is written or deleted there would be somebody else's."""
    for folder, folders, files in os.walk(path):
        entries = (Path(folder, name) for name in (*folders, *files))
        link = next((entry for entry in entries if entry.is_symlink()), None)
        if link is not None:
            raise UsageError(f"{link} is a link: nothing is written or deleted through it; name another folder")


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}…"
