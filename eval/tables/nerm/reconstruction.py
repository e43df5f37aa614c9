"""NeRM's Table 4, how well an encoder reconstructs windows of motion, and its ablations: Tables 5 to 9, and ours.

A row of an ablation is a variant of `motionkit ablate`; its numbers are means over the seeds that it was trained with.
"""

from collections import defaultdict
from collections.abc import Sequence
from fractions import Fraction
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from eval.clip_fid.score import CLIP_FID
from eval.metrics.motion import mean_vector_distance, mpjpe_global, mpjpe_root_aligned, mre
from eval.report.results import Block, Cell, Row, measure
from eval.sets.motions import generate_fields
from eval.sets.sets import RowId
from eval.tables.systems import COLUMNS, Trained, Yardstick, label, trained_reconstructors
from eval.tables.table import SOURCES, Content, EvalConfig, Table, mean_cells, printed_block, reported_figures
from motionkit.core.errors import UsageError
from motionkit.core.motion import mirror_positions
from motionkit.core.progress import tracked
from motionkit.core.shapes import Bool, Float32, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.data.reconstruction import ModelWindows, ReconstructsWindows
from motionkit.data.windows import Windows
from motionkit.edit.encoders import installed_encoders
from motionkit.features import field
from motionkit.features.native import vectors
from motionkit.fields.motion_field import to_motion
from motionkit.fields.resample import resample_positions
from motionkit.store.cache import PositionCache
from motionkit.store.reader import Store
from motionkit.training.ablations import Ablation, find_ablations
from motionkit.training.run import RunFolder, loader_named

NERM = find_ablations("nerm")
TRAINING, HELD_OUT = "training windows", "held-out windows"
GLOBAL, DISTANCE, COUNT = "global MPJPE, mm", "L2 norm of the whole vector", "windows"
MOST_WINDOWS = 384
SYNTHESIS = "Motion synthesis: clip-FID on the kinematic descriptor"
MEASURES = {"mpjpe": measure("mpjpe", unit="mm"), "mre": measure("mre"), "clip_fid": measure(CLIP_FID)}
# Table 4's blocks: the metric, and whether they are of the windows that have a truth in every column.
SAME = "takes fast enough for every column"
TABLE_4_BLOCKS = {
    f"MPJPE in mm, {SAME}": ("mpjpe", True),
    "MPJPE in mm, all takes at least as fast as the column": ("mpjpe", False),
    f"MRE, {SAME}": ("mre", True),
}
# An ablation's blocks: the windows' kind, and the metric.
ABLATION_BLOCKS = {
    f"Reconstruction of {TRAINING}, from their μ: root-aligned MPJPE (mm)": (TRAINING, "mpjpe"),
    f"Reconstruction of {TRAINING}, from their μ: MRE": (TRAINING, "mre"),
    f"Reconstruction of {HELD_OUT}, encoded by optimisation: root-aligned MPJPE (mm)": (HELD_OUT, "mpjpe"),
    SYNTHESIS: ("generated motion", "clip_fid"),
}
PRINTED = {"mre": "motion reconstruction, MRE", "clip_fid": "motion synthesis, clip-FID"}

Positions = Float32[np.ndarray, "poses joints 3"]
# Cells by block, then by column.
Numbers = dict[str, dict[str, Cell]]


def window_truth(source: PositionCache, windows: Windows, row: int, fps: Fraction) -> Positions:
    """A window's own capture at `fps` (not above its native framerate), in the window's frame; metres."""
    start, count = int(windows.start_row[row]), int(windows.num_frames[row])
    positions = np.asarray(source.positions[start : start + count])
    if windows.mirrored[row]:
        positions = mirror_positions(positions, SMPL22.left_right_pairs)
    sampled = resample_positions(positions, windows.exact_fps(row), fps)
    chosen = slice(row, row + 1)
    return np.asarray(field.to_window(sampled[None], windows.yaw[chosen], windows.origin[chosen])[0])


