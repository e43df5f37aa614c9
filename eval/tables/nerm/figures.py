"""NeRM's Figures 5 and 8 as tables: unconditional generation, and the cost of a motion against its quality."""

import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from fractions import Fraction

import numpy as np

from eval.clip_fid.score import CLIP_FID, describer, draw_clips
from eval.clip_fid.score import REAL as REAL_STREAM
from eval.metrics.actions import diversity
from eval.metrics.intervals import over_replications
from eval.report.results import Block, Cell, Row, cell_of, measure
from eval.sets import motions
from eval.sets.sets import REAL, RowId, SampleSet, Variant
from eval.tables.systems import COLUMNS, ModelFields, Yardstick, detail_blocks, label, require_models
from eval.tables.table import Content, EvalConfig, Table
from motionkit.core.errors import UsageError
from motionkit.core.progress import tracked
from motionkit.core.shapes import Float32
from motionkit.fields.motion_field import MotionField, to_motion
from motionkit.generate.models import GenerationRequest, GenerativeModel, SamplingOptions, installed_models
from motionkit.store.reader import Store
from motionkit.training.run import RunError

ANY_CONDITION = "it never learnt to do without a condition: each motion has that of a random training motion"
TARGET_FPS, OTHER_FPS = Fraction(60), (Fraction(20), Fraction(120))
SECONDS = 9.8
STEPS = (50, 20, 10, 5)
REPEATS = 5
CPU, WALL = "CPU seconds a motion", "seconds a motion"


def _and_planted(name: str, fields: Mapping[motions.Window, MotionField]) -> ModelFields:
    return {RowId(name): fields, RowId(name, Variant.PLANTED): motions.planted_fields(fields)}


def unconditional(config: EvalConfig, store: Store) -> Content:
    """clip-FID and diversity of motions generated without a condition, or with any one if a model needs it.

    Raises `UsageError` without a run, `RunError` if it holds no model or none generates.
    """
    models = require_models(config.run, "figure 5", config.missing)
    yardstick = Yardstick.of(store, config, config.fps or COLUMNS)
    scores, spreads = [], []
    for name in tracked(config.on_progress, "systems", models, len(models)):
        with config.missing.skipping(name):
            model = models[name].loaded
            fields = motions.generate_fields(model, _windows(model, yardstick), config.seed, config.max_motions)
            notes = (models[name].note, ANY_CONDITION if motions.needs_a_condition(model) else "")
            for row, own in _and_planted(f"{name}, unconditional", fields).items():
                sets = yardstick.sets(row, own)
                note = motions.VARIANT_NOTES.get(row.variant) or "; ".join(filter(None, notes))
                scores.append(Row(str(row), "ours", yardstick.clip_fid(row, sets), note))
                spreads.append(Row(str(row), "ours", _diversity(sets, yardstick)))
    if not scores:
        raise RunError("; ".join(config.missing.lines))
    real = _diversity({fps: each.real for fps, each in yardstick.comparisons.items()}, yardstick)
    labels, protocol = tuple(map(label, config.fps or COLUMNS)), config.clips
    return Content(
        caption=(
            "Motions generated without a text or action of their own, as long as the real sequences of "
            f"{config.real}: mean over {protocol.replications} replications of N = {protocol.num_clips:,} random clips "
            "a side, ± half the 95 % interval: of clip-FID over takes, of diversity over replications."
        ),
        blocks=(
            Block(
                "clip-FID on the kinematic descriptor",
                labels,
                (*yardstick.floor_rows(), *scores),
                metrics=(measure(CLIP_FID),),
            ),
            Block(
                "Diversity (Eq. 7) of clips in the kinematic descriptor's space",
                labels,
                (Row(str(REAL), "reference", real), *spreads),
                lower_is_better=False,
                note="Better the closer to real motion's.",
                metrics=(measure("diversity"),),
            ),
        ),
    )


def _windows(model: GenerativeModel, yardstick: Yardstick) -> list[motions.Window]:
    """Requests without conditions; a model that never learnt to do without gets random ones of training motion."""
    windows, train = yardstick.windows(model), yardstick.train
    conditions = [("", "")] * len(windows)
    if motions.needs_a_condition(model):
        known = [
            pair
            for pair in zip(train.captions, train.actions, strict=True)
            if any(pair) and not motions.refusal(model, GenerationRequest(None, *pair))
        ]
        if not known:
            raise motions.NoRealMotionError(
                f"{model.name} needs a condition, and no training motion has one that it knows"
            )
        chosen = np.random.default_rng((yardstick.config.seed, 11)).integers(len(known), size=len(windows))
        conditions = [known[row] for row in chosen.tolist()]
    return [
        replace(window, request=GenerationRequest(window.request.duration_seconds, *condition))
        for window, condition in zip(windows, conditions, strict=True)
    ]


def _diversity(sets: Mapping[Fraction, SampleSet], yardstick: Yardstick) -> dict[str, Cell]:
    """Diversity of random clips in the features' space by column, over the protocol's replications."""
    cells = {}
    for fps, every in sets.items():
        protocol, features = yardstick.comparisons[fps].protocol, yardstick.comparisons[fps].features
        describe, values = describer(every, features), []
        for replication in range(protocol.replications):
            clips = draw_clips(every, protocol, replication, REAL_STREAM)
            rng = np.random.default_rng((protocol.seed, replication, 5))
            values.append(diversity(describe(clips), rng))
        cells[label(fps)] = cell_of(over_replications(values))
    return cells


