"""Table 1: the available text-motion evaluators, and the blocks of their rows."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from eval.metrics.gaussian import fit_gaussian, frechet_distance
from eval.metrics.metric import find_metric
from eval.metrics.number import Number, Scores, over_replications
from eval.metrics.r_precision import pool_distances, ranked_both_ways
from eval.report.differences import DRAWING, differences_block, of_interest, score_differences
from eval.report.results import Block, Cell, Origin, Row, cell_of, measure
from eval.sets.partial import PartialResult, collect
from eval.sets.row_ids import RowId
from eval.tables.parts import SOURCES, printed_rows, reported_figures
from eval.tables.registry import TableRequest
from eval.text_motion.evaluator import TextMotionEvaluator
from eval.text_motion.guo.kind import Padding
from eval.text_motion.pairs import PairTerms, TextMotionPairs
from eval.text_motion.protocol import PADDING_LEAK, TextMotionProtocol, chosen_bugs
from eval.text_motion.scores import PAIR_SCORES
from motionkit.core.errors import MotionkitError, UsageError

DEFAULT = ("native",)


def text_motion_evaluators(
    request: TableRequest, protocol: TextMotionProtocol
) -> PartialResult[list[TextMotionEvaluator]]:
    """The requested evaluators, by default `native`.

    Raises `UsageError` for a name that is not a text-motion evaluator, for a known bug that the protocol or the
    evaluator does not have, and if no evaluator is available.
    """
    chosen_bugs(protocol.name, protocol.known_bugs, request.published.compat)
    known: dict[str, Callable[[TableRequest], TextMotionEvaluator]] = {
        "native": _native,
        "guo": partial(_guo, leak=protocol.leak),
        "motion-clip": _motion_clip,
        "tmr": _tmr,
    }
    wanted = request.evaluators.names or DEFAULT
    for name in wanted:
        if name not in known:
            raise UsageError(f"--evaluator {name}: not an evaluator of text and motion; give {', '.join(known)}")
    found = collect(wanted, lambda name: known[name](request), "evaluator {!r}".format)
    if not found.value:
        raise UsageError("; ".join(found.missing))
    return PartialResult(list(found.value.values()), found.missing)


def _native(request: TableRequest) -> TextMotionEvaluator:
    from eval.native_evaluator.evaluator import NativeTextMotion, load_native

    if PADDING_LEAK.name in request.published.compat:
        raise UsageError(f"--compat {PADDING_LEAK.name} is a bug of Guo's evaluator: --evaluator guo --weights FILE")
    if request.evaluated.run is None:
        raise MotionkitError("it belongs to a run, and none was given (motionkit train --stage evaluator)")
    return NativeTextMotion(load_native(request.evaluated.run))


def _guo(request: TableRequest, leak: Padding) -> TextMotionEvaluator:
    from eval.text_motion.guo.evaluator import load_guo

    if request.evaluators.guo is None:
        raise UsageError("--evaluator guo needs its weights: --weights finest.tar (docs/evaluators.md)")
    if request.evaluators.guo.glove is None:
        raise UsageError("--evaluator guo reads captions with GloVe's word vectors: --glove DIR (docs/evaluators.md)")
    if PADDING_LEAK.name in request.published.compat and request.evaluators.guo.padding == "masked":
        return load_guo(replace(request.evaluators.guo, padding=leak))
    return load_guo(request.evaluators.guo)


def _motion_clip(request: TableRequest) -> TextMotionEvaluator:
    from eval.text_motion.motion_clip import load_motion_clip

    if request.evaluators.motion_clip is None:
        raise UsageError("--evaluator motion-clip needs its folder: --motion-clip DIR (docs/evaluators.md)")
    return load_motion_clip(request.evaluators.motion_clip)


def _tmr(request: TableRequest) -> TextMotionEvaluator:
    from eval.native_evaluator.evaluator import load_tmr

    if request.evaluated.run is None:
        raise MotionkitError("it belongs to a run, and none was given (motionkit train --stage tmr)")
    return load_tmr(request.evaluated.run)


ORACLE, FLOOR = "each motion on its caption's point", "real, disjoint halves"
NOTES = {
    ORACLE: "the ceiling of R-Precision: motions that share a caption are indistinguishable",
    FLOOR: "FID between random halves of the real motions, split anew in every replication: what other motions reach; "
    "± is of a single split",
}
DETAILS = ("fid_infinity", "kid")
COUNT = "N"
PRINTED_NOTES = (
    "Theirs, not ours: another evaluator on other motions; FIDs compare under one evaluator, reference and N only. "
    "NeRM's text does not say its N. MDM's FID is of 1,024 generated motions, T2M's of 4,640. MDM's R-Precision and "
    "MultiModal Dist predate the correction of a bug in its captions' lengths (motion-diffusion-model #182), its "
    "MultiModality that of #241. Empty cells are not printed or not legible in our copy. "
)


@dataclass(frozen=True)
class ScoredRow:
    """A row's scores; `retrieval` has a table's values for each of the protocol's rules."""

    row: RowId
    origin: Origin
    scores: Scores
    note: str = ""
    retrieval: tuple[Mapping[str, Number], ...] = ()


