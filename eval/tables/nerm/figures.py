"""NeRM's Figures 5 and 8 as tables: unconditional generation, and the cost of a motion against its quality."""

import time
from collections.abc import Mapping
from fractions import Fraction

import numpy as np

from eval.clip_fid.score import CLIP_FID
from eval.config import EvalConfig
from eval.report.results import Block, Cell, Row, measure
from eval.sets.motions import VARIANT_NOTES, needs_a_condition
from eval.sets.sets import REAL, RowId, Variant
from eval.tables.columns import COLUMNS, detail_block, label
from eval.tables.models import TrainedModel, require_models, training_note
from eval.tables.runs import DETAIL, DIVERSITY, REAL_DIVERSITY, SYNTHESIS, Rows, Yardstick
from eval.tables.table import Content, Table
from motionkit.core.errors import UsageError
from motionkit.core.progress import tracked
from motionkit.core.shapes import Float32
from motionkit.fields.motion_field import to_motion
from motionkit.generate.models import GenerationRequest, GenerativeModel, SamplingOptions, installed_models
from motionkit.store.reader import Store
from motionkit.training.run import RunError

ANY_CONDITION = "it never learnt to do without a condition: each motion has that of a random training motion"
VARIANTS = (Variant.AS_IS, Variant.PLANTED)
TARGET_FPS, OTHER_FPS = Fraction(60), (Fraction(20), Fraction(120))
SECONDS = 9.8
STEPS = (50, 20, 10, 5)
REPEATS = 5
CPU, WALL = "CPU seconds a motion", "seconds a motion"


def unconditional(config: EvalConfig, store: Store) -> Content:
    """clip-FID and diversity of motions generated without a condition, or with any one if a model needs it.

    Raises `UsageError` without a run, `RunError` if it holds no model or none generates.
    """
    models = require_models(config.run, "figure 5", config.missing)
    yardstick = Yardstick(store, config, config.fps or COLUMNS)
    floors = yardstick.floor_rows()
    made: dict[str, Rows] = {}
    for name in tracked(config.on_progress, "systems", models, len(models)):
        with config.missing.skipping(name):
            made[name] = yardstick.unconditional(models[name])
    if not made:
        raise RunError("; ".join(config.missing.lines))
    notes = {name: _note(models[name]) for name in made}
    real = next(iter(made.values()))[REAL_DIVERSITY]
    return Content(
        caption=(
            "Motions generated without a text or action of their own, as long as the real sequences of "
            f"{config.real}: mean over {config.clips.replications} replications of N = {config.clips.num_clips:,} "
            "random clips a side, ± half the 95 % interval: of clip-FID over takes, of diversity over replications."
        ),
        blocks=(
            Block(
                "clip-FID on the kinematic descriptor",
                yardstick.labels,
                (*floors, *_rows(made, SYNTHESIS, notes)),
                metrics=(measure(CLIP_FID),),
            ),
            Block(
                "Diversity (Eq. 7) of clips in the kinematic descriptor's space",
                yardstick.labels,
                (Row(str(REAL), "reference", real), *_rows(made, DIVERSITY, {})),
                lower_is_better=False,
                note="Better the closer to real motion's. It sees clips, not whole motions.",
                metrics=(measure("diversity"),),
            ),
        ),
        notes=(
            "The paper draws this figure as bars without numbers, for methods trained on another data set; its FID of "
            "whole motions needs the evaluator of Guo et al.",
        ),
    )


def _note(trained: TrainedModel) -> str:
    condition = ANY_CONDITION if needs_a_condition(trained.loaded) else ""
    return "; ".join(filter(None, (training_note(trained), condition)))


def _rows(made: dict[str, Rows], quantity: str, notes: dict[str, str]) -> list[Row]:
    """Each model's row of a quantity, with a note, and that of its planted motions."""
    return [
        Row(
            str(RowId(f"{name}, unconditional", variant)),
            "ours",
            rows.get(str(RowId(quantity, variant)), {}),
            notes.get(name, "") if variant is Variant.AS_IS else VARIANT_NOTES[variant],
        )
        for name, rows in made.items()
        for variant in VARIANTS
    ]


