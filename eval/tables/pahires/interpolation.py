"""PA-HiRes' Tables 1 and 2: interpolation between given frames, at integer and other scales."""

from collections.abc import Sequence
from fractions import Fraction
from functools import partial
from typing import Any

from eval.completion.blocks import Shown, blocks_of, with_pools
from eval.completion.encoders import INTERPOLATION, trained_completers
from eval.completion.interpolation import timed_metrics
from eval.completion.protocol import INTEGER_SCALES, OTHER_SCALES, VERSION, InterpolationProtocol, scale_label
from eval.completion.takes import data_sets_of
from eval.metrics.metric import find_metric
from eval.report.results import Block, Result
from eval.tables.pahires.measured import Measured, measure_all
from eval.tables.parts import SOURCES, Reported, printed_rows, reported_figures
from eval.tables.registry import Table, TableRequest
from motionkit.edit.encoders import installed_encoders

METRICS = {
    "psnr": "PSNR (dB)",
    "ssim": "SSIM",
    "mpjpe_global": "MPJPE (cm)",
    "acceleration_error": "acceleration error (m/s²)",
}


def _details() -> dict[str, dict[str, str]]:
    """Further metrics, and all others declared for clips of joint positions."""
    names = ["rotation_angle_error", *(name for name in timed_metrics() if name not in METRICS)]
    titles = {}
    for metric in map(find_metric, names):
        title = metric.title[0].lower() + metric.title[1:]
        titles[metric.name] = f"{title} ({metric.unit})" if metric.unit else title
    return {"mpjpe_global": titles}


SMALL_TAKES = 100


def build_interpolation(number: str, scales: Sequence[Fraction], request: TableRequest) -> Result:
    """All rows of all data sets of the store, and which are not available.

    Raises `NoTakesError` if no data set has takes, `UsageError` for an unknown encoder, and as opening the store.
    """
    store, protocol = request.open_store(), InterpolationProtocol()
    store.select(request.real.condition)  # raises at once for SQL that is wrong
    trained = trained_completers("interpolation", request.evaluated.run, request.evaluated.encoders)
    completers = [*INTERPOLATION, *trained.value]
    found = measure_all(store, data_sets_of(store, request.fps), scales, completers, request)
    measured = found.value
    labels = tuple(scale_label(scale) for scale in scales)
    kind = "integer" if all(scale.denominator == 1 for scale in scales) else "non-integer"
    return Result(
        task=f"pahires-table{number}",
        version=VERSION,
        title=f"PA-HiRes, Table {number}: interpolation at {kind} scales",
        caption=caption(measured, protocol, request),
        blocks=(
            *blocks_of(
                with_pools([each.scope for each in measured], "clips"), completers, Shown(labels, METRICS, _details())
            ),
            *_paper_blocks(number, labels),
        ),
        definition=definition(protocol, request),
        notes=(*(remark for each in measured for remark in each.remarks), *NOTES),
        missing=tuple(dict.fromkeys((*trained.missing, *found.missing))),
        provenance=request.provenance(
            store,
            encoders={completer.name: completer.fingerprint for completer in completers},
            trained={completer.name: completer.facts for completer in completers if completer.trained},
        ),
    )


SHOWN = partial(installed_encoders, "interpolation")
TABLE_1 = Table(
    "pahires", "1", "interpolation at integer scales", partial(build_interpolation, "1", INTEGER_SCALES), shown=SHOWN
)
TABLE_2 = Table(
    "pahires", "2", "interpolation at other scales", partial(build_interpolation, "2", OTHER_SCALES), shown=SHOWN
)

NOTES = (
    "± is half the 95 % interval over takes: all clips of a take are resampled together.",
    "The paper defines neither the pose vector nor PSNR and SSIM of motion: orders and gaps of methods may be compared "
    "with it, decibels may not (docs/metrics.md).",
    "Interpolators need no training and may win; then a trained row is not worth its training at that scale.",
)


def caption(measured: Sequence[Measured], protocol: InterpolationProtocol, request: TableRequest) -> str:
    """The data of the numbers, with a remark on small samples."""
    counts = ", ".join(
        f"{each.clips.num_clips:,} clips of {each.clips.num_takes:,} takes of {each.data_set.label}"
        for each in measured
    )
    small = min(each.clips.num_takes for each in measured) < SMALL_TAKES
    return (
        f"Of every clip {protocol.num_kept} real frames are given and all frames between them asked for; no frame of "
        f"the truth is interpolated. S{request.real.named[1:]}: {counts}."
        + (" **Small scale**: a data set of fewer than 100 takes says little about others." if small else "")
    )


def definition(protocol: InterpolationProtocol, request: TableRequest) -> dict[str, Any]:
    """All settings that the figures depend on."""
    return {
        "frames": "every k-th real frame of sequences whose native framerate is k times the table's",
        "given": f"{protocol.num_kept} frames, the i-th at floor(i·s), with their true times",
        "clips": f"one every {protocol.clip_frames} frames, the same starts at every scale; shorter takes are left out",
        "pose": "22-joint layout: root position and two columns of each local rotation (135 numbers), in the frame of "
        "the clip's first pose",
        "unit range": "0.5 + (x − μ)/(4σ), not clipped; μ, σ of training clips; σ a quarter of its group's at least; "
        "numbers that never vary (leaf joints) are left out",
        "psnr": "data range 1, over synthesised frames, mean of the clips' dB, a clip at most 100 dB",
        "ssim": "data range 1, windows of 7 frames a number, over the whole clip",
        "mpjpe, rotation error": "synthesised frames; global positions; local rotations",
        "velocity, acceleration, jerk": "mean distance of per-second differences, over the whole clip",
        "split": request.real.split,
        "where": request.real.where,
    }


def _paper_blocks(number: str, columns: tuple[str, ...]) -> list[Block]:
    """The paper's figures, one block per data set and metric."""
    groups: dict[tuple[str, str], list[Reported]] = {}
    for figure in reported_figures("pahires", number):
        if figure.value is not None:
            groups.setdefault((figure.dataset, figure.metric), []).append(figure)
    titles = {"psnr_db": "PSNR (dB)", "ssim": "SSIM"}
    return [
        Block(
            f"Printed in the PA-HiRes paper, {data_set}: {titles[metric]}",
            columns,
            printed_rows(figures, lambda figure: "×" + figure.setting.removeprefix("x")),
            lower_is_better=False,
            note=f"Undefined pose vector, range and clips; trained for 1,000 epochs. Source: {SOURCES['pahires']}.",
        )
        for (data_set, metric), figures in groups.items()
    ]
