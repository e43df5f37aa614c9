"""NeRM's Table 1: text-to-motion with whole motions at one framerate, under a protocol."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt

from eval.metrics.number import Number, Scores
from eval.report.results import Block, Result
from eval.sample_folder import SampleFolder
from eval.sets.generated import refusal
from eval.sets.partial import PartialResult, collect
from eval.sets.planted import VARIANT_NOTES
from eval.sets.real import NoRealMotionError
from eval.sets.remarks import size_remarks
from eval.sets.row_ids import REAL, RowId, check_sample_names
from eval.tables.models import Trained, TrainedModel, trained_models, training_note
from eval.tables.nerm.retrieval import RetrievalSets, retrieval_blocks, sentence_embeddings
from eval.tables.nerm.sample_motions import sample_embeddings
from eval.tables.nerm.text_motion import ScoredRow, paper_block, scored_blocks, text_motion_evaluators
from eval.tables.registry import Table, TableRequest
from eval.text_motion.embedding_cache import FOLDER, Embedder
from eval.text_motion.evaluator import CosineEvaluator, TextMotionEvaluator
from eval.text_motion.model_motions import ModelMotions
from eval.text_motion.pairs import TextMotionPairs
from eval.text_motion.protocol import TextMotionProtocol, find_text_motion_protocol
from eval.text_motion.real_pairs import MADE_OF_22, CaptionedMotions, captioned_motions, kit_bone_lengths, limited
from eval.text_motion.retrieval import score_retrieval
from eval.text_motion.scores import score_text_motion
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.progress import task
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import SMPL22, STANDARD_SKELETONS
from motionkit.generate.models import GenerationRequest, installed_models

VERSION = "text-motion/1"
DEFAULT_FPS = Fraction(20)
FIXED_SUFFIX = "-fixed"
"""Suffix of a run whose models were trained at a single framerate."""
FIXED_ROW = ", fixed framerate"
"""Suffix of those models' rows."""
SMALL = 1000
"""With fewer motions the caption calls the table small-scale."""


@dataclass(frozen=True)
class _Sight:
    """An evaluator's input: framerate and joint layout."""

    fps: Fraction
    layout: str

    @property
    def label(self) -> str:
        """Its name in a result."""
        joints = (
            "" if self.layout == SMPL22.name else f", {STANDARD_SKELETONS[self.layout].num_joints} joints of KIT-ML"
        )
        return f"{float(self.fps):g} fps{joints}"


@dataclass(frozen=True, eq=False)
class _Job:
    """The common inputs of all evaluators.

    `sentences` are embeddings of the real motions' captions for protocols with retrieval; `pair_score` is the score of
    pairs that the evaluator's authors report.
    """

    request: TableRequest
    protocol: TextMotionProtocol
    models: Mapping[str, TrainedModel]
    folders: tuple[SampleFolder, ...]
    sentences: Float32[np.ndarray, "pairs numbers"] | None = None
    pair_score: str = ""


def build_table1(request: TableRequest) -> Result:
    """Compute every row that can be computed, and list what cannot.

    Raises `UsageError` for an unknown protocol, evaluator or framerate, `StoreError` for an unusable store, and
    `NoRealMotionError` if it has no captioned motion.
    """
    protocol = find_text_motion_protocol(request.published.name)
    store, folders = request.open_store(), request.sample_folders
    with task(request.on_progress, "loading"):
        evaluators = text_motion_evaluators(request, protocol)
        found = _models(request)
        models = {name: each for name, each in found.value.items() if not _refusal(each)}
        refused = tuple(f"{name}: {_refusal(each)}" for name, each in found.value.items() if name not in models)
        check_sample_names(request.evaluated.samples, models)
        for each in models.values():
            longest = each.loaded.max_duration_seconds
            lengths, kit_lengths = (limited(rule, longest) for rule in (protocol.lengths, protocol.kit_lengths))
            protocol = replace(protocol, lengths=lengths, kit_lengths=kit_lengths)
        real: dict[_Sight, CaptionedMotions] = {}
        for evaluator in evaluators.value:
            sight = _sight(request, evaluator)
            if sight not in real:
                rule = protocol.lengths_at(sight.fps)
                real[sight] = captioned_motions(
                    store, request.real.split, request.real.where, sight.fps, rule, sight.layout
                )
                _check_pool(real[sight], protocol, request)
    blocks = _all_blocks(_Job(request, protocol, models, folders), evaluators.value, real)
    return Result(
        task="nerm-table1",
        version=VERSION,
        title="Table 1: text-to-motion",
        caption=_caption(request, protocol, real),
        blocks=(*blocks.value, *map(paper_block, dict.fromkeys(sight.fps for sight in real))),
        definition=_definition(request, protocol, real),
        notes=_notes(protocol, real),
        missing=tuple(dict.fromkeys((*evaluators.missing, *found.missing, *refused, *blocks.missing))),
        provenance=request.provenance(
            store,
            runs={each.run.name: dict(each.identity) for each in models.values()},
            samples={folder.name: folder.fingerprint for folder in folders},
        ),
    )


