"""NeRM's Figure 8: the cost of generating one motion against its quality."""

import time
from collections.abc import Mapping
from fractions import Fraction
from itertools import chain

import numpy as np

from eval.clip_fid.score import CLIP_FID
from eval.report.results import Block, Cell, Result, Row, measure
from eval.sets.partial import PartialResult, collect
from eval.sets.row_ids import RowId, Variant
from eval.tables.models import TrainedModel, require_models, training_note
from eval.tables.nerm.clip_fid_column import P1, P2
from eval.tables.nerm.run_figures import SYNTHESIS, Yardstick, label
from eval.tables.registry import Table, TableRequest
from motionkit.core.errors import UsageError
from motionkit.core.progress import tracked
from motionkit.core.shapes import Float32
from motionkit.fields.motion_field import to_motion
from motionkit.generate.models import GenerationRequest, GenerativeModel, SamplingOptions, installed_models
from motionkit.training.run import RunError

VERSION = "cost/3"
TARGET_FPS, OTHER_FPS = Fraction(60), (Fraction(20), Fraction(120))
SECONDS = 9.8
STEPS = (50, 20, 10, 5)
REPEATS = 5
VARIANTS = (Variant.AS_IS, Variant.PLANTED)
CPU, WALL = "CPU seconds a motion", "seconds a motion"


def build_figure8(request: TableRequest) -> Result:
    """Seconds for one motion of 9.8 s (or l_max) at 60 fps, and clip-FID there, by the number of diffusion steps.

    Raises `UsageError` without a run, `RunError` where it holds no model or none generates, and what loading the store
    raises.
    """
    if request.evaluated.run is None:
        raise UsageError("figure 8 needs trained systems: --run NAME (motionkit train --for figure:8)")
    fps, *others = request.fps or (TARGET_FPS,)
    if others:
        raise UsageError(f"figure 8 is at one framerate: --fps {fps}")
    store, models = request.open_store(), require_models(request.evaluated.run)
    yardstick = Yardstick(store, request, (fps,))
    floors = yardstick.floors()
    quality = f"clip-FID, {label(fps)}"
    references = [Row(str(row), "reference", _renamed(floors.rows[str(row)], label(fps), quality)) for row in (P1, P2)]
    seconds = min(SECONDS, *(trained.loaded.max_duration_seconds for trained in models.value.values()))
    made = collect(
        tracked(request.on_progress, "systems", models.value, len(models.value)),
        lambda name: _rows_of(name, models.value[name], yardstick, seconds),
    )
    if not made.value:
        raise RunError("; ".join(made.missing))
    rows = [*references, *chain.from_iterable(each.value for each in made.value.values())]
    of_rows = [each.missing for each in made.value.values()]
    return Result(
        task="nerm-figure8",
        version=VERSION,
        title="Figure 8: inference time and quality",
        caption=(
            f"Generating one motion of {seconds:g} s at {label(fps)} without a condition, the quickest of {REPEATS} "
            f"calls; planting is not in it. clip-FID as in Table 2, {request.real.named}."
        ),
        blocks=(
            Block(
                "Cost and clip-FID",
                (CPU, WALL, *(str(RowId(quality, variant)) for variant in VARIANTS)),
                tuple(rows),
                metrics=tuple(measure(CLIP_FID, column=str(RowId(quality, variant))) for variant in VARIANTS),
            ),
        ),
        definition={"seconds": seconds, "fps": str(fps), "repeats": REPEATS, "split": request.real.split},
        notes=(
            "The paper draws this figure without numbers, for one GPU (RTX 3090). Seconds are of this machine, and "
            "wall seconds of whatever else it did; CPU seconds count all threads.",
        ),
        missing=tuple(dict.fromkeys((*models.missing, *made.missing, *floors.missing, *chain(*of_rows)))),
        provenance=request.provenance(store, run=request.evaluated.run.name),
    )


def _rows_of(name: str, trained: TrainedModel, yardstick: Yardstick, seconds: float) -> PartialResult[list[Row]]:
    """A model's row for each way of sampling it."""
    (fps,) = yardstick.rates
    rows: list[Row] = []
    missing: list[str] = []
    for suffix, sampling in _samplings(trained.loaded, fps, seconds).items():
        part = yardstick.synthesis(trained, sampling, planted=True)
        missing += part.missing
        cells = generation_cost(trained.loaded, sampling, fps, seconds)
        for variant in VARIANTS:
            column = str(RowId(f"clip-FID, {label(fps)}", variant))
            cells |= _renamed(part.rows[str(RowId(SYNTHESIS, variant))], label(fps), column)
        rows.append(Row(f"{name}{suffix}", "ours", cells, training_note(trained)))
    return PartialResult(rows, tuple(missing))


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


def _renamed(cells: Mapping[str, Cell], column: str, name: str) -> dict[str, Cell]:
    return {name: cells[column]} if column in cells else {}


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


TABLE = Table(
    "nerm",
    "figure8",
    "inference time and quality",
    build_figure8,
    takes_samples=False,
    shown=installed_models,
)
