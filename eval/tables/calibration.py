"""The calibration table: clip-FID of each feature set under graded corruptions and harmless transforms."""

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from eval.clip_fid.calibration import (
    CLEAN,
    DISJOINT,
    FLAT,
    MAX_FLAT_RATIO,
    MIN_GAME_RATIO,
    MIN_SPEARMAN,
    TASK,
    VERSION,
    Calibration,
    Graded,
    calibrate,
    level_name,
)
from eval.clip_fid.features import FeatureSource, feature_sources
from eval.clip_fid.score import CLIP_FID
from eval.report.results import Block, Cell, Result, Row, measure
from eval.sets.corruptions import families
from eval.sets.partial import PartialResult, collect
from eval.sets.real import RealMotion, real_motion
from eval.tables.registry import TableRequest
from motionkit.core.progress import task

COLUMNS = tuple(Fraction(rate) for rate in (20, 40, 60, 100, 120))
FIGURE = f"{TASK}.png"
HONEST = ", plain (absolute)"


def build_calibration(request: TableRequest) -> Result:
    """Calibrate every feature set at every framerate on the request's split, which was not used for fitting.

    Raises `UsageError` or `StoreError` for a store that cannot be used.
    """
    store = request.open_store()
    held_out = real_motion(store, request.real.split, request.real.where)
    train = real_motion(store, "train") if request.real.split != "all" else held_out
    sources = feature_sources(request.evaluated.run, request.evaluators.names, request.evaluators.guo)
    found = {source.name: _calibrate(source, request, held_out, train) for source in sources.value}
    calibrations = {name: list(each.value.values()) for name, each in found.items()}
    blocks = [block for source in sources.value for block in _blocks(source, request, calibrations[source.name])]
    return Result(
        task=TASK,
        version=VERSION,
        title="Calibration of clip-FID's features",
        caption=(
            "Scores of damaged real motion against clean real motion of the same takes, in multiples of what clean "
            f"motion scores (first row, absolute): N = {request.clip_fid.protocol.num_clips:,} clips, "
            f"{request.real.named}, features fitted on the training split. A feature set passes where every "
            f"family's Spearman correlation is at least {MIN_SPEARMAN}, no harmless transform exceeds "
            f"{MAX_FLAT_RATIO:g} times the floor, and no game scores below {MIN_GAME_RATIO:g} times what it hides."
        ),
        blocks=tuple(blocks),
        definition={
            "split": request.real.split,
            "where": request.real.where,
            "min_spearman": MIN_SPEARMAN,
            "max_flat_ratio": MAX_FLAT_RATIO,
            "min_game_ratio": MIN_GAME_RATIO,
        },
        notes=_notes(calibrations),
        missing=(*sources.missing, *(line for each in found.values() for line in each.missing)),
        provenance=request.provenance(store),
        figure=FIGURE if blocks else "",
    )


def _calibrate(
    source: FeatureSource, request: TableRequest, held_out: RealMotion, train: RealMotion
) -> PartialResult[dict[Fraction, Calibration]]:
    def calibration(fps: Fraction) -> Calibration:
        replications = source.protocol(request.clip_fid.protocol).replications
        with task(request.on_progress, f"{source.name}, {fps} fps", 5 * replications) as work:
            comparison = source.comparison(held_out.at(fps), train.at(fps), request.clip_fid.protocol)
            return calibrate(comparison, held_out.at(fps, first_frame=1), work.advance)

    return collect(request.fps or COLUMNS, calibration, lambda fps: f"{source.name}, {fps} fps")


def _blocks(source: FeatureSource, request: TableRequest, calibrations: list[Calibration]) -> list[Block]:
    """One block of ratios to the floor, one of rank correlations."""
    columns = tuple(f"{each.fps} fps" for each in calibrations)
    by_column = list(zip(columns, calibrations, strict=True))
    ratios: dict[str, dict[str, Cell]] = {CLEAN: {}, DISJOINT: {}}
    spearman: dict[str, dict[str, Cell]] = {}
    for column, each in by_column:
        floor = each.floor.mean
        ratios[CLEAN][column] = Cell(floor, each.floor.ci95)
        ratios[DISJOINT][column] = Cell(each.disjoint_floor.mean / floor, each.disjoint_floor.ci95 / floor)
        for name, score in each.flat.items():
            ratios.setdefault(FLAT + name, {})[column] = Cell(score.mean / floor, score.ci95 / floor)
        for graded in each.graded:
            spearman.setdefault(graded.family, {})[column] = Cell(graded.spearman)
            for strength, score in zip(graded.strengths, graded.scores[1:], strict=True):
                row = f"{graded.family} {strength:g} {graded.unit}"
                ratios.setdefault(row, {})[column] = Cell(score.mean / floor, score.ci95 / floor)
    replications = source.protocol(request.clip_fid.protocol).replications
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
            tuple(Row(name, "reference", cells, _visible(name, by_column)) for name, cells in spearman.items()),
            lower_is_better=False,
            provenance=provenance | {"shows": "spearman"},
        ),
        _games_block(source, by_column, provenance),
    ]


def _games_block(source: FeatureSource, by_column: list[tuple[str, Calibration]], provenance: dict[str, Any]) -> Block:
    """Scores of corrupted motion, and of its disguises as shares of them."""
    rows: dict[str, dict[str, Cell]] = {}
    for column, each in by_column:
        for game in each.games:
            rows.setdefault(game.parent + HONEST, {})[column] = Cell(game.honest.mean, game.honest.ci95)
            for name, ratio in game.ratios.items():
                rows.setdefault(name, {})[column] = Cell(ratio)
    return Block(
        f"{source.name}: games, as shares of what they hide",
        tuple(column for column, _ in by_column),
        tuple(Row(name, "reference", cells) for name, cells in rows.items()),
        lower_is_better=False,
        note=f"Rows{HONEST} are scores; the others are shares of them: below {MIN_GAME_RATIO:g} a game is won.",
        provenance=provenance | {"shows": "games"},
    )


def _visible(family: str, by_column: list[tuple[str, Calibration]]) -> str:
    """The lowest level at which a family's damage differs significantly (95 %) from real motion, over either floor."""
    over_same, over_disjoint = [], []
    for column, each in by_column:
        for graded in each.graded:
            if graded.family == family:
                over_same.append(f"{_level(graded, graded.first_visible)} ({column})")
                over_disjoint.append(f"{_level(graded, graded.first_above(each.disjoint_floor))} ({column})")
    return (
        f"differs from real motion of the same takes from {', '.join(over_same)}; scores above other takes (P2) from "
        f"{', '.join(over_disjoint)}"
    )


def _level(graded: Graded, strength: float | None) -> str:
    return "none" if strength is None else f"{strength:g} {graded.unit}"


def _notes(calibrations: Mapping[str, list[Calibration]]) -> tuple[str, ...]:
    """A remark on the size of every framerate's real set."""
    held = {each.fps: each for some in calibrations.values() for each in some}
    sets = (
        f"{fps} fps: {held[fps].num_sequences} sequences, {held[fps].duration_seconds:.0f} s" for fps in sorted(held)
    )
    return (f"Real sets: {'; '.join(sets)}.",) if held else ()


def _row_order(names: list[str]) -> list[str]:
    """Row order: clean, harmless, then family by family from mild to severe."""
    levels = [level_name(family, level) for family in families() for level in family.levels]
    return [name for name in names if name not in levels] + [name for name in levels if name in names]