TABLE = Table("nerm", "1", "text-to-motion at 20 fps", build_table1, shown=installed_models, reads=("evaluator",))


def _models(request: TableRequest) -> PartialResult[dict[str, TrainedModel]]:
    """The run's models and, if trained, those of a single framerate from the run with the suffix `-fixed`."""
    of_run = trained_models(request.evaluated.run)
    if request.evaluated.run is None:
        return of_run
    found, missing = dict(of_run.value), list(of_run.missing)
    run = request.evaluated.run.with_name(request.evaluated.run.name + FIXED_SUFFIX)
    for loader in installed_models().values():
        if not loader.fixed_fps_setting:
            continue
        title = loader.title + FIXED_SUFFIX
        if not run.is_dir():
            setting = f"--set {loader.fixed_fps_setting}={float(DEFAULT_FPS):g}"
            missing.append(
                f"{title}: there is no run {run.name!r} (motionkit train --run {run.name} {setting} makes it)"
            )
            continue
        model = Trained(loader, run)
        try:
            found[model.loaded.name + FIXED_ROW] = model
        except MotionkitError as error:
            missing.append(f"{title}: {error}")
    return PartialResult(found, tuple(missing))


def _refusal(model: TrainedModel) -> str:
    """Why a model has no row: it takes no texts. How long its motions may be then cuts no others."""
    return refusal(model.loaded, GenerationRequest(None, "a person walks"))


def _sight(request: TableRequest, evaluator: TextMotionEvaluator) -> _Sight:
    asked = request.fps or (evaluator.fps or DEFAULT_FPS,)
    if len(asked) != 1:
        raise UsageError("table 1 compares whole motions at one framerate: give one --fps, such as 20 or 12.5")
    if evaluator.fps not in (None, asked[0]):
        only = float(evaluator.fps or 0)
        raise UsageError(f"--fps {float(asked[0]):g}: the evaluator {evaluator.name!r} is only valid at {only:g} fps")
    return _Sight(asked[0], evaluator.layout)


def _check_pool(real: CaptionedMotions, protocol: TextMotionProtocol, request: TableRequest) -> None:
    """Raise if not a single pool can be filled."""
    if real.samples.num_sequences < protocol.pool:
        raise NoRealMotionError(
            f"{real.samples.name}: {real.samples.num_sequences} captioned motions take part, but a text chooses among "
            f"{protocol.pool} (protocol {protocol.name!r}); name a larger split (--split all) or ingest more"
        )
    if request.evaluated.max_motions < protocol.pool:
        raise UsageError(
            f"--motions {request.evaluated.max_motions}: a text chooses among {protocol.pool}; give at least that many"
        )


def _all_blocks(
    job: _Job, evaluators: list[TextMotionEvaluator], real: Mapping[_Sight, CaptionedMotions]
) -> PartialResult[list[Block]]:
    """Every evaluator's blocks, as far as it can read the real motions and captions.

    Raises its `MotionkitError` where none can.
    """
    blocks: list[Block] = []
    missing: list[str] = []
    for evaluator in evaluators:
        try:
            found = _blocks(job, evaluator, real[_sight(job.request, evaluator)])
        except MotionkitError as error:
            if len(evaluators) == 1:
                raise
            missing.append(f"evaluator {evaluator.name!r}: {error}")
        else:
            blocks += found.value
            missing += found.missing
    if not blocks:
        raise UsageError("; ".join(missing))
    return PartialResult(blocks, tuple(missing))


