"""A summary of a folder of samples, for people and as plain values."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from eval.sample_folder.bodies import some_poses, standing_metres
from eval.sample_folder.folder import SampleFolder

SHOWN_SIZES = 4


@dataclass(frozen=True)
class Findings:
    """Counts and sizes of the motions that were read, and problems of those that were not.

    `frames` are minimum, median and maximum; `framerates` counts motions, `prompt_sizes` prompts by their number of
    motions. `body_metres` is the median length from ankle to head, `reach_metres` the largest distance of a root from
    its start.
    """

    name: str
    num_motions: int
    duration_seconds: float
    frames: tuple[int, int, int]
    framerates: Mapping[str, int]
    num_captioned: int
    num_different_captions: int
    num_with_action: int
    actions: Mapping[str, int]
    prompt_sizes: Mapping[int, int]
    body_metres: float
    reach_metres: float
    remarks: tuple[str, ...]
    left_out: tuple[str, ...]


def summarise(folder: SampleFolder) -> Findings:
    """Summarise motions that were read."""
    poses = some_poses(list(folder.sequences))
    path = poses[:, :, 0, ::2] - poses[:, :1, 0, ::2]
    prompts = Counter(Counter(folder.groups).values())
    return Findings(
        name=folder.name,
        num_motions=folder.num_motions,
        duration_seconds=folder.duration_seconds,
        frames=(
            int(folder.sequences.num_frames.min()),
            int(np.median(folder.sequences.num_frames)),
            int(folder.sequences.num_frames.max()),
        ),
        framerates={str(fps): count for fps, count in sorted(Counter(folder.fps).items())},
        num_captioned=sum(map(bool, folder.captions)),
        num_different_captions=len({caption for caption in folder.captions if caption}),
        num_with_action=sum(map(bool, folder.actions)),
        actions=dict(Counter(action for action in folder.actions if action).most_common()),
        prompt_sizes=dict(sorted(prompts.items())),
        body_metres=standing_metres(poses),
        reach_metres=float(np.linalg.norm(path, axis=-1).max()),
        remarks=folder.remarks,
        left_out=tuple(map(str, folder.left_out)),
    )


def lines(found: Findings) -> Iterator[tuple[str, str]]:
    """The summary as lines: a label, and the text."""
    low, middle, high = found.frames
    yield (
        "motions",
        f"{found.num_motions:,}, {found.duration_seconds / 60:.1f} min, {low} to {high} frames (median {middle})",
    )
    rates = ", ".join(f"{fps} fps ({count:,})" for fps, count in found.framerates.items())
    yield "framerate", rates + ("" if len(found.framerates) == 1 else ": mixed; each motion is resampled by its own")
    yield "captions", _share(found.num_captioned, found.num_motions, f"{found.num_different_captions:,} different")
    yield "actions", _share(found.num_with_action, found.num_motions, f"{len(found.actions):,} different")
    sizes = sorted(found.prompt_sizes.items(), key=lambda entry: -entry[1])[:SHOWN_SIZES]
    yield "prompts", ", ".join(f"{count:,} with {size:,} motion{'s'[: size > 1]} each" for size, count in sizes)
    yield "bodies", f"{found.body_metres:.2f} m from ankle to head; roots get up to {found.reach_metres:.1f} m away"
    for remark in found.remarks:
        yield "note", remark
    for problem in found.left_out:
        yield "left out", problem


def _share(count: int, of: int, more: str) -> str:
    if not count:
        return "none"
    return f"{count:,}, {more}" if count == of else f"{count:,} of {of:,}, {more}"