def title_of(name: str) -> str:
    """A metric as a column's name, with the direction of better values: ↑, ↓, or → for as close to real as can be."""
    metric = find_metric(name)
    arrow = "→" if metric.higher_is_better is None else "↑" if metric.higher_is_better else "↓"
    return f"{metric.title} {arrow}"


def scored_blocks(
    rows: Sequence[ScoredRow],
    real: TextMotionPairs,
    protocol: TextMotionProtocol,
    seed: int,
    head: str,
    provenance: Mapping[str, str],
) -> tuple[Block, ...]:
    """All metrics with the protocol's direction of R-Precision, the other direction, and differences of rows."""
    texts_ask = [f"r_precision_top{rank}" for rank in (1, 2, 3)]
    motions_ask = [f"{name}_motion_asks" for name in texts_ask]
    shared = [remark for remark in rows[0].scores.remarks if all(remark in row.scores.remarks for row in rows)]
    asked, turned = (texts_ask, motions_ask) if protocol.asks == "text" else (motions_ask, texts_ask)
    paired = [name for name in PAIR_SCORES if name in rows[0].scores.values]
    every = [*asked, "mm_dist", *paired, "fid", "diversity", protocol.multimodality.metric]
    oracle = _oracle(real, protocol, seed)
    floor = {title_of("fid"): cell_of(_halves(real, protocol, seed)), COUNT: Cell(len(real.motions) // 2)}
    main = Block(
        f"Table 1: {head}",
        (*map(title_of, every), COUNT),
        (
            Row(ORACLE, "reference", {title_of(name): oracle[name] for name in asked}, NOTES[ORACLE]),
            Row(FLOOR, "reference", floor, NOTES[FLOOR]),
            *(_row(row, every, leaving_out=shared) for row in rows),
        ),
        lower_is_better=False,
        note=". ".join(
            (f"{COUNT}: motions of a row that count; FIDs of different {COUNT} do not compare", *map(_sentence, shared))
        )
        + ".",
        provenance=provenance,
        metrics=tuple(measure(name, column=title_of(name)) for name in every),
    )
    other_way = Block(
        f"R-Precision the other way round: {head}",
        (*map(title_of, turned), COUNT),
        (
            Row(ORACLE, "reference", {title_of(name): oracle[name] for name in turned}, NOTES[ORACLE]),
            *(replace(_row(row, turned), note="") for row in rows),
        ),
        lower_is_better=False,
        note="The reference code asks with a text for its motion; the NeRM paper's words, with a motion for its text.",
        provenance=provenance,
        metrics=tuple(measure(name, column=title_of(name)) for name in turned),
    )
    own = {each.row: each.scores.values for each in rows if each.origin == "ours"}
    differences = score_differences(own, {name: title_of(name) for name in every})
    tests = differences_block(main, of_interest(main, differences))
    return (main, other_way) if tests is None else (main, other_way, tests)


def paper_block(fps: Fraction) -> Block:
    """The paper's figures for the data set of this framerate."""
    dataset = "KIT" if fps == Fraction(25, 2) else "HumanML3D"
    figures = [figure for figure in reported_figures("nerm", "1") if figure.dataset == dataset]
    names = [
        name
        for name in ("r_precision_top3", "mm_dist", "fid", "diversity", "multimodality")
        if any(figure.metric == name for figure in figures)
    ]
    return Block(
        f"Printed in the NeRM paper ({dataset})",
        tuple(map(title_of, names)),
        printed_rows(figures, lambda figure: title_of(figure.metric)),
        lower_is_better=False,
        note=f"{PRINTED_NOTES}Source: {SOURCES['nerm']}.",
    )


def _sentence(remark: str) -> str:
    return remark[0].upper() + remark[1:].rstrip(".")


def _row(row: ScoredRow, names: Sequence[str], leaving_out: Sequence[str] = ()) -> Row:
    values = row.scores.values
    cells = {title_of(name): _score_cell(values[name]) for name in names if name in values}
    details = {find_metric(name).title: values[name].value for name in DETAILS if name in values}
    if "fid" in names and details:
        fid = cells[title_of("fid")]
        cells[title_of("fid")] = replace(fid, details={**fid.details, **details})
    sizes = row.scores.sizes
    cells[COUNT] = Cell(sizes["generated"])
    counted = f"N = {sizes['generated']:,} against {sizes['real']:,} real motions"
    if "multimodality texts" in sizes:
        counted += f", {sizes['multimodality generations']} motions of {sizes['multimodality texts']} texts"
    remarks = [remark for remark in row.scores.remarks if remark not in leaving_out]
    return Row(str(row.row), row.origin, cells, "; ".join((*([row.note] if row.note else []), counted, *remarks)))


def _score_cell(number: Number) -> Cell:
    """A metric of a row, with the interval over replications as a detail if takes were resampled too.

    Replications that differ by no more than rounding, as FID of one set of motions does, make no interval.
    """
    drawn = number.drawing > 1e-9 * abs(number.value)
    if number.ci95 == number.drawing:
        return Cell(number.value, number.ci95 if drawn else None)
    return Cell(number.value, number.ci95, {DRAWING: number.drawing} if drawn else {})


def _oracle(real: TextMotionPairs, protocol: TextMotionProtocol, seed: int) -> dict[str, Cell]:
    """R-Precision of an oracle that embeds motions as their texts."""
    scores, own = Scores(), TextMotionPairs(real.texts, real.texts, real.takes)
    terms = PairTerms([own])
    for replication in range(protocol.replications):
        order = np.random.default_rng((seed, replication, 5)).permutation(len(own.texts))
        distances = pool_distances(own.texts, own.texts, order, protocol.pool)
        terms.of_draw(0)(distances, order)
        both = ranked_both_ways(distances)
        for suffix, direction in (("", both.text_asks), ("_motion_asks", both.motion_asks)):
            for rank, share in enumerate(direction.top.tolist(), start=1):
                scores.add(f"r_precision_top{rank}{suffix}", share)
    scores.resampled |= terms.resampled_means()
    return {name: _score_cell(score) for name, score in scores.values.items()}


def _halves(real: TextMotionPairs, protocol: TextMotionProtocol, seed: int) -> Number:
    values = []
    with threadpool_limits(1, "blas"):
        for replication in range(protocol.replications):
            order = np.random.default_rng((seed, replication, 6)).permutation(len(real.motions))
            first, second = order[: len(order) // 2], order[len(order) // 2 :]
            values.append(frechet_distance(fit_gaussian(real.motions[first]), fit_gaussian(real.motions[second])))
    found = over_replications(values)
    return replace(found, ci95=found.drawing * math.sqrt(len(values)))
