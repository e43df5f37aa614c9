"""The calibration table: what clip-FID and the detail profile see of damaged real motion.

clip-FID must rise with damage of slow motion and stay flat under harmless transforms; every damage must be seen by it
or by a figure of the profile; and no game may hide from all of them that motion was upsampled or low-passed.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from eval.clip_fid.score import CLIP_FID, Comparison, feature_sources
from eval.detail import LEAST_FPS, DetailProfile, RealDetail
from eval.metrics.intervals import Number
from eval.report.results import Block, Cell, Row, measure
from eval.sets.damage import FAMILIES, NUM_GAMES, Family, games, shift_by_half_a_frame
from eval.sets.motions import real_motion
from eval.sets.sets import SampleSet
from eval.tables.systems import COLUMNS, label
from eval.tables.table import Content, EvalConfig, Table
from motionkit.core.kinematics import rotate_about_y
from motionkit.core.motion import mirror_positions
from motionkit.core.progress import task
from motionkit.core.skeleton import SMPL22
from motionkit.store.reader import Store

# Row names: the same-take floor, the floor of disjoint takes, the prefix of harmless transforms, and two of these.
CLEAN, DISJOINT, FLAT = "clean (absolute)", "disjoint halves of the takes (P2)", "flat: "
SHIFTED, MIRRORED = "native grid shifted by one frame", "left and right exchanged"
# Families that damage slow motion at every strength, whose severity clip-FID has to follow.
SLOW_DAMAGE = ("foot-sliding", "floor-height", "frozen-feet")
MIN_SPEARMAN = 0.95
# A harmless transform may raise the score to this multiple of the same-take floor.
MAX_FLAT_RATIO = 1.5
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

    def is_detected(self, floor: Number) -> bool:
        """Whether clip-FID lies above a floor's interval, or a figure of the profile outside of what is real."""
        return self.is_above(floor) or not self.has_real_detail


# Damaged sets by strength, mild to severe; a plain corruption, and after it the same with disguises.
Levels = Mapping[float, Scored]
Game = Mapping[str, Scored]


def spearman(clean: Scored, levels: Levels) -> float:
    """Rank correlation between severity (clean included) and mean clip-FID."""
    from scipy.stats import spearmanr

    means = [each.clip_fid.value for each in (clean, *levels.values())]
    return float(spearmanr(range(len(means)), means).statistic)


def first_detected(clean: Scored, levels: Levels) -> float | None:
    """The mildest strength from which on the damage is seen; None if the severest is not."""
    detected = list(takewhile(lambda strength: levels[strength].is_detected(clean.clip_fid), list(levels)[::-1]))
    return detected[-1] if detected else None


def won(game: Game) -> list[str]:
    """The disguises that neither clip-FID, beyond the plain corruption's interval, nor the profile sees."""
    honest, *cheats = game
    return [name for name in cheats if not game[name].is_detected(game[honest].clip_fid)]


@dataclass(frozen=True)
class Calibration:
    """The calibration on one feature set at one framerate; `flat` are harmless transforms."""

    fingerprint: str
    clean: Scored
    disjoint_floor: Number
    graded: Mapping[Family, Levels]
    flat: Mapping[str, Scored]
    games: Sequence[Game]

    @property
    def passes(self) -> bool:
        """Whether every damage is seen and slow damage ranked, no harmless transform is seen, and no game is won."""
        # People are right-handed, so mirrored motion need only be nearer than other takes are.
        ceilings = {MIRRORED: self.disjoint_floor.value}
        ceiling = MAX_FLAT_RATIO * self.clean.clip_fid.value
        return (
            all(first_detected(self.clean, levels) is not None for levels in self.graded.values())
            and all(
                spearman(self.clean, levels) >= MIN_SPEARMAN
                for family, levels in self.graded.items()
                if family.name in SLOW_DAMAGE
            )
            and all(each.clip_fid.value <= ceilings.get(name, ceiling) for name, each in self.flat.items())
            and all(each.has_real_detail for each in self.flat.values())
            and not any(map(won, self.games))
        )


