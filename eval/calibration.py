"""Calibration of clip-FID and the detail profile: what they see of damaged motion, and what they are blind to.

clip-FID must rise with damage of slow motion and stay flat under harmless transforms; every damage must be seen by it
or by a figure of the profile; and no game may hide from all of them that motion was upsampled or low-passed.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from eval.clip_fid.score import Comparison
from eval.detail import LEAST_FPS, DetailProfile, RealDetail
from eval.metrics.number import Number
from eval.sets.damage import Family, damages, games, shift_between_frames, translate, turn
from eval.sets.sets import SampleSet
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import SMPL22

TASK = "calibration"
VERSION = "calibration/5"
CLEAN = "clean (absolute)"
DISJOINT = "disjoint halves of the takes (P2)"
FLAT = "flat: "
"""Row names in a result: the same-take floor, the floor of disjoint takes, the prefix of harmless transforms."""
SHIFTED, MIRRORED = "native grid shifted by one frame", "left and right exchanged"
"""Harmless transforms; people are right-handed, so mirrored motion need only be nearer than other takes are."""
SLOW_DAMAGE = ("foot-sliding", "floor-height", "frozen-feet")
"""Families whose severity clip-FID has to follow: those that damage slow motion at every strength."""
MIN_SPEARMAN = 0.95
MAX_FLAT_RATIO = 1.5
"""A harmless transform may raise the score to this multiple of the same-take floor."""


@dataclass(frozen=True)
class Scored:
    """One set: its clip-FID, and its detail profile; None below 40 fps."""

    clip_fid: Number
    detail: DetailProfile | None

    @property
    def has_real_detail(self) -> bool:
        """Whether no figure of the profile sees the set."""
        return self.detail is None or all(figure.is_real for figure in self.detail.figures.values())

    def is_seen(self, floor: Number) -> bool:
        """Whether clip-FID lies above a floor's interval, or a figure of the profile outside of what is real."""
        return self.clip_fid.value > floor.value + floor.ci95 or not self.has_real_detail


@dataclass(frozen=True)
class Graded:
    """One family of damage at one framerate, mild to severe; `clean` is the undamaged set."""

    family: str
    unit: str
    strengths: tuple[float, ...]
    clean: Scored
    scored: tuple[Scored, ...]

    @property
    def spearman(self) -> float:
        """Rank correlation between severity (clean included) and mean clip-FID."""
        from scipy.stats import spearmanr

        means = [each.clip_fid.value for each in (self.clean, *self.scored)]
        return float(spearmanr(range(len(means)), means).statistic)

    @property
    def first_seen(self) -> float | None:
        """The mildest strength from which on the damage is seen; None if the severest is not."""
        seen: float | None = None
        for strength, each in zip(reversed(self.strengths), reversed(self.scored), strict=True):
            if not each.is_seen(self.clean.clip_fid):
                break
            seen = strength
        return seen

    @property
    def passes(self) -> bool:
        """Whether the severest is seen; of slow damage also whether clip-FID rises (Spearman of 0.95 or more)."""
        return self.first_seen is not None and (self.family not in SLOW_DAMAGE or self.spearman >= MIN_SPEARMAN)


@dataclass(frozen=True)
class Game:
    """A plain corruption, and the same with disguises by their names."""

    parent: str
    honest: Scored
    cheats: Mapping[str, Scored]

    def is_won(self, name: str) -> bool:
        """Whether neither clip-FID, beyond the plain corruption's interval, nor the profile sees a disguise."""
        return not self.cheats[name].is_seen(self.honest.clip_fid)

    @property
    def won(self) -> list[str]:
        """The disguises that nothing sees."""
        return [name for name in self.cheats if self.is_won(name)]


@dataclass(frozen=True)
class Calibration:
    """The calibration at one framerate; `flat` are harmless transforms.

    `disjoint_floor` is the clip-FID of other takes (P2), which tables quote.
    """

    fps: Fraction
    features: str
    fingerprint: str
    num_sequences: int
    duration_seconds: float
    clean: Scored
    disjoint_floor: Number
    graded: tuple[Graded, ...]
    flat: Mapping[str, Scored]
    games: tuple[Game, ...] = ()

    @property
    def passes(self) -> bool:
        """Whether every damage is seen, no harmless transform is, and no game is won."""
        ceilings = {MIRRORED: self.disjoint_floor.value}
        ceiling = MAX_FLAT_RATIO * self.clean.clip_fid.value
        steady = all(
            each.clip_fid.value <= ceilings.get(name, ceiling) and each.has_real_detail
            for name, each in self.flat.items()
        )
        return steady and all(each.passes for each in self.graded) and not any(each.won for each in self.games)


