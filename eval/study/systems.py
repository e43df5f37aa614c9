"""Systems of a study: folders of samples, real motion, the model of a run."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from eval.sample_folder import SampleFolder
from eval.sets.motions import RealMotion, is_unconditional, upsampled_positions
from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float32
from motionkit.fields.contact.planted import planted
from motionkit.fields.motion_field import to_motion
from motionkit.fields.resample import resample_positions
from motionkit.generate.models import GenerationRequest, GenerativeModel

Positions = Float32[np.ndarray, "frames 22 3"]


@dataclass(frozen=True, eq=False)
class System:
    """One system's motions: id, caption ("" for none), seconds and highest framerate of each.

    `positions(i, fps)` are motion i's 22 joints in metres, y up, at a framerate. `fastest` None is any framerate.
    """

    name: str
    motion_ids: tuple[str, ...]
    captions: tuple[str, ...]
    seconds: tuple[float, ...]
    positions: Callable[[int, Fraction], Positions]
    fastest: tuple[Fraction, ...] | None = None

    def has(self, index: int, fps: Fraction) -> bool:
        """Whether motion `index` is available at a framerate."""
        return self.fastest is None or self.fastest[index] >= fps


def of_folder(folder: SampleFolder) -> System:
    """Samples, upsampled by SLERP or anti-aliased, as in tables."""

    def positions(index: int, fps: Fraction) -> Positions:
        own, frames = folder.fps[index], folder.sequences[index]
        return upsampled_positions(frames, own, fps) if own < fps else resample_positions(frames, own, fps)

    return System(folder.name, folder.sequence_ids, folder.captions, _seconds(folder), positions)


def of_real(real: RealMotion) -> System:
    """Real motion at framerates up to that of its capture."""

    def positions(index: int, fps: Fraction) -> Positions:
        return resample_positions(real.sequences[index], real.fps[index], fps)

    return System("real motion", real.sequence_ids, real.captions, _seconds(real), positions, real.fps)


def of_model(model: GenerativeModel, beside: Sequence[System], seed: int, longest_seconds: float) -> System:
    """A model's planted motions for the captions and lengths of other systems, as `motionkit generate` writes them.

    Motions are generated lazily.
    """
    prompts: dict[str, float] = {}
    for system in beside:
        for caption, length in zip(system.captions, system.seconds, strict=True):
            prompts.setdefault(caption, min(length, longest_seconds, model.max_duration_seconds))
    prompts.pop("", None)
    if not prompts or (is_unconditional(model)):
        lengths = [min(each, longest_seconds, model.max_duration_seconds) for each in beside[0].seconds]
        requests = [GenerationRequest(length) for length in lengths]
    else:
        requests = [GenerationRequest(length, caption) for caption, length in prompts.items()]

    def positions(index: int, fps: Fraction) -> Positions:
        (field,) = model.generate([requests[index]], seed=seed, first=index)
        return to_motion(planted(field, "free"), fps).joint_positions

    ids = tuple(f"{model.name}#{number}" for number in range(len(requests)))
    captions, seconds = tuple(each.text for each in requests), tuple(each.duration_seconds or 0.0 for each in requests)
    return System(model.name, ids, captions, seconds, positions)


def _seconds(motions: SampleFolder | RealMotion) -> tuple[float, ...]:
    return tuple(float(int(n) / fps) for n, fps in zip(motions.sequences.num_frames, motions.fps, strict=True))


def require_two(systems: Sequence[System]) -> None:
    """Raise `UsageError` for fewer than two systems, and for two of one name."""
    names = [system.name for system in systems]
    if len(names) < 2:
        raise UsageError("a study compares two systems: name folders with --samples NAME=DIR, a --run, a --store")
    if len(set(names)) < len(names):
        raise UsageError(f"two systems have the same name ({', '.join(names)}): give every folder its own")
