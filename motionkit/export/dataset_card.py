"""The card of a Parquet data set: what the Hub reads (YAML) and what people read, from what was really written."""

from collections import Counter, defaultdict
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import pyarrow as pa

from motionkit.export.templates import render
from motionkit.motion import Motion
from motionkit.timegrid import format_fps

# The Hub's names of licences that motion captures come with (huggingface.co/docs/hub/repositories-licenses).
HUB_LICENCES = (
    *("mit", "apache-2.0", "bsd-3-clause", "cc0-1.0", "odc-by", "pddl", "unlicense"),
    *(f"cc-by{kind}-{version}" for kind in ("", "-sa", "-nc", "-nd", "-nc-sa", "-nc-nd") for version in ("3.0", "4.0")),
)
SIZE_CATEGORIES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
NO_LICENCE = "not stated"


class Tally:
    """Counts what goes into a data set; owns the counts."""

    def __init__(self) -> None:
        self.num_sequences = 0
        self.num_captions = 0
        self.hours = 0.0
        self.bytes_by_split: Counter[str] = Counter()
        self.sequences_by_split: Counter[str] = Counter()
        self.hours_by_split: defaultdict[str, float] = defaultdict(float)
        self.sequences_by_fps: Counter[Fraction] = Counter()
        self.hours_by_fps: defaultdict[Fraction, float] = defaultdict(float)
        self.sequences_by_licence: Counter[tuple[str, str]] = Counter()
        self.sequences_by_skeleton: Counter[tuple[str, int]] = Counter()

    def add(self, motion: Motion, split: str) -> None:
        """Count one sequence."""
        hours = motion.duration_seconds / 3600
        self.num_sequences += 1
        self.num_captions += len(motion.captions)
        self.hours += hours
        arrays = (motion.joint_positions, motion.local_rotations, motion.root_translation)
        self.bytes_by_split[split] += sum(array.nbytes for array in arrays if array is not None)
        self.sequences_by_split[split] += 1
        self.hours_by_split[split] += hours
        self.sequences_by_fps[motion.fps] += 1
        self.hours_by_fps[motion.fps] += hours
        provenance = motion.provenance
        self.sequences_by_licence[provenance.source, provenance.licence or NO_LICENCE] += 1
        self.sequences_by_skeleton[motion.skeleton.name, motion.skeleton.num_joints] += 1


def card(tally: Tally, num_files: Mapping[str, int], schema: pa.Schema, meaning: Mapping[str, str], data: Path) -> str:
    """The text of README.md for the files in `data`; `meaning` says what columns hold whose names do not."""
    names = sorted({licence for _, licence in tally.sequences_by_licence})
    known = [_hub_licence(name) for name in names]
    return render(
        "dataset_card.md.j2",
        tally=tally,
        num_files=num_files,
        licences=known if all(known) else ["other"],
        licence_name="; ".join(names),
        size_category=next((name for limit, name in SIZE_CATEGORIES if tally.num_sequences < limit), "n>1M"),
        features=[_feature(field.name, field.type) for field in schema],
        columns=[(field.name, _type_name(field.type), meaning.get(field.name, "")) for field in schema],
        download_size=sum(path.stat().st_size for path in data.iterdir()),
        fps_names={fps: _fps_name(fps) for fps in tally.sequences_by_fps},
    )


def _hub_licence(name: str) -> str:
    plain = "-".join(name.lower().replace("creative commons", "cc").replace("_", "-").split())
    return plain if plain in HUB_LICENCES else ""


def _fps_name(fps: Fraction) -> str:
    return format_fps(fps) if fps.denominator == 1 else f"{float(fps):.6g} ({format_fps(fps)})"


def _feature(name: str, kind: pa.DataType) -> dict[str, Any]:
    """A column as `datasets` writes it in YAML."""
    if not pa.types.is_list(kind):
        return {"name": name, "dtype": _type_name(kind)}
    if pa.types.is_struct(kind.value_type):
        return {"name": name, "list": [_feature(field.name, field.type) for field in kind.value_type]}
    return {"name": name, "list": _type_name(kind.value_type)}


def _type_name(kind: pa.DataType) -> str:
    if pa.types.is_list(kind):
        return "list of structs" if pa.types.is_struct(kind.value_type) else f"list of {_type_name(kind.value_type)}"
    return {"float": "float32", "double": "float64"}.get(str(kind), str(kind))