def has_truth(windows: Windows, fps: Fraction) -> Bool[np.ndarray, "windows"]:
    """Which windows were captured at `fps` or faster."""
    return np.asarray(windows.fps >= float(fps) - 1e-6)


def separate_windows(windows: Windows) -> Int64[np.ndarray, "chosen"]:
    """Rows of windows that do not overlap and are not mirrored: each sequence's first, then the next free one, …"""
    originals = np.flatnonzero(~windows.mirrored)
    order = originals[np.lexsort((windows.start_frame[originals], windows.sequence_index[originals]))]
    chosen: list[int] = []
    free_from: dict[int, int] = defaultdict(int)
    for row in order.tolist():
        sequence, start = int(windows.sequence_index[row]), int(windows.start_frame[row])
        # Neighbours share the frame at which one ends and the next begins.
        if start >= free_from[sequence]:
            chosen.append(row)
            free_from[sequence] = start + int(windows.num_frames[row]) - 1
    return np.array(chosen, dtype=np.int64)


class WindowErrors(NamedTuple):
    """Root-aligned and global MPJPE in millimetres; MRE and mean distance of `native` vectors in raw units."""

    aligned_mm: float
    global_mm: float
    mre: float
    vector_distance: float
    seconds: float


def window_errors(decoded: Positions, truth: Positions, fps: Fraction, seconds: float) -> WindowErrors:
    """The errors of one window of some seconds, decoded at `fps`; both in the window's frame, metres."""
    aligned, whole = (1000.0 * error(decoded, truth) for error in (mpjpe_root_aligned, mpjpe_global))
    pair = vectors(decoded, "smpl22", fps), vectors(truth, "smpl22", fps)
    return WindowErrors(aligned, whole, mre(*pair), mean_vector_distance(*pair), seconds)


def error_cells(windows: Sequence[WindowErrors]) -> dict[str, Cell]:
    """MPJPE in millimetres and MRE by metric, windows weighing by duration."""
    *errors, seconds = np.array(windows).T
    aligned, whole, vector, distance = (float(np.average(each, weights=seconds)) for each in errors)
    return {
        "mpjpe": Cell(aligned, None, {GLOBAL: whole, COUNT: float(len(windows))}),
        "mre": Cell(vector, None, {DISTANCE: distance}),
    }


# Errors by framerate, then by the window's row.
Errors = dict[Fraction, dict[int, WindowErrors]]


def reconstruction_errors(source: ModelWindows, rates: Sequence[Fraction], most_windows: int, seed: int) -> Errors:
    """With what errors a model reconstructs windows, by framerate and row: random ones, at most `most_windows`.

    Those fast enough for all framerates come first. Windows without a ground truth have no errors.
    """
    shuffled = np.random.default_rng(seed).permutation(separate_windows(source.windows))
    fast = has_truth(source.windows, max(rates))[shuffled]
    rows = np.sort(np.concatenate((shuffled[fast], shuffled[~fast]))[:most_windows])
    windows, fields, errors = source.windows.select(rows), source.fields(rows), Errors()
    for fps in rates:
        errors[fps] = {}
        for row in np.flatnonzero(has_truth(windows, fps)).tolist():
            truth = window_truth(source.source, windows, row, fps)
            decoded = to_motion(fields[row], fps).joint_positions[:, : truth.shape[1]]
            errors[fps][row] = window_errors(decoded, truth, fps, float(windows.duration_seconds[row]))
    return errors


