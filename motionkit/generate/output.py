"""The work of a `motionkit generate` call: poses are sampled from generated fields and written into a folder.

generation.json holds the request and is written first; a motion is complete when its main file is there, since files
appear whole. motions.csv lists the complete motions when the call ends, also by an error or Ctrl-C. So a stopped call
can be resumed, and `motionkit ingest` reads the folder with its captions.
"""

import csv
import io
import json
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from motionkit.core.errors import UsageError, shown
from motionkit.core.files import LOCK, locked_folder, read_json, whole_file, write_json, write_whole
from motionkit.core.motion import Motion
from motionkit.core.progress import warn
from motionkit.core.shapes import Float64
from motionkit.core.skeletons.mapping import SkeletonMapError
from motionkit.core.timegrid import TimeGrid
from motionkit.edit.export import TABLE, captions_json
from motionkit.fields.contact.planted import planted
from motionkit.fields.detail import Detail, detailed
from motionkit.fields.motion_field import MotionField, at_fps
from motionkit.generate.constraints import followed
from motionkit.generate.long_motions import (
    OVERLAP_SECONDS,
    Script,
    captions_of,
    check_script,
    constraints_of,
    generate_scripts,
    is_joined,
)
from motionkit.generate.models import GenerativeModel, SamplingOptions
from motionkit.generate.request import MotionsRequest
from motionkit.io import npz
from motionkit.io.registry import Format, writers
from motionkit.training.run import RunFolder, versions

SLUG_LENGTH = 40
MANIFEST = "generation.json"
FORMAT = "motionkit-generation"
ANOTHER = "name another folder with --out"


def sample_motion(field: MotionField, name: str, script: Script, fps: Fraction) -> Motion:
    """A generated field as a motion: frame k at k / fps, in the half-open interval that it lasts.

    Four seconds at 20 fps are 80 frames; `to_motion` would include the frame at the closed end too.
    """
    duration = field.end_seconds - field.start_seconds
    grid = TimeGrid(fps, max(1, int(np.ceil(duration * float(fps) - 1e-6))), field.start_seconds)
    return Motion(
        at_fps(field, fps).query(grid.seconds()).joint_positions,
        field.skeleton,
        grid,
        captions=captions_of(script),
        action=action_of(script),
        sequence_id=name,
    )


def write_instants(path: Path, field: MotionField, script: Script, seconds: Float64[np.ndarray, "times"]) -> None:
    """Write the poses of a field at arbitrary instants as a .npz: `time_seconds`, no framerate."""
    arrays = {
        "joint_positions": field.query(seconds).joint_positions,
        "time_seconds": seconds,
        **npz.skeleton_arrays(field.skeleton),
        **npz.caption_arrays(captions_of(script)),
        "action": np.array(action_of(script)),
        "duration_seconds": np.float64(field.end_seconds - field.start_seconds),
    }
    with whole_file(path) as temporary:
        npz.write_arrays(temporary, arrays)


def plant_generated(field: MotionField, script: Script) -> MotionField:
    """A generated field without foot sliding, with fixed bone lengths (`motionkit.fields.contact`).

    Joints constrained in the world stay in place. Returns the field unchanged, with a warning, if the skeleton's legs
    are unknown.
    """
    is_placed = any(each.frame == "world" for request in script for each in request.constraints)
    try:
        return planted(field, "kept" if is_placed else "free")
    except SkeletonMapError as error:
        warn(f"not planted: {error}")
        return field


def action_of(script: Script) -> str:
    """The action of all requests of a script; empty if they differ."""
    return script[0].action if len({request.action for request in script}) == 1 else ""


def motion_name(index: int, script: Script) -> str:
    """A descriptive file name for the index-th motion: `0003-a-person-walks`."""
    conditions = " ".join(request.text or request.action for request in script).strip() or "unconditional"
    slug = re.sub(r"[^a-z0-9]+", "-", conditions.lower()).strip("-")
    return f"{index:04d}-{slug[:SLUG_LENGTH].strip('-') or 'motion'}"


