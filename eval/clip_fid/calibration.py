"""Calibration of a feature set: clip-FID must rise with every corruption, and stay flat under harmless transforms.

It must also not drop when the corruption is disguised. No feature set passes: noise of any kind wins a network that was
trained to match text and motion, and noise that follows motion wins the kinematic descriptor.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from eval.clip_fid.features import Comparison
from eval.metrics.checks import Estimate
from eval.sets.corruptions import Family, families, shift_between_frames, translate, turn
from eval.sets.games import games
from eval.sets.sets import SampleSet

TASK = "calibration"
VERSION = "calibration/4"
CLEAN = "clean (absolute)"
DISJOINT = "disjoint halves of the takes (P2)"
FLAT = "flat: "
"""Row names in a result: the same-take floor, the floor of disjoint takes, the prefix of harmless transforms."""
MIN_SPEARMAN = 0.95
MAX_FLAT_RATIO = 1.5
"""A harmless transform may raise the score to this multiple of the same-take floor."""


MIN_GAME_RATIO = 0.8
"""A disguise may lower the score to no less than this share of the undisguised one."""


@dataclass(frozen=True)
class Game:
    """Scores of corrupted motion, and of the same with disguises; `cheats` by their names."""

    parent: str
    honest: Estimate
    cheats: Mapping[str, Estimate]

    @property
    def ratios(self) -> dict[str, float]:
        """Each cheat's score as a share of the honest one."""
        return {name: score.mean / self.honest.mean for name, score in self.cheats.items()}

    @property
    def passes(self) -> bool:
        """Whether no cheat lowers the score too much."""
        return min(self.ratios.values(), default=1.0) >= MIN_GAME_RATIO


@dataclass(frozen=True)
class Graded:
    """Scores of one family at one framerate: `strengths` mild to severe, `scores` with the clean set's first."""

    family: str
    unit: str
    strengths: tuple[float, ...]
    scores: tuple[Estimate, ...]

    @property
    def spearman(self) -> float:
        """Rank correlation between severity (clean included) and mean score."""
        from scipy.stats import spearmanr

        means = [score.mean for score in self.scores]
        return float(spearmanr(range(len(means)), means).statistic)

    @property
    def first_visible(self) -> float | None:
        """The mildest strength from which on scores exceed clean motion of the same takes at 95 %; None if none."""
        return self.first_above(self.scores[0])

    def first_above(self, floor: Estimate) -> float | None:
        """The mildest strength from which on the intervals lie above a floor's; None if none."""
        ceiling = floor.mean + floor.ci95
        visible: float | None = None
        for strength, score in zip(reversed(self.strengths), reversed(self.scores[1:]), strict=True):
            if score.mean - score.ci95 <= ceiling:
                break
            visible = strength
        return visible

    @property
    def passes(self) -> bool:
        """Whether the score rises with the damage (Spearman ≥ 0.95 over level means)."""
        return self.spearman >= MIN_SPEARMAN


@dataclass(frozen=True)
class Calibration:
    """The calibration of a feature set at one framerate; `flat` are scores of harmless transforms.

    `floor` is the score of other draws from the same takes (P1), `disjoint_floor` that of other takes (P2), which
    tables quote.
    """

    fps: Fraction
    features: str
    fingerprint: str
    num_sequences: int
    duration_seconds: float
    floor: Estimate
    disjoint_floor: Estimate
    graded: tuple[Graded, ...]
    flat: Mapping[str, Estimate]
    games: tuple[Game, ...] = ()

    @property
    def passes(self) -> bool:
        """Whether every family rises, every harmless transform stays near the floor, and no cheat works."""
        steady = all(score.mean <= MAX_FLAT_RATIO * self.floor.mean for score in self.flat.values())
        rising = all(family.passes for family in self.graded)
        return steady and rising and all(game.passes for game in self.games)


def calibrate(
    comparison: Comparison, shifted: SampleSet | None, on_replication: Callable[[], None] = lambda: None
) -> Calibration:
    """Score every corruption of the real set, and every harmless transform, against the real set itself.

    `shifted` is the real set from native frames that start one later, if available. Corrupted sets have the same
    sequences as the clean one and share its draws, so levels differ by the corruption alone. `on_replication` is called
    after each replication of the rows, of the disjoint halves and of each corruption in the games. Raises `ClipError`
    if the takes are too few or too short.
    """
    real, seed = comparison.real, comparison.protocol.seed
    # Levels are compared with the clean set of the same takes, which removes the variation between takes.
    protocol = replace(comparison.protocol, detailed_replications=0, resamplings=0)
    plain = replace(comparison, protocol=protocol, parts={})
    rows: dict[str, SampleSet] = {"clean": real}
    rows |= _harmless(real, seed)
    if shifted is not None:
        rows["native grid shifted by one frame"] = shifted
    flat_names = [name for name in rows if name != "clean"]
    levels: list[tuple[Family, tuple[float, ...]]] = []
    for family in families():
        strengths = family.levels_at(float(real.fps))
        levels.append((family, strengths))
        for strength in strengths:
            rows[level_name(family, strength)] = _corrupted(real, family, strength, seed)
    scores = plain.scores(rows, on_replication)
    floor = scores["clean"].clip_fid
    graded = [
        Graded(
            family.name,
            family.unit,
            strengths,
            (floor, *(scores[level_name(family, strength)].clip_fid for strength in strengths)),
        )
        for family, strengths in levels
        if strengths
    ]
    flat = {name: scores[name].clip_fid for name in flat_names}
    disjoint_floor = plain.disjoint_halves(on_replication).drawing
    played = []
    for each in games(real, seed, comparison.training):
        found = plain.scores({each.parent: each.honest, **each.cheats}, on_replication)
        cheats = {name: score.drawing for name, score in found.items() if name != each.parent}
        played.append(Game(each.parent, found[each.parent].drawing, cheats))
    return Calibration(
        fps=real.fps,
        features=comparison.features.name,
        fingerprint=comparison.features.fingerprint,
        num_sequences=real.num_sequences,
        duration_seconds=real.duration_seconds,
        floor=floor,
        disjoint_floor=disjoint_floor,
        graded=tuple(graded),
        flat=flat,
        games=tuple(played),
    )


def level_name(family: Family, strength: float) -> str:
    """The row name of a level."""
    return f"{family.name} {strength:g} {family.unit}"


def _corrupted(real: SampleSet, family: Family, strength: float, seed: int) -> SampleSet:
    rng = np.random.default_rng((seed, 5))
    sequences = [family.corrupt(take[None], float(real.fps), strength, rng)[0] for take in real.sequences]
    return real.with_positions(level_name(family, strength), real.fps, sequences)


def _harmless(real: SampleSet, seed: int) -> dict[str, SampleSet]:
    """Global yaw and translation drawn per take, and sinc interpolation by half a frame."""
    rng = np.random.default_rng((seed, 6))
    takes = list(real.sequences)
    turned = [turn(take, float(yaw)) for take, yaw in zip(takes, rng.uniform(0, 2 * np.pi, len(takes)), strict=True)]
    offsets = rng.uniform(-5.0, 5.0, (len(takes), 2))
    moved = [translate(take, offset) for take, offset in zip(takes, offsets, strict=True)]
    delayed = [shift_between_frames(take) for take in takes]
    named = {"yaw": turned, "translation": moved, "sinc interpolation by half a frame": delayed}
    return {name: real.with_positions(name, real.fps, sequences) for name, sequences in named.items()}