def calibrate(
    comparison: Comparison, shifted: SampleSet | None, on_scored: Callable[[], None] = lambda: None
) -> Calibration:
    """Score every damage of the real set, and every harmless transform, against the real set itself.

    `shifted` is the real set from native frames that start one later, if available. Damaged sets share the clean one's
    draws, so levels differ by the damage alone. `on_scored` is called after each group of sets. Raises `ClipError` if
    the takes are too few or too short.
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
    graded = {}
    for family in FAMILIES:
        if strengths := family.levels_at(float(real.fps)):
            sets = {_level(family, strength): _damaged(real, family, strength, seed) for strength in strengths}
            graded[family] = dict(zip(strengths, scored(sets).values(), strict=True))
    played = [scored(each) for each in (games(real, seed, comparison.training) if detail else ())]
    disjoint = plain.disjoint_halves()
    floor = replace(disjoint, ci95=disjoint.drawing)
    return Calibration(comparison.features.fingerprint, clean, floor, graded, flat, played)


def _level(family: Family, strength: float) -> str:
    """The row name of a level."""
    return f"{family.name} {strength:g} {family.unit}"


def _damaged(real: SampleSet, family: Family, strength: float, seed: int) -> SampleSet:
    rng = np.random.default_rng((seed, 5))
    sequences = [family.corrupt(take, float(real.fps), strength, rng) for take in real.sequences]
    return real.with_positions(sequences, name=_level(family, strength))


def _harmless(real: SampleSet, seed: int) -> dict[str, SampleSet]:
    """Yaw and translation drawn per take, sinc interpolation by half a frame, and left and right exchanged."""
    rng = np.random.default_rng((seed, 6))
    takes = list(real.sequences)
    yaws = map(np.asarray, rng.uniform(0, 2 * np.pi, len(takes)))
    offsets = rng.uniform(-5.0, 5.0, (len(takes), 2)) @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    harmless = {
        "yaw": map(rotate_about_y, (take.astype(np.float64) for take in takes), yaws),
        "translation": ((take + offset).astype(np.float32) for take, offset in zip(takes, offsets, strict=True)),
        MIRRORED: (mirror_positions(take, SMPL22.left_right_pairs) for take in takes),
        "sinc interpolation by half a frame": map(shift_by_half_a_frame, takes),
    }
    return {name: real.with_positions(list(sequences), name=name) for name, sequences in harmless.items()}


def compute(config: EvalConfig, store: Store) -> Content:
    """Calibrate every feature set at every framerate on the request's split, which was not used for fitting."""
    held_out = real_motion(store, config.split, config.where)
    train = real_motion(store, "train") if config.split != "all" else held_out
    blocks: list[Block] = []
    for source in feature_sources(config.evaluators, config.guo, config.missing):
        by_column: dict[str, Calibration] = {}
        for fps in config.fps or COLUMNS:
            name = f"{source.name}, {label(fps)}"
            with config.missing.skipping(name), task(config.on_progress, name, 1 + len(FAMILIES) + NUM_GAMES) as work:
                comparison = source.comparison(held_out.at(fps), train.at(fps), config.clips)
                by_column[label(fps)] = calibrate(comparison, held_out.at(fps, first_frame=1), work.advance)
        blocks += _blocks(source.name, by_column)
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


def _blocks(source: str, by_column: Mapping[str, Calibration]) -> list[Block]:
    """Ratios to the floor, rank correlations, and games; by column."""
    levels = [_level(family, strength) for family in FAMILIES for strength in family.levels]
    ratios: dict[str, dict[str, Cell]] = {CLEAN: {}, DISJOINT: {}}
    ranks: dict[str, dict[str, Cell]] = {}
    thresholds: dict[str, list[str]] = {}
    for column, each in by_column.items():
        floor = each.clean.clip_fid
        ratios[CLEAN][column] = Cell(floor.value, floor.ci95)
        scores = {DISJOINT: each.disjoint_floor, **{FLAT + name: of.clip_fid for name, of in each.flat.items()}}
        for family, graded in each.graded.items():
            scores |= {_level(family, level): of.clip_fid for level, of in graded.items()}
            ranks.setdefault(family.name, {})[column] = Cell(spearman(each.clean, graded))
            first = first_detected(each.clean, graded)
            thresholds.setdefault(family.name, []).append(
                f"{first:g} {family.unit} ({column})" if first else f"none ({column})"
            )
        for name, score in scores.items():
            ratios.setdefault(name, {})[column] = Cell(score.value / floor.value, score.ci95 / floor.value)
    # Clean, harmless, then family by family from mild to severe: some levels have an effect in later columns alone.
    order = [name for name in ratios if name not in levels] + [name for name in levels if name in ratios]
    rows = tuple(Row(name, "reference", ratios[name]) for name in order if ratios[name])
    ranked = tuple(
        Row(name, "reference", cells, f"seen by clip-FID or the profile from {', '.join(thresholds[name])}")
        for name, cells in ranks.items()
    )
    note = ", ".join(f"{column} {'passes' if each.passes else 'FAILS'}" for column, each in by_column.items())
    provenance = {"fingerprints": {column: each.fingerprint for column, each in by_column.items()}}
    title, columns = "Spearman correlation of severity and score", tuple(by_column)
    return [
        Block(f"{source}: multiples of the floor", columns, rows, True, note, provenance, (measure(CLIP_FID),)),
        Block(f"{source}: {title}", columns, ranked, lower_is_better=False),
        *(_games_block(f"{source}: games at {column}", each.games) for column, each in by_column.items()),
    ]


def _games_block(title: str, games: Sequence[Game]) -> Block:
    """What every figure says of corrupted motion and its disguises at one framerate; those that are hidden first."""
    rows = []
    for game in games:
        floor = next(iter(game.values())).clip_fid
        for name, scored in game.items():
            cells = {"clip-FID": Cell(scored.clip_fid.value, mark="*" if scored.is_above(floor) else "")}
            for figure, each in scored.detail.figures.items() if scored.detail else ():
                cells[figure] = Cell(each.value, mark="" if each.is_real else "*")
            rows.append(Row(name, "reference", cells, HIDDEN if name in won(game) else ""))
    rows.sort(key=lambda row: row.note != HIDDEN)
    columns = tuple(column for row in rows[:1] for column in row.cells)
    note = f"{sum(bool(row.note) for row in rows)} of {len(rows) - len(games)} are hidden. {GAMES_NOTE}"
    return Block(title, columns, tuple(rows), note=note)