def output_format(name: str, times: tuple[float, ...] = ()) -> Format:
    """The output format of a name; raises `UsageError` for an unknown one, or one that does not support `times`."""
    formats = writers()
    if name not in formats:
        raise UsageError(f"--format is one of {', '.join(formats)}, not {name!r}")
    if times and name != "npz":
        raise UsageError(f"a {name} file has one framerate: --times goes with --format npz")
    return formats[name]


@dataclass(frozen=True)
class Job:
    """A request, a model of a run, and an output format; motions are planted unless `plant` is false.

    With `detail` motions get captures' motion above 10 Hz, from the same seed (docs/detail.md).

    Raises `UsageError`, with the prompt's file and line, for unsupported requests, before anything is generated.
    """

    request: MotionsRequest
    model: GenerativeModel
    run: Path
    output: Format
    seed: int
    sampling: SamplingOptions
    plant: bool = True
    detail: Detail | None = None

    def __post_init__(self) -> None:
        for prompts in self.request.scripts:
            try:
                check_script(self.model, self.request.script_of(prompts), self.sampling)
            except UsageError as error:
                raise UsageError(f"{prompts[0].where if len(prompts) == 1 else ''}{error}") from None

    @property
    def fps(self) -> Fraction:
        """Framerate of the files."""
        return self.request.fps or self.model.max_training_fps

    @property
    def num_joined(self) -> int:
        """How many motions are joined from several."""
        return sum(is_joined(script, self.model.max_duration_seconds) for script in self.request.motions)

    @cached_property
    def files(self) -> list[str]:
        """The name of each motion's file."""
        suffix = self.output.suffixes[0]
        return [f"{motion_name(*each)}{suffix}" for each in enumerate(self.request.motions)]

    def manifest(self) -> dict[str, Any]:
        """The request and the weights' identity: the same manifest gives the same motions."""
        request = self.request
        conditions = [prompt.request for prompts in request.scripts for prompt in prompts]
        return {
            "format": FORMAT,
            "version": 1,
            "model": self.model.name,
            "weights_sha256": RunFolder(self.run).fingerprints(),
            "seed": self.seed,
            "sampling": asdict(self.sampling),
            "planted": self.plant,
            "with_detail": self.detail is not None,
            "file_format": self.output.name,
            "fps": None if request.times else str(self.fps),
            "times_seconds": list(request.times) or None,
            "max_training_fps": str(self.model.max_training_fps),
            "count": request.count,
            "conditions": [
                {"text": each.text, "action": each.action, "seconds": each.duration_seconds} for each in conditions
            ],
            "joined": any(len(script) > 1 for script in request.scripts),
            "overlap_seconds": OVERLAP_SECONDS if self.num_joined else None,
            "constraints": [each.plain() for each in request.constraints],
            "versions": versions(),
            "files": [*filter(None, [self.output.shared_file]), *self.files],
        }

    def complete_in(self, folder: Path) -> frozenset[int]:
        """Numbers of the motions whose files are in a folder."""
        return frozenset(number for number, file in enumerate(self.files) if (folder / file).is_file())

    def write(self, folder: Path) -> Iterator[dict[str, Any]]:
        """Generate and write missing motions one by one; yields facts about each file as JSON.

        Batches are the same whatever is missing, so a resumed call writes the same numbers.
        """
        try:
            for number, field in generate_scripts(
                self.model, self.request.motions, seed=self.seed, skip=self.complete_in(folder), sampling=self.sampling
            ):
                yield self._write_motion(folder / self.files[number], number, field)
        finally:
            # A row per complete motion, as `motionkit.io.annotations` reads it.
            fps = "" if self.request.times else str(self.fps)
            text = io.StringIO(newline="")
            table = csv.writer(text, lineterminator="\n")
            table.writerow(("file", "captions", "action", "fps"))
            for number in sorted(self.complete_in(folder)):
                script = self.request.motions[number]
                table.writerow((self.files[number], captions_json(captions_of(script)), action_of(script), fps))
            write_whole(folder / TABLE, text.getvalue())

    def _write_motion(self, path: Path, number: int, field: MotionField) -> dict[str, Any]:
        script, times = self.request.motions[number], self.request.times
        if self.plant:
            field = plant_generated(field, script)
        if self.detail is not None:
            field = detailed(field, self.detail, seed=self.seed, number=number)
        if times:
            write_instants(path, field, script, np.array(times, dtype=np.float64))
            num_frames = len(times)
        else:
            motion = sample_motion(field, motion_name(number, script), script, self.fps)
            assert self.output.write is not None
            with whole_file(path) as temporary:
                self.output.write(motion, temporary)
            num_frames = motion.num_frames
        captions = captions_of(script)
        facts = {
            "file": str(path),
            "caption": captions[0].text if len(captions) == 1 else "",
            "captions": [
                {"text": each.text, "start_seconds": each.start_seconds, "end_seconds": each.end_seconds}
                for each in captions
            ],
            "action": action_of(script),
            "duration_seconds": field.end_seconds - field.start_seconds,
            "fps": None if times else str(self.fps),
            "num_frames": num_frames,
        }
        constraints = [asdict(followed(field, each)) for each in constraints_of(script)]
        return facts | ({"constraints": constraints} if constraints else {})


