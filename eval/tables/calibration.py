"""The calibration table: clip-FID of each feature set under graded corruptions and harmless transforms."""

from typing import Any

from eval.calibration import (
    CLEAN,
    DISJOINT,
    FLAT,
    MAX_FLAT_RATIO,
    MIN_SPEARMAN,
    TASK,
    VERSION,
    Calibration,
    Game,
    Graded,
    Scored,
    calibrate,
    level_name,
)
from eval.clip_fid.score import CLIP_FID, FeatureSource, feature_sources
from eval.config import EvalConfig
from eval.report.results import Block, Cell, Row, measure
from eval.sets.damage import NUM_GAMES, damages
from eval.sets.motions import real_motion
from eval.tables.columns import COLUMNS
from eval.tables.table import Content, Table
from motionkit.core.progress import task
from motionkit.store.reader import Store

CLIP_FID_COLUMN = "clip-FID"
HIDDEN = "hidden from every figure"
PROFILE_NOTE = (
    "T, energy in dB by band and R in mm, as in table 2; * is outside of what real takes show, in "
    "the first column above the plain corruption's interval."
)


def compute(config: EvalConfig, store: Store) -> Content:
    """Calibrate every feature set at every framerate on the request's split, which was not used for fitting."""
    held_out = real_motion(store, config.split, config.where)
    train = real_motion(store, "train") if config.split != "all" else held_out
    found: list[tuple[FeatureSource, list[Calibration]]] = []
    for source in feature_sources(config.evaluators, config.guo, config.missing):
        found.append((source, []))
        for fps in config.fps or COLUMNS:
            with (
                config.missing.skipping(f"{source.name}, {fps} fps"),
                task(config.on_progress, f"{source.name}, {fps} fps", 1 + len(damages()) + NUM_GAMES) as work,
            ):
                comparison = source.comparison(held_out.at(fps), train.at(fps), config.clips)
                found[-1][1].append(calibrate(comparison, held_out.at(fps, first_frame=1), work.advance))
    blocks = [block for source, each in found for block in _blocks(source, config, each)]
    held = {each.fps: each for _, calibrations in found for each in calibrations}
    sets = (
        f"{fps} fps: {held[fps].num_sequences} sequences, {held[fps].duration_seconds:.0f} s" for fps in sorted(held)
    )
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
        notes=(f"Real sets: {'; '.join(sets)}.",) if held else (),
    )


TABLE = Table(
    "nerm", TASK, "does clip-FID rise with damage", VERSION, compute, heading="Calibration of clip-FID's features",
    takes_samples=False, task=TASK,
)  # fmt: skip


def _blocks(source: FeatureSource, config: EvalConfig, calibrations: list[Calibration]) -> list[Block]:
    """One block of ratios to the floor, one of rank correlations."""
    columns = tuple(f"{each.fps} fps" for each in calibrations)
    by_column = list(zip(columns, calibrations, strict=True))
    ratios: dict[str, dict[str, Cell]] = {CLEAN: {}, DISJOINT: {}}
    spearman: dict[str, dict[str, Cell]] = {}
    for column, each in by_column:
        floor = each.clean.clip_fid.value
        ratios[CLEAN][column] = Cell(floor, each.clean.clip_fid.ci95)
        ratios[DISJOINT][column] = Cell(each.disjoint_floor.value / floor, each.disjoint_floor.ci95 / floor)
        for name, score in each.flat.items():
            ratios.setdefault(FLAT + name, {})[column] = _ratio(score, floor)
        for graded in each.graded:
            spearman.setdefault(graded.family, {})[column] = Cell(graded.spearman)
            for strength, score in zip(graded.strengths, graded.scored, strict=True):
                row = f"{graded.family} {strength:g} {graded.unit}"
                ratios.setdefault(row, {})[column] = _ratio(score, floor)
    replications = source.protocol(config.clips).replications
    provenance = {
        "features": source.name,
        "replications": replications,
        "fingerprints": {column: each.fingerprint for column, each in by_column},
        "passes": {column: each.passes for column, each in by_column},
    }
    verdict = ", ".join(f"{column} {'passes' if each.passes else 'FAILS'}" for column, each in by_column)
    return [
        Block(
            f"{source.name}: multiples of the floor",
            columns,
            tuple(Row(name, "reference", ratios[name]) for name in _row_order(list(ratios)) if ratios[name]),
            note=f"{verdict} ({replications} replications).",
            provenance=provenance | {"shows": "scores"},
            metrics=(measure(CLIP_FID),),
        ),
        Block(
            f"{source.name}: Spearman correlation of severity and score",
            columns,
            tuple(Row(name, "reference", cells, _seen(name, by_column)) for name, cells in spearman.items()),
            lower_is_better=False,
            provenance=provenance | {"shows": "spearman"},
        ),
        *(_games_block(source, each, provenance) for each in calibrations if each.games),
    ]


def _ratio(scored: Scored, floor: float) -> Cell:
    return Cell(scored.clip_fid.value / floor, scored.clip_fid.ci95 / floor)


def _games_block(source: FeatureSource, calibration: Calibration, provenance: dict[str, Any]) -> Block:
    """What every figure says of corrupted motion and its disguises at one framerate; those that are hidden first."""
    rows = [
        _game_row(game, name, cheat)
        for game in calibration.games
        for name, cheat in {game.parent: game.honest, **game.cheats}.items()
    ]
    hidden = [row for row in rows if row.note == HIDDEN]
    columns = (CLIP_FID_COLUMN, *(calibration.clean.detail.figures if calibration.clean.detail else ()))
    return Block(
        f"{source.name}: games at {calibration.fps} fps",
        columns,
        (*hidden, *(row for row in rows if row.note != HIDDEN)),
        note=f"{len(hidden)} of {sum(len(game.cheats) for game in calibration.games)} are hidden. {PROFILE_NOTE}",
        provenance=provenance | {"shows": "games"},
    )


def _game_row(game: Game, name: str, scored: Scored) -> Row:
    above = scored.clip_fid.value > game.honest.clip_fid.value + game.honest.clip_fid.ci95
    cells = {CLIP_FID_COLUMN: Cell(scored.clip_fid.value, mark="*" if above else "")}
    if scored.detail is not None:
        cells |= {
            figure: Cell(each.value, mark="" if each.is_real else "*") for figure, each in scored.detail.figures.items()
        }
    return Row(name, "reference", cells, HIDDEN if name in game.won else "")


def _seen(family: str, by_column: list[tuple[str, Calibration]]) -> str:
    """The lowest level from which on a family's damage is seen."""
    levels = [
        f"{_level(graded, graded.first_seen)} ({column})"
        for column, each in by_column
        for graded in each.graded
        if graded.family == family
    ]
    return f"seen by clip-FID or the profile from {', '.join(levels)}"


def _level(graded: Graded, strength: float | None) -> str:
    return "none" if strength is None else f"{strength:g} {graded.unit}"


def _row_order(names: list[str]) -> list[str]:
    """Row order: clean, harmless, then family by family from mild to severe."""
    levels = [level_name(family, level) for family in damages() for level in family.levels]
    return [name for name in names if name not in levels] + [name for name in levels if name in names]
