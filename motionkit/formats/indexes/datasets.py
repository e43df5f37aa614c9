"""AMASS' datasets by all the names that their folders have, and keys under which all spellings of a file are equal."""

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources

Key = tuple[str, ...]

# SMPL+H files are called NAME_poses, SMPL-X files NAME_stageii.
ENDINGS = ("_poses", "_stageii")


@dataclass(frozen=True)
class Dataset:
    """One dataset: its folder's name in AMASS' first release, and how HumanML3D read its files.

    `trim_frames` are dropped before it counts; `seen_fps` is what its code saw where a file may say something else, by
    the folder of a subject, under "" for all others.
    """

    name: str
    trim_frames: int = 0
    seen_fps: Mapping[str, float] = field(default_factory=dict)

    def seen_fps_of(self, parts: Sequence[str]) -> float | None:
        """What HumanML3D's code saw of a file by its path; None where nothing else than the file says it."""
        return next((self.seen_fps[part] for part in (*parts, "") if part in self.seen_fps), None)


def dataset_of(parts: Sequence[str]) -> tuple[Dataset, int] | None:
    """The dataset that a path's folders name and that folder's position; of several the last, since some are nested."""
    known = _known()
    for position in range(len(parts) - 2, -1, -1):
        found = known.get(_plain(parts[position]))
        if found is not None:
            return found, position
    return None


def file_key(parts: Sequence[str]) -> Key:
    """What stays of a file's path when spelling is taken away: the dataset's name, the folders below it, the file.

    Case, runs of blanks and underscores, `_poses` and `_stageii`, and the file's suffix don't count; without a known
    dataset the path counts from its beginning.
    """
    found = dataset_of(parts)
    first = 0 if found is None else found[1] + 1
    head = () if found is None else (found[0].name,)
    return (*head, *(_spelling(part) for part in parts[first:-1]), _spelling(stem(parts[-1])))


def stem(name: str) -> str:
    """A file's name without suffix and without AMASS' endings."""
    plain = name.rpartition(".")[0] or name
    for ending in ENDINGS:
        plain = plain.removesuffix(ending)
    return plain


@cache
def _known() -> Mapping[str, Dataset]:
    table = tomllib.loads(resources.files(__package__).joinpath("datasets.toml").read_text(encoding="utf-8"))
    known: dict[str, Dataset] = {}
    for entry in table["dataset"]:
        dataset = Dataset(entry["name"], entry.get("trim_frames", 0), entry.get("seen_fps", {}))
        known |= {_plain(name): dataset for name in (entry["name"], *entry.get("also", ()))}
    return known


@cache
def _plain(name: str) -> str:
    return re.sub(r"[\W_]", "", name.casefold())


def _spelling(part: str) -> str:
    return re.sub(r"[\s_]+", "_", part.strip()).casefold()
