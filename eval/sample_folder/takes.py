"""Matches samples of another system to real takes, by name or by caption."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

from eval.sample_folder.folder import SampleFolder
from eval.sets.motions import RealMotion
from eval.sets.sets import SampleSet


def rows_by_name(sample_ids: Sequence[str], real_ids: Sequence[str]) -> list[int | None]:
    """The row of the real sequence whose id is a sample's name, or its file's stem."""
    by_name = {name: row for row, name in enumerate(real_ids)}
    stems = [name.rsplit("/", 1)[-1].rsplit(".", 1)[0] for name in sample_ids]
    return [by_name.get(name, by_name.get(stem)) for name, stem in zip(sample_ids, stems, strict=True)]


@dataclass(frozen=True)
class TakesOfSamples:
    """The real take of each motion of a folder, "" for none; all "" if neither names nor captions match."""

    takes: tuple[str, ...]

    @property
    def num_without(self) -> int:
        """Number of motions without a real take, in a folder where others have one."""
        return self.takes.count("") if any(self.takes) else 0

    def of_column(self, samples: SampleSet, real: SampleSet) -> SampleSet | None:
        """The samples for a column's takes, each with its take and generation; None if there are none.

        Without known takes, all samples; those of one prompt are then resampled together.
        """
        if not any(self.takes):
            return replace(samples, takes=samples.groups)
        wanted = set(real.sequence_ids)
        chosen = [index for index, take in enumerate(self.takes) if take in wanted]
        if not chosen:
            return None
        takes = tuple(self.takes[index] for index in chosen)
        seen: dict[str, int] = defaultdict(int)
        generations = []
        for take in takes:
            generations.append(seen[take])
            seen[take] += 1
        several = max(generations) > 0
        return replace(samples.select(chosen), takes=takes, generations=tuple(generations) if several else ())


def takes_of_samples(folder: SampleFolder, real: RealMotion) -> TakesOfSamples:
    """Match by names if most of them are real sequences', else by captions.

    Prompts with the same caption are assigned to its takes in turn, the fastest first, so that a single sample of a
    caption is used at as many framerates as possible. Samples of one prompt have one take.
    """
    named = rows_by_name(folder.sequence_ids, real.sequence_ids)
    if 2 * sum(row is not None for row in named) > len(named):
        return TakesOfSamples(tuple("" if row is None else real.sequence_ids[row] for row in named))
    by_caption: dict[str, list[int]] = defaultdict(list)
    for row in sorted(range(len(real.fps)), key=lambda row: -real.fps[row]):
        if real.captions[row]:
            by_caption[real.captions[row]].append(row)
    take_of_group: dict[str, str] = {}
    answered: dict[str, int] = defaultdict(int)
    for group, caption in zip(folder.groups, folder.captions, strict=True):
        takes = by_caption.get(caption)
        if takes and group not in take_of_group:
            take_of_group[group] = real.sequence_ids[takes[answered[caption] % len(takes)]]
            answered[caption] += 1
    return TakesOfSamples(tuple(take_of_group.get(group, "") for group in folder.groups))
