"""The calibration table: what clip-FID and the detail profile see of damaged real motion.

clip-FID must rise with damage of slow motion and stay flat under harmless transforms; every damage must be seen by it
or by a figure of the profile; and no game may hide from all of them that motion was upsampled or low-passed.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eval.clip_fid.score import CLIP_FID, Comparison, FeatureSource, feature_sources
from eval.detail import LEAST_FPS, DetailProfile, RealDetail
from eval.metrics.number import Number
from eval.report.results import Block, Cell, Row, measure
from eval.sets.damage import FAMILIES, NUM_GAMES, Family, games, shift_between_frames, translate, turn
from eval.sets.motions import real_motion
from eval.sets.sets import SampleSet
from eval.tables.systems import COLUMNS
from eval.tables.table import Content, EvalConfig, Table
from motionkit.core.motion import mirror_positions
from motionkit.core.progress import task
from motionkit.core.skeleton import SMPL22
from motionkit.store.reader import Store

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
HIDDEN = "hidden from every figure"
GAMES_NOTE = "* is outside of what real takes show, in the first column above the plain corruption's interval."


@dataclass(frozen=True)
class Scored:
    """One set: its clip-FID, and its detail profile; None below 40 fps."""

    clip_fid: Number
    detail: DetailProfile | None

    @property
    def has_real_detail(self) -> bool:
        """Whether no figure of the profile sees the set."""
        return self.detail is None or all(figure.is_real for figure in self.detail.figures.values())

    def is_above(self, floor: Number) -> bool:
        """Whether clip-FID lies above a floor's interval."""
        return self.clip_fid.value > floor.value + floor.ci95

    def is_seen(self, floor: Number) -> bool:
        """Whether clip-FID lies above a floor's interval, or a figure of the profile outside of what is real."""
        return self.is_above(floor) or not self.has_real_detail


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

    @property
    def won(self) -> list[str]:
        """The disguises that neither clip-FID, beyond the plain corruption's interval, nor the profile sees."""
        return [name for name, cheat in self.cheats.items() if not cheat.is_seen(self.honest.clip_fid)]


@dataclass(frozen=True)
class Calibration:
    """The calibration on one feature set at one framerate; `flat` are harmless transforms."""

    comparison: Comparison
    clean: Scored
    disjoint_floor: Number
    graded: tuple[Graded, ...]
    flat: Mapping[str, Scored]
    games: tuple[Game, ...] = ()

    @property
    def column(self) -> str:
        """20 fps."""
        return f"{self.comparison.real.fps} fps"

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
    for family in FAMILIES:
        if strengths := family.levels_at(float(real.fps)):
            found = scored({str(strength): _damaged(real, family, strength, seed) for strength in strengths})
            graded.append(Graded(family.name, family.unit, strengths, clean, tuple(found.values())))
    played = []
    for each in games(real, seed, comparison.training) if detail else ():
        found = scored({each.parent: each.honest, **each.cheats})
        played.append(Game(each.parent, found.pop(each.parent), found))
    disjoint = plain.disjoint_halves()
    floor = replace(disjoint, ci95=disjoint.drawing)
    return Calibration(comparison, clean, floor, tuple(graded), flat, tuple(played))


def _damaged(real: SampleSet, family: Family, strength: float, seed: int) -> SampleSet:
    rng = np.random.default_rng((seed, 5))
    sequences = [family.corrupt(take, float(real.fps), strength, rng) for take in real.sequences]
    return real.with_positions(_level(family.name, strength, family.unit), real.fps, sequences)


def _harmless(real: SampleSet, seed: int) -> dict[str, SampleSet]:
    """Yaw and translation drawn per take, sinc interpolation by half a frame, and left and right exchanged."""
    rng = np.random.default_rng((seed, 6))
    takes = list(real.sequences)
    yaws = rng.uniform(0, 2 * np.pi, len(takes)).tolist()
    offsets = rng.uniform(-5.0, 5.0, (len(takes), 2))
    pairs = SMPL22.left_right_pairs
    named = {
        "yaw": [turn(take, yaw) for take, yaw in zip(takes, yaws, strict=True)],
        "translation": [translate(take, offset) for take, offset in zip(takes, offsets, strict=True)],
        MIRRORED: [mirror_positions(take, pairs) for take in takes],
        "sinc interpolation by half a frame": [shift_between_frames(take) for take in takes],
    }
    return {name: real.with_positions(name, real.fps, sequences) for name, sequences in named.items()}


def _level(family: str, strength: float, unit: str) -> str:
    """The row name of a level."""
    return f"{family} {strength:g} {unit}"