def cost(config: EvalConfig, store: Store) -> Content:
    """Seconds for one motion of 9.8 s (or l_max) at 60 fps, its clip-FID and detail, by the number of diffusion steps.

    Raises `UsageError` without a run, `RunError` where it holds no model or none generates.
    """
    fps, *others = config.fps or (TARGET_FPS,)
    if others:
        raise UsageError(f"figure 8 is at one framerate: --fps {fps}")
    models = require_models(config.run, "figure 8", config.missing)
    yardstick = Yardstick.of(store, config, (fps,))
    real = yardstick.comparisons[fps]
    columns = {variant: str(RowId(f"clip-FID, {label(fps)}", variant)) for variant in (Variant.AS_IS, Variant.PLANTED)}
    as_is = columns[Variant.AS_IS]
    floors = [
        replace(row, cells=dict(zip([as_is], row.cells.values(), strict=False))) for row in yardstick.floor_rows()
    ]
    rows: list[Row] = []
    sets: dict[RowId, SampleSet] = {}
    seconds = min(SECONDS, *(trained.loaded.max_duration_seconds for trained in models.values()))
    for name in tracked(config.on_progress, "systems", models, len(models)):
        with config.missing.skipping(name):
            model, own = models[name].loaded, []
            for suffix, sampling in _samplings(model, fps, seconds).items():
                fields = motions.generate_fields(
                    model, yardstick.windows(model), config.seed, config.max_motions, sampling
                )
                cells = _cost(model, sampling, fps, seconds)
                for row, each in _and_planted(f"{name}{suffix}", fields).items():
                    if at_fps := yardstick.sets(row, each):
                        sets[row] = at_fps[fps]
                        for cell in yardstick.clip_fid(row, at_fps).values():
                            cells[columns[row.variant]] = cell
                own.append(Row(f"{name}{suffix}", "ours", cells, models[name].note))
            rows += own
    if not rows:
        raise RunError("; ".join(config.missing.lines))
    return Content(
        caption=(
            f"Generating one motion of {seconds:g} s at {label(fps)} without a condition, the quickest of {REPEATS} "
            "calls; planting is not in it. Seconds are of this machine; CPU seconds count all threads. clip-FID and "
            f"the detail profile as in Table 2, {config.real}."
        ),
        blocks=(
            Block(
                "Cost and clip-FID",
                (CPU, WALL, *columns.values()),
                (*floors, *rows),
                metrics=tuple(measure(CLIP_FID, column=column) for column in columns.values()),
            ),
            *detail_blocks(real.real, real.training, sets, config),
        ),
        definition={"seconds": seconds, "fps": str(fps), "repeats": REPEATS},
    )


def _positions(
    model: GenerativeModel, sampling: SamplingOptions, fps: Fraction, seconds: float
) -> Float32[np.ndarray, "frames joints 3"]:
    """One motion without a condition, generated and decoded."""
    (field,) = model.generate([GenerationRequest(seconds)], seed=0, sampling=sampling)
    return to_motion(field, fps).joint_positions


def _cost(model: GenerativeModel, sampling: SamplingOptions, fps: Fraction, seconds: float) -> dict[str, Cell]:
    """CPU and wall seconds of one motion, the quickest of some calls each; CPU seconds at other framerates are details.

    Every call generates a new motion, since a decoded one may cache what other framerates need.
    """

    def quickest(rate: Fraction) -> tuple[float, float]:
        spent = []
        for _ in range(REPEATS + 1):
            cpu, wall = time.process_time(), time.perf_counter()
            _positions(model, sampling, rate, seconds)
            spent.append((time.process_time() - cpu, time.perf_counter() - wall))
        cpus, walls = zip(*spent[1:], strict=True)  # the first call fills caches, such as coordinates
        return min(cpus), min(walls)

    cpu, wall = quickest(fps)
    others = {f"at {label(rate)}": quickest(rate)[0] for rate in OTHER_FPS if rate != fps}
    return {CPU: Cell(cpu, details=others), WALL: Cell(wall)}


def _samplings(model: GenerativeModel, fps: Fraction, seconds: float) -> dict[str, SamplingOptions]:
    """A model's sampling options by the suffix of its row: its default, and other numbers of steps."""
    own, suffix, others = _positions(model, SamplingOptions(), fps, seconds), "", {}
    for steps in STEPS:
        sampling, name = SamplingOptions(steps=steps), f", {steps} diffusion steps"
        with suppress(UsageError):
            if np.array_equal(_positions(model, sampling, fps, seconds), own):
                suffix = f"{name} (its own)"
            else:
                others[name] = sampling
    return {suffix: SamplingOptions(), **others}


FIGURE_5, FIGURE_8 = (
    Table("nerm", number, title, version, compute, takes_samples=False, shown=installed_models)
    for number, title, version, compute in (
        ("figure5", "unconditional generation", "unconditional/3", unconditional),
        ("figure8", "inference time and quality", "cost/3", cost),
    )
)