def cost(config: EvalConfig, store: Store) -> Content:
    """Seconds for one motion of 9.8 s (or l_max) at 60 fps, its clip-FID and detail, by the number of diffusion steps.

    Raises `UsageError` without a run, `RunError` where it holds no model or none generates.
    """
    fps, *others = config.fps or (TARGET_FPS,)
    if others:
        raise UsageError(f"figure 8 is at one framerate: --fps {fps}")
    models = require_models(config.run, "figure 8", config.missing)
    yardstick = Yardstick(store, config, (fps,))
    quality = f"clip-FID, {label(fps)}"
    columns = {variant: str(RowId(quality, variant)) for variant in VARIANTS}
    rows = [
        Row(row.name, row.origin, dict(zip([quality], row.cells.values(), strict=False)))
        for row in yardstick.floor_rows()
    ]
    seconds = min(SECONDS, *(trained.loaded.max_duration_seconds for trained in models.values()))
    num_references = len(rows)
    details: dict[RowId, Mapping[str, Cell]] = {}
    for name in tracked(config.on_progress, "systems", models, len(models)):
        with config.missing.skipping(name):
            trained, own = models[name], []
            for suffix, sampling in _samplings(trained.loaded, fps, seconds).items():
                scores = yardstick.synthesis(trained, sampling, planted=True)
                cells = generation_cost(trained.loaded, sampling, fps, seconds)
                for variant, column in columns.items():
                    scored = scores[str(RowId(SYNTHESIS, variant))]
                    cells |= {column: scored[label(fps)]} if scored else {}
                    if detail := scores.get(str(RowId(f"{DETAIL}, {label(fps)}", variant))):
                        details[RowId(f"{name}{suffix}", variant)] = detail
                own.append(Row(f"{name}{suffix}", "ours", cells, training_note(trained)))
            rows += own
    if len(rows) == num_references:
        raise RunError("; ".join(config.missing.lines))
    return Content(
        caption=(
            f"Generating one motion of {seconds:g} s at {label(fps)} without a condition, the quickest of {REPEATS} "
            f"calls; planting is not in it. clip-FID and the detail profile as in Table 2, {config.real}."
        ),
        blocks=(
            Block(
                "Cost and clip-FID",
                (CPU, WALL, *columns.values()),
                tuple(rows),
                metrics=tuple(measure(CLIP_FID, column=column) for column in columns.values()),
            ),
            *([detail_block(yardstick.details[fps], details, {})] if details else []),
        ),
        definition={"seconds": seconds, "fps": str(fps), "repeats": REPEATS},
        notes=(
            "The paper draws this figure without numbers, for one GPU (RTX 3090). Seconds are of this machine, and "
            "wall seconds of whatever else it did; CPU seconds count all threads.",
        ),
    )


def generation_cost(
    model: GenerativeModel, sampling: SamplingOptions, fps: Fraction, seconds: float
) -> dict[str, Cell]:
    """CPU and wall seconds of one unconditional motion, generated and decoded whole: the quickest of some calls each.

    CPU seconds at other framerates are details. Every call generates a new motion, since a decoded one may cache what
    other framerates need.
    """

    def spent(rate: Fraction) -> tuple[float, float]:
        cpu, wall = time.process_time(), time.perf_counter()
        (field,) = model.generate([GenerationRequest(seconds)], seed=0, sampling=sampling)
        to_motion(field, rate)
        return time.process_time() - cpu, time.perf_counter() - wall

    def quickest(rate: Fraction) -> tuple[float, float]:
        spent(rate)  # warm-up: fills caches such as coordinates
        cpu, wall = zip(*(spent(rate) for _ in range(REPEATS)), strict=True)
        return min(cpu), min(wall)

    cpu, wall = quickest(fps)
    others = {f"at {label(rate)}": quickest(rate)[0] for rate in OTHER_FPS if rate != fps}
    return {CPU: Cell(cpu, details=others), WALL: Cell(wall)}


def _samplings(model: GenerativeModel, fps: Fraction, seconds: float) -> dict[str, SamplingOptions]:
    """A model's sampling options by the suffix of its row: its default, and other numbers of steps."""

    def positions(sampling: SamplingOptions) -> Float32[np.ndarray, "frames joints 3"]:
        (field,) = model.generate([GenerationRequest(seconds)], seed=0, sampling=sampling)
        return to_motion(field, fps).joint_positions

    own, suffix, others = positions(SamplingOptions()), "", {}
    for steps in STEPS:
        sampling, name = SamplingOptions(steps=steps), f", {steps} diffusion steps"
        try:
            if np.array_equal(positions(sampling), own):
                suffix = f"{name} (its own)"
            else:
                others[name] = sampling
        except UsageError:
            continue
    return {suffix: SamplingOptions(), **others}


FIGURE_5 = Table(
    "nerm",
    "figure5",
    "unconditional generation",
    "unconditional/3",
    unconditional,
    takes_samples=False,
    shown=installed_models,
)
FIGURE_8 = Table(
    "nerm", "figure8", "inference time and quality", "cost/3", cost, takes_samples=False, shown=installed_models
)