def _blocks(job: _Job, evaluator: TextMotionEvaluator, real: CaptionedMotions) -> PartialResult[tuple[Block, ...]]:
    """One evaluator's numbers."""
    protocol, request = job.protocol, job.request
    embedder = Embedder(evaluator, request.results / FOLDER)
    with task(request.on_progress, f"{evaluator.name}: embedding real motion"):
        ids = real.samples.sequence_ids
        pairs = TextMotionPairs(embedder.texts(real.captions), embedder.motions(real.samples), ids)
    chosen = _chosen(real, protocol, request)
    if protocol.retrieval:
        job = replace(job, sentences=sentence_embeddings(real.captions))
    if isinstance(evaluator, CosineEvaluator):
        job = replace(job, pair_score=evaluator.pair_score)
    folders = {folder.name: folder for folder in job.folders}
    made = collect(
        (*job.models, *folders),
        lambda name: (
            _model_rows(job, name, real, pairs, chosen, embedder)
            if name in job.models
            else [_sample_row(job, folders[name], real, pairs, embedder)]
        ),
        lambda name: f"{name}, {evaluator.name}",
        (MotionkitError, ValueError),
    )
    rows = [_real_row(job, pairs, chosen), *chain.from_iterable(made.value.values())]
    head = f"{evaluator.name} evaluator, protocol {protocol.name}, {float(real.samples.fps):g} fps"
    provenance = {"evaluator": evaluator.name, "fingerprint": evaluator.fingerprint, "protocol": protocol.name}
    main, other_way, *differences = scored_blocks(rows, pairs, protocol, request.seed, head, provenance)
    remark = evaluator.remark_at(real.samples.fps)
    main = replace(main, note=" ".join(filter(None, (main.note, remark))))
    own = None if job.sentences is None else RetrievalSets(pairs.select(chosen), job.sentences[chosen])
    found = () if own is None else retrieval_blocks(rows, own, protocol, request.seed, head, provenance)
    return PartialResult((main, other_way, *found, *differences), made.missing)


def _chosen(real: CaptionedMotions, protocol: TextMotionProtocol, request: TableRequest) -> npt.NDArray[np.int64]:
    """The real motions to generate for: all, or a random subset of the requested size."""
    number = real.samples.num_sequences
    most = min(request.evaluated.max_motions, protocol.num_motions or number)
    if number <= most:
        return np.arange(number)
    return np.sort(np.random.default_rng((request.seed, 7)).choice(number, size=most, replace=False))


def _real_row(job: _Job, pairs: TextMotionPairs, chosen: npt.NDArray[np.int64]) -> ScoredRow:
    """Real motion under the protocol; without FID if that would be a set's distance from itself."""
    own = pairs.select(chosen)
    scores = _score(job, own if job.protocol.reference == "paired" else pairs, [own])
    ranked = _retrieval(job, own, [own], chosen)
    if job.protocol.reference == "redraw":
        return ScoredRow(
            REAL, "reference", scores, "its FID is what dropped remainders and the choice of motions leave"
        )
    for name in ("fid", "fid_infinity", "kid"):
        scores.replications.pop(name, None)
    return ScoredRow(REAL, "reference", scores, retrieval=ranked)


def _model_rows(
    job: _Job,
    name: str,
    real: CaptionedMotions,
    pairs: TextMotionPairs,
    chosen: npt.NDArray[np.int64],
    embedder: Embedder,
) -> list[ScoredRow]:
    """A model's rows, as generated and planted."""
    trained, lengths, request = job.models[name], kit_bone_lengths(real.samples), job.request
    wanted = real.select(chosen)
    with task(request.on_progress, f"{embedder.evaluator.name}: {name}", note="motions generated") as work:
        motions = ModelMotions(name, trained.loaded, trained.identity, request.seed, lengths, work.advance)
        draws = [motions.draw(wanted, number, embedder) for number in range(request.evaluated.draws)]
        repeated = motions.repeated(wanted, job.protocol.multimodality, request.evaluated.max_motions, embedder)
    reference = pairs.select(chosen) if job.protocol.reference == "paired" else pairs
    rows = []
    for row in motions.rows:
        own = [draw[row] for draw in draws]
        remarks = size_remarks(pairs.motions, reference.motions, own[0].motions, request.seed)
        made = (training_note(trained), "" if lengths is None else MADE_OF_22, VARIANT_NOTES.get(row.variant))
        note = "; ".join((f"run {trained.run.name!r}", *filter(None, made), *remarks))
        scores = _score(job, reference, own, repeated.get(row))
        rows.append(ScoredRow(row, "ours", scores, note, _retrieval(job, reference, own, chosen)))
    return rows