def compute(config: EvalConfig, store: Store) -> Content:
    """Calibrate every feature set at every framerate on the request's split, which was not used for fitting."""
    held_out = real_motion(store, config.split, config.where)
    train = real_motion(store, "train") if config.split != "all" else held_out
    blocks: list[Block] = []
    for source in feature_sources(config.evaluators, config.guo, config.missing):
        found: list[Calibration] = []
        for fps in config.fps or COLUMNS:
            with (
                config.missing.skipping(f"{source.name}, {fps} fps"),
                task(config.on_progress, f"{source.name}, {fps} fps", 1 + len(FAMILIES) + NUM_GAMES) as work,
            ):
                comparison = source.comparison(held_out.at(fps), train.at(fps), config.clips)
                found.append(calibrate(comparison, held_out.at(fps, first_frame=1), work.advance))
        blocks += _blocks(source, found)
    return Content(
        caption=(
            "Scores of damaged real motion against clean real motion of the same takes, in multiples of what clean "
            f"motion scores (first row, absolute): N = {config.clips.num_clips:,} clips, "
            f"{config.real}, features fitted on the training split. It passes where all damage is seen by "
            f"clip-FID or by the detail profile, clip-FID follows the severity of slow damage (Spearman {MIN_SPEARMAN} "
            f"or more), no harmless transform exceeds {MAX_FLAT_RATIO:g} times the floor, and no game is hidden."
        ),
        blocks=blocks,
        definition={"min_spearman": MIN_SPEARMAN, "max_flat_ratio": MAX_FLAT_RATIO},
    )


TABLE = Table(
    "nerm", "calibration", "does clip-FID rise with damage", "calibration/5", compute,
    heading="Calibration of clip-FID's features", takes_samples=False, task="calibration",
)  # fmt: skip


def _blocks(source: FeatureSource, found: list[Calibration]) -> list[Block]:
    """Ratios to the floor, rank correlations, and games."""
    levels = [_level(family.name, level, family.unit) for family in FAMILIES for level in family.levels]
    ratios: dict[str, dict[str, Cell]] = {CLEAN: {}, DISJOINT: {}}
    spearman: dict[str, dict[str, Cell]] = {}
    seen: dict[str, list[str]] = {}
    for each in found:
        floor, column = each.clean.clip_fid.value, each.column
        ratios[CLEAN][column] = Cell(floor, each.clean.clip_fid.ci95)
        ratios[DISJOINT][column] = Cell(each.disjoint_floor.value / floor, each.disjoint_floor.ci95 / floor)
        scores = {FLAT + name: score for name, score in each.flat.items()}
        for graded in each.graded:
            names = [_level(graded.family, strength, graded.unit) for strength in graded.strengths]
            scores |= zip(names, graded.scored, strict=True)
            spearman.setdefault(graded.family, {})[column] = Cell(graded.spearman)
            first = "none" if graded.first_seen is None else f"{graded.first_seen:g} {graded.unit}"
            seen.setdefault(graded.family, []).append(f"{first} ({column})")
        for name, score in scores.items():
            ratios.setdefault(name, {})[column] = Cell(score.clip_fid.value / floor, score.clip_fid.ci95 / floor)
    # Clean, harmless, then family by family from mild to severe.
    order = [name for name in ratios if name not in levels] + [name for name in levels if name in ratios]
    columns = tuple(each.column for each in found)
    provenance = {
        "features": source.name,
        "fingerprints": {each.column: each.comparison.features.fingerprint for each in found},
        "passes": {each.column: each.passes for each in found},
    }
    return [
        Block(
            f"{source.name}: multiples of the floor",
            columns,
            tuple(Row(name, "reference", ratios[name]) for name in order if ratios[name]),
            note=", ".join(f"{each.column} {'passes' if each.passes else 'FAILS'}" for each in found),
            provenance=provenance | {"shows": "scores"},
            metrics=(measure(CLIP_FID),),
        ),
        Block(
            f"{source.name}: Spearman correlation of severity and score",
            columns,
            tuple(
                Row(name, "reference", cells, f"seen by clip-FID or the profile from {', '.join(seen[name])}")
                for name, cells in spearman.items()
            ),
            lower_is_better=False,
            provenance=provenance | {"shows": "spearman"},
        ),
        *(_games_block(source.name, each, provenance | {"shows": "games"}) for each in found if each.games),
    ]


def _games_block(source: str, calibration: Calibration, provenance: Mapping[str, Any]) -> Block:
    """What every figure says of corrupted motion and its disguises at one framerate; those that are hidden first."""
    rows = []
    for game in calibration.games:
        for name, scored in {game.parent: game.honest, **game.cheats}.items():
            above = scored.is_above(game.honest.clip_fid)
            cells = {"clip-FID": Cell(scored.clip_fid.value, mark="*" if above else "")}
            for figure, each in scored.detail.figures.items() if scored.detail else ():
                cells[figure] = Cell(each.value, mark="" if each.is_real else "*")
            rows.append(Row(name, "reference", cells, HIDDEN if name in game.won else ""))
    rows.sort(key=lambda row: row.note != HIDDEN)
    hidden, played = sum(bool(row.note) for row in rows), sum(len(game.cheats) for game in calibration.games)
    note = f"{hidden} of {played} are hidden. {GAMES_NOTE}"
    title = f"{source}: games at {calibration.column}"
    return Block(title, tuple(rows[0].cells), tuple(rows), note=note, provenance=provenance)
