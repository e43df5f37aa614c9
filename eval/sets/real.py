"""Real motion as sample sets: the sequences of a store that were captured at s fps or faster, brought to s fps."""

from dataclasses import dataclass, field
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from eval.sets.sets import Ragged, SampleSet, sample_set
from motionkit.core.errors import MotionkitError
from motionkit.core.skeleton import SMPL22
from motionkit.fields.resample import resample_positions
from motionkit.store.sql import conjunction

if TYPE_CHECKING:
    from motionkit.store.cache import PositionCache
    from motionkit.store.reader import Store


class NoRealMotionError(MotionkitError):
    """A store without real motion at the requested framerate."""


@dataclass(eq=False)
class RealMotion:
    """Sequences at their native framerates; `at` resamples them once per framerate and keeps the result.

    They have 22 joints or KIT-ML's 21; sequence i is at fps[i].
    """

    name: str
    sequences: Ragged
    fps: tuple[Fraction, ...]
    sequence_ids: tuple[str, ...]
    captions: tuple[str, ...]
    actions: tuple[str, ...]
    _made: dict[tuple[Fraction, int], SampleSet] = field(default_factory=dict)

    def indices_at(self, fps: Fraction, first_frame: int = 0) -> npt.NDArray[np.int64]:
        """Sequences whose native framerate is at least `fps`, with at least two frames after the first ones.

        Raises `NoRealMotionError` for fewer than two sequences.
        """
        lengths = self.sequences.num_frames
        chosen = [i for i, native in enumerate(self.fps) if native >= fps and lengths[i] > first_frame + 1]
        if len(chosen) < 2:
            fastest = f"; the fastest has {float(max(self.fps)):.6g} fps" if self.fps else ""
            raise NoRealMotionError(
                f"{self.name}: {len(chosen)} of {len(self.fps)} sequences were captured at {float(fps):.6g} fps or "
                f"faster, at least two are needed{fastest}: choose framerates with --fps, or hold out more takes "
                "(motionkit split --shares train=0.7,test=0.3, with --by sequence_id where no performer is named)"
            )
        return np.array(chosen, dtype=np.int64)

    def at(self, fps: Fraction, first_frame: int = 0) -> SampleSet:
        """Every sequence of native rate ≥ fps at exactly fps, anti-aliased; slower ones are left out.

        `first_frame` drops that many native frames first, which shifts the grid. Raises `NoRealMotionError` where
        fewer than two sequences remain.
        """
        key = (fps, first_frame)
        if key not in self._made:
            chosen = self.indices_at(fps, first_frame).tolist()
            self._made[key] = sample_set(
                self.name,
                fps,
                [resample_positions(self.sequences[index][first_frame:], self.fps[index], fps) for index in chosen],
                [self.sequence_ids[index] for index in chosen],
                [self.captions[index] for index in chosen],
                [self.actions[index] for index in chosen],
            )
        return self._made[key]

    def forget_all_but(self, fps: Fraction) -> None:
        """Drop cached sets of other framerates; `at` computes them again."""
        for key in [key for key in self._made if key[0] != fps]:
            del self._made[key]


def of_split(split: str) -> str:
    """The SQL condition for the sequences of one split, whatever its name."""
    quoted = split.replace("'", "''")
    return f"split = '{quoted}'"


def of_split_and(split: str, where: str | None) -> str | None:
    """The SQL condition for the sequences of a split ("all": any) that match `where` too; None for all."""
    return conjunction(None if split == "all" else of_split(split), where) or None


def real_motion(store: "Store", split: str, where: str | None = None, layout: str = SMPL22.name) -> RealMotion:
    """The sequences of one split of a store ("all": every one) for which `where` (SQL) holds, in a joint layout.

    A sequence's caption is its first. Raises `UsageError` if the split is empty or its skeletons cannot be mapped.
    """
    from motionkit.store.cache import open_cache

    cache = open_cache(store, layout=layout, where=of_split_and(split, where))
    return _from_cache(store, cache, split)


def has_training(store: "Store") -> bool:
    """Whether a store has a training split."""
    return bool((store.columns("split")["split"] == "train").any())


def training_motion(store: "Store", compared: RealMotion) -> RealMotion:
    """The set to fit features on: the training split, or the compared sequences without one."""
    return real_motion(store, "train") if has_training(store) else compared


def _from_cache(store: "Store", cache: "PositionCache", split: str) -> RealMotion:
    table = store.columns("sequence_id", "captions", "action").loc[cache.sequence_index]
    captions = tuple(str(found[0]["text"]) if len(found) else "" for found in table["captions"])
    rates = zip(cache.fps_numerator.tolist(), cache.fps_denominator.tolist(), strict=True)
    return RealMotion(
        name=f"real ({split})",
        sequences=Ragged(cache.positions, cache.start_row.astype(np.int64), cache.num_frames.astype(np.int64)),
        fps=tuple(Fraction(numerator, denominator) for numerator, denominator in rates),
        sequence_ids=tuple(table["sequence_id"].astype(str)),
        captions=captions,
        actions=tuple(table["action"].astype(str)),
    )
