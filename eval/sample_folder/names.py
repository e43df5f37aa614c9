"""What the names of files say: prompt, repetition, length, caption, action."""

import re
from dataclasses import dataclass
from pathlib import Path

from eval.sample_folder.manifest import Manifest
from motionkit.formats import sourcefile


@dataclass(frozen=True)
class NamedParts:
    """What a file's name says."""

    caption: str = ""
    action: str = ""
    group: str = ""
    num_frames: int | None = None


# MDM's sample00_rep02, MoMask's sample3_repeat0_len196.
PUBLISHED_NAME = re.compile(r"sample_?(?P<group>\d+)_rep(?:eat)?_?\d+(?:_len\d+)?(?:_ik)?")


def named_parts(stem: str, manifest: Manifest) -> NamedParts | None:
    """What a name says by the manifest's `name`, or by a published one; None where it does not fit the manifest's."""
    if manifest.name is None:
        published = PUBLISHED_NAME.fullmatch(stem)
        return NamedParts(group=published["group"]) if published else NamedParts()
    parts = manifest.name.match(stem)
    if parts is None:
        return None
    frames = int(parts["num_frames"]) if parts.get("num_frames") else None
    words = {key: parts.get(key, "").replace("_", " ").strip() for key in ("caption", "action")}
    return NamedParts(**words, group=parts.get("group", ""), num_frames=frames)


def read_prompts(path: Path) -> tuple[str, ...]:
    """Captions of a text file, one a line; what follows a `#` (a length, HumanML3D's tokens) is dropped."""
    lines = sourcefile.decode(sourcefile.read_bytes(path), path).splitlines()
    return tuple(line.split("#")[0].strip() for line in lines)