def _sample_row(
    job: _Job, folder: SampleFolder, real: CaptionedMotions, pairs: TextMotionPairs, embedder: Embedder
) -> ScoredRow:
    found = sample_embeddings(folder, real, job.protocol, embedder)
    reference = pairs if found.real_rows is None else pairs.select(found.real_rows)
    scores = _score(job, reference, list(found.draws), found.repeated)
    remarks = size_remarks(pairs.motions, reference.motions, found.draws[0].motions, job.request.seed)
    ranked = _retrieval(job, reference, list(found.draws), found.real_rows)
    note = "; ".join((folder.describe(), *found.remarks, *remarks))
    return ScoredRow(RowId(folder.name), "ours", scores, note, ranked)


def _retrieval(
    job: _Job,
    reference: TextMotionPairs,
    draws: list[TextMotionPairs],
    rows: npt.NDArray[np.int64] | None,
) -> tuple[Mapping[str, Number], ...]:
    """Retrieval with motions for the captions of some of the real ones, under each of the protocol's rules."""
    if job.sentences is None:
        return ()
    sentences = job.sentences if rows is None else job.sentences[rows]
    return tuple(
        score_retrieval(reference, draws, rule, sentences, job.request.seed) for rule in job.protocol.retrieval
    )


def _score(
    job: _Job,
    reference: TextMotionPairs,
    draws: list[TextMotionPairs],
    repeated: npt.NDArray[np.float64] | None = None,
) -> Scores:
    with task(job.request.on_progress, "scoring", job.protocol.replications) as work:
        return score_text_motion(
            reference,
            draws,
            job.protocol,
            job.request.seed,
            repeated=repeated,
            compat=job.request.published.compat,
            pair_score=job.pair_score,
            on_replication=work.advance,
        )


def _caption(request: TableRequest, protocol: TextMotionProtocol, real: Mapping[_Sight, CaptionedMotions]) -> str:
    caption = (
        f"Whole motions and their captions, protocol {protocol.name!r} ({protocol.title}): mean over "
        f"{protocol.replications} replications ± half the 95 % interval over takes, {request.real.named}."
    )
    if request.published.compat:
        caption += f" Known bugs switched on: {', '.join(request.published.compat)}."
    fewest = min(each.samples.num_sequences for each in real.values())
    if fewest < SMALL:
        caption += (
            f" A small-scale run: {fewest} real motions, so rows say how systems rank on this store and no more; FID "
            "has the bias of its N."
        )
    return caption


def _definition(
    request: TableRequest, protocol: TextMotionProtocol, real: Mapping[_Sight, CaptionedMotions]
) -> dict[str, Any]:
    return {
        "version": VERSION,
        "protocol": asdict(protocol),
        "compat": list(request.published.compat),
        "draws": request.evaluated.draws,
        "motions": request.evaluated.max_motions,
        "real_motions": {
            sight.label: {
                "motions": each.samples.num_sequences,
                "different_captions": len(set(each.samples.captions)),
                "cropped": each.num_cropped,
                "left_out": dict(each.left_out),
            }
            for sight, each in real.items()
        },
        "captions": "a sequence's first one, and the stretch that it is about",
        "generated": "for the caption and the duration of each real motion, sampled at the framerate",
        "split": request.real.split,
        "where": request.real.where,
    }


def _notes(protocol: TextMotionProtocol, real: Mapping[_Sight, CaptionedMotions]) -> tuple[str, ...]:
    notes = []
    for sight, each in real.items():
        without = "".join(f", {count} left out ({reason})" for reason, count in each.left_out.items())
        longest = protocol.lengths_at(sight.fps).longest_seconds
        cropped = f", {each.num_cropped} cropped to their middle {longest:g} s"
        notes.append(
            f"Real motions at {sight.label}: {each.samples.num_sequences} with "
            f"{len(set(each.samples.captions))} different captions{cropped if each.num_cropped else ''}{without}."
        )
    chance = ", ".join(f"{rank / protocol.pool:.3f}" for rank in (1, 2, 3))
    return (
        *notes,
        f"Pools of {protocol.pool}: chance is {chance}.",
        "Embeddings, and with them every number but the paper's, compare only under one evaluator's fingerprint.",
    )