def calibrate(
    comparison: Comparison, shifted: SampleSet | None, on_scored: Callable[[], None] = lambda: None
) -> Calibration:
    """Score every damage of the real set, and every harmless transform, against the real set itself.

    `shifted` is the real set from native frames that start one later, if available. Damaged sets have the same
    sequences as the clean one and share its draws, so levels differ by the damage alone. `on_scored` is called after
    each group of sets: the harmless ones, every family, every game. Raises `ClipError` if the takes are too few or too
    short.
    """
    real, seed = comparison.real, comparison.protocol.seed
    # Levels are compared with the clean set of the same takes, which removes the variation between takes.
    plain = replace(comparison, protocol=replace(comparison.protocol, detailed_replications=0, resamplings=0))
    has_detail = real.fps >= LEAST_FPS and comparison.training is not None
    detail = RealDetail.of(real, comparison.training or real, seed) if has_detail else None

    def scored(sets: Mapping[str, SampleSet]) -> dict[str, Scored]:
        scores = plain.scores(sets)
        on_scored()
        return {name: Scored(scores[name], detail.profile(each) if detail else None) for name, each in sets.items()}

    flat = scored({CLEAN: real, **_harmless(real, seed), **({SHIFTED: shifted} if shifted is not None else {})})
    clean = flat.pop(CLEAN)
    graded = []
    for family in damages():
        strengths = family.levels_at(float(real.fps))
        found = scored({str(strength): _damaged(real, family, strength, seed) for strength in strengths})
        if strengths:
            graded.append(Graded(family.name, family.unit, strengths, clean, tuple(found.values())))
    played = []
    for each in games(real, seed, comparison.training) if detail else ():
        found = scored({each.parent: each.honest, **each.cheats})
        played.append(Game(each.parent, found.pop(each.parent), found))
    disjoint = plain.disjoint_halves()
    return Calibration(
        fps=real.fps,
        features=comparison.features.name,
        fingerprint=comparison.features.fingerprint,
        num_sequences=real.num_sequences,
        duration_seconds=real.duration_seconds,
        clean=clean,
        disjoint_floor=replace(disjoint, ci95=disjoint.drawing),
        graded=tuple(graded),
        flat=flat,
        games=tuple(played),
    )


def level_name(family: Family, strength: float) -> str:
    """The row name of a level."""
    return f"{family.name} {strength:g} {family.unit}"


def _damaged(real: SampleSet, family: Family, strength: float, seed: int) -> SampleSet:
    rng = np.random.default_rng((seed, 5))
    sequences = [family.corrupt(take[None], float(real.fps), strength, rng)[0] for take in real.sequences]
    return real.with_positions(level_name(family, strength), real.fps, sequences)


def _mirrored(take: Float32[np.ndarray, "frames 22 3"]) -> Float32[np.ndarray, "frames 22 3"]:
    joints = np.arange(SMPL22.num_joints)
    for left, right in SMPL22.left_right_pairs:
        joints[[left, right]] = right, left
    return take[:, joints] * np.array([-1.0, 1.0, 1.0], dtype=np.float32)


def _harmless(real: SampleSet, seed: int) -> dict[str, SampleSet]:
    """Yaw and translation drawn per take, sinc interpolation by half a frame, and left and right exchanged."""
    rng = np.random.default_rng((seed, 6))
    takes = list(real.sequences)
    turned = [turn(take, float(yaw)) for take, yaw in zip(takes, rng.uniform(0, 2 * np.pi, len(takes)), strict=True)]
    offsets = rng.uniform(-5.0, 5.0, (len(takes), 2))
    moved = [translate(take, offset) for take, offset in zip(takes, offsets, strict=True)]
    delayed = [shift_between_frames(take) for take in takes]
    mirrored = [_mirrored(take) for take in takes]
    named = {
        "yaw": turned,
        "translation": moved,
        MIRRORED: mirrored,
        "sinc interpolation by half a frame": delayed,
    }
    return {name: real.with_positions(name, real.fps, sequences) for name, sequences in named.items()}