def reconstruction(config: EvalConfig, store: Store) -> Content:
    """MPJPE and MRE of training and of held-out windows by framerate.

    Raises `UsageError` without a run or with a run of another store, and as loading the run.
    """
    if config.run is None:
        raise UsageError("table 4 needs a trained model that reconstructs windows of motion: --run NAME")
    rates = config.fps or COLUMNS
    rows: dict[str, list[Row]] = {title: [] for title in TABLE_4_BLOCKS}
    for name, trained in trained_reconstructors(config.run).items():
        for which, (described, errors) in _errors(trained, store, config).items():
            for title, (metric, same) in TABLE_4_BLOCKS.items():
                counted = errors[max(rates) if same else min(rates)].keys()
                chosen = {fps: [each for index, each in errors[fps].items() if index in counted] for fps in rates}
                cells = {label(fps): error_cells(each)[metric] for fps, each in chosen.items() if each}
                rows[title] += [Row(f"{name}: {which}, {described}", "ours", cells)] if cells else []
    same_takes, every_take, mre_blocks = (
        Block(title, tuple(map(label, rates)), tuple(rows[title]), metrics=(MEASURES[metric],))
        for title, (metric, _) in TABLE_4_BLOCKS.items()
    )
    printed_mpjpe, printed_mre = (
        printed_block(
            f"{title} printed in the NeRM paper (HumanML3D{units})",
            [figure for figure in reported_figures("nerm", "4") if figure.metric == metric],
            lambda figure: label(figure.setting),
            factor=factor,
            note="100 sequences of another data set; the paper does not say if they were trained on.",
        )
        for title, metric, units, factor in (
            ("MPJPE", "mpjpe_m", "; metres there, millimetres here", 1000.0),
            ("MRE", "mre", "", 1.0),
        )
    )
    return Content(
        caption=(
            "Root-aligned mean per-joint position error in millimetres over 22 joints, windows weighing by duration. "
            f"Held-out windows are of {config.real}."
        ),
        blocks=(same_takes, every_take, printed_mpjpe, mre_blocks, printed_mre),
        definition={"most_windows": MOST_WINDOWS, "held_out_sequences": config.condition},
    )


def ablated(ablation: Ablation, config: EvalConfig, store: Store) -> Content:
    """The table of an ablation from its runs.

    Raises `UsageError` without a run's name, or if none of the table's runs is trained.
    """
    encoder, model = loader_named("ENCODERS", NERM.paper), loader_named("MODELS", NERM.paper)
    runs = NERM.trained_runs(ablation.table, config.run, encoder.stages[-1])
    assert config.run is not None
    command = NERM.command(ablation.table, config.run)
    rates = config.fps or COLUMNS
    folders = list(dict.fromkeys(run for by_seed in runs.values() for run in by_seed.values()))
    generating = [run for run in folders if model.complete_in(run.path)] if model.stages[-1] in ablation.stages else []
    yardstick = Yardstick.of(store, config, rates) if generating else None
    numbers: dict[RunFolder, Numbers] = {}
    for run in tracked(config.on_progress, "measuring runs", folders, len(folders)):
        numbers[run] = {}
        with config.missing.skipping(run.path.name):
            numbers[run] |= _reconstruction(Trained(encoder, run.path), store, config)
            if yardstick is not None and run in generating:
                loaded = Trained(model, run.path).loaded
                fields = generate_fields(loaded, yardstick.windows(loaded), config.seed, config.max_motions)
                row = RowId(f"{loaded.name} of run {run.path.name!r}")
                numbers[run][SYNTHESIS] = yardstick.clip_fid(row, yardstick.sets(row, fields))
    blocks = []
    for title, (_, metric) in ABLATION_BLOCKS.items():
        rows = []
        for variant in ablation.variants:
            trained = [run for run in runs[variant].values() if title != SYNTHESIS or run in generating]
            steps = sorted({run.stage(encoder.stages[-1]).effort().get("steps", "?") for run in trained})
            note = f"field of {' or '.join(steps)} steps" + (f", {len(trained)} seeds" if len(trained) > 1 else "")
            if not trained:
                note = f"not trained: {command} --only {variant.name}"
            cells = mean_cells([numbers[run][title] for run in trained if title in numbers[run]])
            rows.append(Row(variant.label, "ours", cells, note))
        if any(row.cells for row in rows):
            floors = yardstick.floor_rows() if title == SYNTHESIS and yardstick is not None else []
            blocks.append(Block(title, tuple(map(label, rates)), (*floors, *rows), metrics=(MEASURES[metric],)))
    if model.stages[-1] in ablation.stages and not generating:
        config.missing.add(f"clip-FID: no {model.stages[-1]} is trained ({command})")
    return Content(
        caption=(
            "What one setting does to the first stage's reconstructions and to generated motion. 'global' is the "
            f"paper's layout of z, 'local' ours. Compared with {config.real}; clip-FID as in Table 2."
        ),
        blocks=(*blocks, *_printed(ablation.table)),
        definition={"rows": {variant.label: list(variant.change) for variant in ablation.variants}},
        runs=tuple(run.path for run in folders),
    )


