"""The calibration table: how clip-FID on each feature set answers graded damage, and transforms that change nothing."""

from fractions import Fraction
from functools import partial

from eval.calibration import MAX_FLAT_RATIO, MIN_SPEARMAN, VERSION, Calibration, calibrate
from eval.corruptions import families
from eval.feature_sources import FeatureSource, feature_sources
from eval.real import RealMotion, real_motion
from eval.report.results import Block, Cell, Result, Row, environment
from eval.tables.registry import TableRequest
from motionkit.console import progress
from motionkit.errors import MotionkitError

COLUMNS = tuple(Fraction(rate) for rate in (20, 40, 60, 120))


def build_calibration(request: TableRequest) -> Result:
    """Calibrate every feature set at every framerate on the request's split, which no fit has seen.

    Raises `UsageError` or `StoreError` for a store that cannot be used.
    """
    from motionkit.store.reader import Store

    store = Store.open(request.store)
    held_out = real_motion(store, request.split, request.where)
    train = real_motion(store, "train") if request.split != "all" else held_out
    missing: list[str] = []
    sources = feature_sources(request.run, request.features, missing, request.guo)
    calibrations = {source.name: _calibrate(source, request, held_out, train, missing) for source in sources}
    blocks: list[Block] = []
    for source in sources:
        blocks += _blocks(source, calibrations[source.name])
    return Result(
        task="calibration",
        version=VERSION,
        title="Calibration of clip-FID's features",
        caption=(
            "Scores of damaged real motion against clean real motion, in multiples of the score of clean against clean "
            f"(first row, absolute): N = {request.protocol.num_clips:,} clips, {request.protocol.replications} "
            f"replications, split {request.split!r}{request.restriction}, features fitted on the training split. A "
            f"feature set may be quoted where every family's Spearman correlation is at least {MIN_SPEARMAN} and no "
            f"harmless transform exceeds {MAX_FLAT_RATIO:g} times the floor."
        ),
        blocks=tuple(blocks),
        definition={
            "split": request.split,
            "where": request.where,
            "min_spearman": MIN_SPEARMAN,
            "max_flat_ratio": MAX_FLAT_RATIO,
        },
        missing=tuple(missing),
        provenance={
            "store": {"path": request.store.name, "fingerprint": store.fingerprint},
            "seed": request.seed,
            "environment": environment(),
        },
    )


def _calibrate(
    source: FeatureSource, request: TableRequest, held_out: RealMotion, train: RealMotion, missing: list[str]
) -> list[Calibration]:
    results = []
    protocol = source.protocol(request.protocol)
    with progress() as display:
        for fps in request.fps or COLUMNS:
            task = display.add_task(f"{source.name}, {fps} fps", total=protocol.replications, note="")
            try:
                real, shifted = held_out.at(fps), held_out.at(fps, first_frame=1)
                features = source.fit(train.at(fps))
                advance = partial(display.advance, task)
                results.append(calibrate(real, shifted, features, protocol, advance))
            except MotionkitError as error:
                missing.append(f"{source.name}, {fps} fps: {error}")
            display.remove_task(task)
    return results


def _blocks(source: FeatureSource, calibrations: list[Calibration]) -> list[Block]:
    """One block of ratios to the floor, one of rank correlations."""
    columns = tuple(f"{each.fps} fps" for each in calibrations)
    ratios: dict[str, dict[str, Cell]] = {"clean (absolute)": {}}
    spearman: dict[str, dict[str, Cell]] = {}
    visible: dict[str, dict[str, str]] = {}
    for column, each in zip(columns, calibrations, strict=True):
        ratios["clean (absolute)"][column] = Cell(each.floor.mean, each.floor.ci95)
        for name, score in each.flat.items():
            ratios.setdefault(f"flat: {name}", {})[column] = Cell(score.mean / each.floor.mean)
        for family in each.graded:
            spearman.setdefault(family.family, {})[column] = Cell(family.spearman)
            seen = family.first_visible
            visible.setdefault(family.family, {})[column] = "none" if seen is None else f"{seen:g} {family.unit}"
            for strength, score in zip(family.strengths, family.scores[1:], strict=True):
                row = f"{family.family} {strength:g} {family.unit}"
                ratios.setdefault(row, {})[column] = Cell(score.mean / each.floor.mean)
    ratios = {name: ratios[name] for name in _row_order(list(ratios))}
    provenance = {
        "fingerprints": {column: each.fingerprint for column, each in zip(columns, calibrations, strict=True)},
        "passes": {column: each.passes for column, each in zip(columns, calibrations, strict=True)},
    }
    passed = ", ".join(
        f"{column} {'passes' if each.passes else 'FAILS'}" for column, each in zip(columns, calibrations, strict=True)
    )
    return [
        Block(
            f"{source.name}: multiples of the floor",
            columns,
            tuple(Row(name, "reference", cells) for name, cells in ratios.items()),
            note=f"{passed}.",
            provenance=provenance,
        ),
        Block(
            f"{source.name}: Spearman correlation of severity and score",
            columns,
            tuple(
                Row(
                    name,
                    "reference",
                    cells,
                    "first visible at " + ", ".join(f"{seen} ({column})" for column, seen in visible[name].items()),
                )
                for name, cells in spearman.items()
            ),
            lower_is_better=False,
            provenance=provenance,
        ),
    ]


def _row_order(names: list[str]) -> list[str]:
    """Clean, harmless, then family by family from mild to severe, whichever framerates the levels exist at."""
    levels = [f"{family.name} {level:g} {family.unit}" for family in families() for level in family.levels]
    return [name for name in names if name not in levels] + [name for name in levels if name in names]
