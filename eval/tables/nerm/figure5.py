"""NeRM's Figure 5: unconditional generation, by clip-FID and diversity."""

from collections.abc import Mapping
from itertools import chain

from eval.clip_fid.score import CLIP_FID
from eval.report.results import Block, Result, Row, measure
from eval.sets.generated import needs_a_condition
from eval.sets.partial import collect
from eval.sets.planted import VARIANT_NOTES
from eval.sets.row_ids import REAL, RowId, Variant
from eval.tables.models import TrainedModel, require_models, training_note
from eval.tables.nerm.clip_fid_column import P1, P2
from eval.tables.nerm.run_figures import DIVERSITY, REAL_DIVERSITY, SYNTHESIS, Yardstick, label
from eval.tables.nerm.table2 import COLUMNS, ROW_NOTES
from eval.tables.parts import Part
from eval.tables.registry import Table, TableRequest
from motionkit.core.errors import UsageError
from motionkit.core.progress import tracked
from motionkit.generate.models import installed_models
from motionkit.training.run import RunError

VERSION = "unconditional/3"
ANY_CONDITION = "it never learnt to do without a condition: each motion has that of a random training motion"


def build_figure5(request: TableRequest) -> Result:
    """clip-FID and diversity of motions generated without a condition, or with any one if a model needs it.

    Raises `UsageError` without a run, `RunError` if it holds no model or none generates, and as loading the store.
    """
    if request.evaluated.run is None:
        raise UsageError("figure 5 needs trained systems: --run NAME (motionkit train --for figure:5)")
    store = request.open_store()
    models = require_models(request.evaluated.run)
    yardstick = Yardstick(store, request, request.fps or COLUMNS)
    floors = yardstick.floors()
    made = collect(
        tracked(request.on_progress, "systems", models.value, len(models.value)),
        lambda name: yardstick.unconditional(models.value[name]),
    )
    if not made.value:
        raise RunError("; ".join(made.missing))
    parts = {f"{name}, unconditional": part for name, part in made.value.items()}
    notes = {f"{name}, unconditional": _note(models.value[name]) for name in made.value}
    of_parts = [part.missing for part in parts.values()]
    protocol = request.clip_fid.protocol
    return Result(
        task="nerm-figure5",
        version=VERSION,
        title="Figure 5: unconditional generation",
        caption=(
            "Motions generated without a text or action of their own, as long as the real sequences of "
            f"{request.real.named}: mean over {protocol.replications} replications of N = {protocol.num_clips:,} "
            "random clips a side, ± half the 95 % interval: of clip-FID over takes, of diversity over replications."
        ),
        blocks=_blocks(parts, floors, notes, tuple(map(label, yardstick.rates))),
        definition={
            "split": request.real.split,
            "where": request.real.where,
            "low_pass_hz": request.clip_fid.low_pass_hz,
        },
        notes=(
            "The paper draws this figure as bars without numbers, for methods trained on another data set; its FID of "
            "whole motions needs the evaluator of Guo et al.",
        ),
        missing=tuple(dict.fromkeys((*models.missing, *made.missing, *floors.missing, *chain(*of_parts)))),
        provenance=request.provenance(store, run=request.evaluated.run.name),
    )


def _blocks(
    parts: Mapping[str, Part], floors: Part, notes: Mapping[str, str], columns: tuple[str, ...]
) -> tuple[Block, Block]:
    real = next(iter(parts.values())).rows[REAL_DIVERSITY]
    return (
        Block(
            "clip-FID on the kinematic descriptor",
            columns,
            (
                *(Row(str(row), "reference", floors.rows[str(row)], ROW_NOTES[row]) for row in (P1, P2)),
                *_rows(parts, SYNTHESIS, notes),
            ),
            metrics=(measure(CLIP_FID),),
        ),
        Block(
            "Diversity (Eq. 7) of clips in the kinematic descriptor's space",
            columns,
            (Row(str(REAL), "reference", real), *_rows(parts, DIVERSITY, {})),
            lower_is_better=False,
            note="Better the closer to real motion's. It sees clips, not whole motions.",
            metrics=(measure("diversity"),),
        ),
    )


def _note(trained: TrainedModel) -> str:
    condition = ANY_CONDITION if needs_a_condition(trained.loaded) else ""
    return "; ".join(filter(None, (training_note(trained), condition)))


def _rows(parts: Mapping[str, Part], quantity: str, notes: Mapping[str, str]) -> list[Row]:
    """Each model's row of a quantity, with a note, and that of its planted motions."""
    return [
        Row(str(RowId(name, variant)), "ours", part.rows.get(str(RowId(quantity, variant)), {}), note)
        for name, part in parts.items()
        for variant, note in (
            (Variant.AS_IS, notes.get(name, "")),
            (Variant.PLANTED, VARIANT_NOTES[Variant.PLANTED]),
        )
    ]


TABLE = Table(
    "nerm",
    "figure5",
    "unconditional generation",
    build_figure5,
    takes_samples=False,
    shown=installed_models,
)