def _errors(trained: Trained[Any], store: Store, config: EvalConfig) -> dict[str, tuple[str, Errors]]:
    """How an encoder reconstructs its training windows and those of another split if there are any, and the errors."""
    encoder, rates = trained.loaded, config.fps or COLUMNS
    if not isinstance(encoder, ReconstructsWindows):
        raise UsageError(f"{trained.loader.title} doesn't reconstruct windows of motion")
    if encoder.store_fingerprint != store.fingerprint:
        raise UsageError(f"{encoder.name} of {trained.run} was trained on another state of the store: train again")
    sources = {TRAINING: encoder.training_windows(store)}
    with config.missing.skipping(HELD_OUT, (UsageError,)):
        if config.split in ("all", "train"):
            raise UsageError(f"split {config.split!r} holds training windows; name another (--split test)")
        sources[HELD_OUT] = encoder.other_windows(store, config.condition)
    by_windows = {}
    for which, each in sources.items():
        errors = reconstruction_errors(each, rates, min(MOST_WINDOWS, config.max_motions), config.seed)
        lacking = (fps for fps in rates if not errors[fps])
        config.missing.add(*(f"{encoder.name}: {which}, {label(fps)}: no take is that fast" for fps in lacking))
        by_windows[which] = each.described, errors
    return by_windows


def _reconstruction(trained: Trained[Any], store: Store, config: EvalConfig) -> Numbers:
    """Errors of an encoder's windows by an ablation's blocks."""
    numbers = Numbers()
    for which, (_, errors) in _errors(trained, store, config).items():
        cells = {label(fps): error_cells(list(each.values())) for fps, each in errors.items() if each}
        for title, (windows, metric) in ABLATION_BLOCKS.items():
            if windows == which:
                numbers[title] = {column: by_metric[metric] for column, by_metric in cells.items()}
    return numbers


def _printed(table: str) -> list[Block]:
    """The paper's own figures in its own units: MRE, and clip-FID by its own evaluator."""
    figures = [figure for figure in reported_figures("nerm", table) if figure.value is not None]
    return [
        printed_block(
            f"Printed in the NeRM paper (HumanML3D): {title}",
            [figure for figure in figures if figure.metric == metric],
            lambda figure: label(figure.setting.partition(";")[0]),
            name=lambda figure: f"{figure.setting.partition(';')[2].replace('=', ' = ') or figure.method} (paper)",
            note=f"100 sequences of another data set, trained for far longer. Source: {SOURCES['nerm']}.",
        )
        for metric, title in PRINTED.items()
    ]


TABLE_4 = Table(
    *("nerm", "4", "reconstruction MPJPE and MRE by framerate", "reconstruction/2", reconstruction),
    heading="Table 4: reconstruction by framerate",
    takes_samples=False,
    shown=partial(installed_encoders, "reconstruction"),
)
ABLATIONS = {
    name: Table("nerm", name, each.title, "ablation/1", partial(ablated, each), takes_samples=False)
    for name, each in NERM.tables.items()
}
TABLE_5, TABLE_6, TABLE_7, TABLE_8, TABLE_9 = (ABLATIONS[number] for number in "56789")
TABLE_OURS = ABLATIONS["ours"]