@contextmanager
def locked_output(path: Path, manifest: Mapping[str, Any], *, resume: bool, overwrite: bool) -> Iterator[None]:
    """Hold the lock of a call's folder, which is new, empty, or one to `resume` or `overwrite`; has generation.json.

    Overwriting deletes the files of an earlier call and nothing else. Raises `BusyError` while another process writes
    the folder, `UsageError` for one that is not empty or that another call made, `DamagedFileError`.
    """
    if path.exists() and not path.is_dir():
        raise UsageError(f"{path} is a file: name a folder with --out")
    busy = f"another process is generating into {path}: wait until it has ended, or {ANOTHER}"
    with locked_folder(path, busy=busy):
        if (path / MANIFEST).is_file():
            former = _read_manifest(path)
            if resume:
                _check_same(path, former, manifest)
            elif overwrite:
                # All but generation.json, which the next one replaces.
                for name in (TABLE, *former["files"]):
                    (path / name).unlink(missing_ok=True)
            else:
                keeps = "--resume continues them, --overwrite replaces them, --out FOLDER keeps both"
                raise UsageError(f"{path} holds generated motions: {keeps}")
        elif any(entry.name != LOCK for entry in path.iterdir()):
            raise UsageError(f"{path} is not empty: {ANOTHER}")
        write_json(path / MANIFEST, manifest)
        yield


def _read_manifest(path: Path) -> dict[str, Any]:
    """The generation.json of an earlier call; raises `UsageError` for another file, or names outside the folder."""
    value = read_json(path / MANIFEST, f"delete the folder, or {ANOTHER}")
    files = value.get("files")
    if value.get("format") != FORMAT or not isinstance(files, list):
        raise UsageError(f"{path / MANIFEST} was not written by `motionkit generate`: {ANOTHER}")
    for name in files:
        if not isinstance(name, str) or ".." in PurePosixPath(name).parts or PurePosixPath(name).is_absolute():
            raise UsageError(f"{path / MANIFEST} names {name!r}, which lies outside of the folder: {ANOTHER}")
    return value


def _check_same(path: Path, former: Mapping[str, Any], manifest: Mapping[str, Any]) -> None:
    """Raise `UsageError` for another request, weights or settings than those of generation.json."""
    now = json.loads(json.dumps(dict(manifest)))
    for name in sorted({*former, *now} - {"versions", "files"}):
        if former.get(name) != now.get(name):
            before, after = (shown(each.get(name)) for each in (former, now))
            raise UsageError(
                f"{path} was begun with another {name} ({before}, now {after}): repeat the same call, or {ANOTHER}"
            )
