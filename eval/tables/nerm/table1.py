"""NeRM's Table 1: text-to-motion with whole motions at one framerate, under a protocol."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from fractions import Fraction

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from eval.config import EvalConfig
from eval.metrics.distributions import fit_gaussian, frechet_distance
from eval.metrics.metric import find_metric
from eval.metrics.number import Number, Scores, over_replications
from eval.metrics.retrieval import RECALL_RANKS, pool_distances, ranked_both_ways
from eval.report.results import (
    DRAWING,
    Block,
    Cell,
    Origin,
    Row,
    cell_of,
    differences_block,
    measure,
    of_interest,
    score_differences,
)
from eval.sample_folder import SampleFolder
from eval.sets.motions import VARIANT_NOTES, NoRealMotionError, refusal
from eval.sets.sets import REAL, RowId, check_sample_names, size_remarks
from eval.tables.models import Trained, TrainedModel, trained_models, training_note
from eval.tables.nerm.sample_motions import sample_embeddings
from eval.tables.table import SOURCES, Content, Table, printed_block, reported_figures
from eval.text_motion.embedding_cache import FOLDER, Embedder
from eval.text_motion.evaluator import TextMotionEvaluator
from eval.text_motion.model_motions import ModelMotions
from eval.text_motion.pairs import PairTerms, TextMotionPairs
from eval.text_motion.protocol import (
    RetrievalRule,
    TextMotionProtocol,
    find_text_motion_protocol,
)
from eval.text_motion.real_pairs import MADE_OF_22, CaptionedMotions, captioned_motions, kit_bone_lengths, limited
from eval.text_motion.retrieval import SUFFIXES, no_distance, score_retrieval, share_of_same_texts
from eval.text_motion.scores import PAIR_SCORES, score_text_motion
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.progress import task
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import SMPL22, STANDARD_SKELETONS
from motionkit.generate.models import GenerationRequest, installed_models
from motionkit.store.reader import Store
from motionkit.training.text import load_text_encoder

VERSION = "text-motion/1"
DEFAULT_FPS = Fraction(20)
FIXED_SUFFIX, FIXED_ROW = "-fixed", ", fixed framerate"
"""Suffixes of a run whose models were trained at a single framerate, and of their rows."""
SMALL = 1000
"""With fewer motions the caption calls the table small-scale."""
SENTENCES = "minilm"
CHANCE, ORACLE, FLOOR = "chance", "each motion on its caption's point", "real, disjoint halves"
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


# A framerate and a joint layout, which an evaluator sees.
_Sight = tuple[Fraction, str]


@dataclass(frozen=True)
class ScoredRow:
    """A row's scores; `retrieval` has a table's values for each of the protocol's rules."""

    row: RowId
    origin: Origin
    scores: Scores
    note: str = ""
    retrieval: tuple[Mapping[str, Number], ...] = ()


def compute(config: EvalConfig, store: Store) -> Content:
    """Compute every row that can be computed, and list what cannot.

    Raises `UsageError` for an unknown protocol, evaluator or framerate, `StoreError` for an unusable store, and
    `NoRealMotionError` if it has no captioned motion.
    """
    protocol = find_text_motion_protocol(config.protocol)
    with task(config.on_progress, "loading"):
        evaluators = text_motion_evaluators(config)
        models = _models(config)
        check_sample_names(config.samples, models)
        for each in models.values():
            longest = each.loaded.max_duration_seconds
            lengths, kit_lengths = (limited(rule, longest) for rule in (protocol.lengths, protocol.kit_lengths))
            protocol = replace(protocol, lengths=lengths, kit_lengths=kit_lengths)
        real: dict[_Sight, CaptionedMotions] = {}
        for evaluator in evaluators:
            fps, layout = sight = _sight(config, evaluator)
            if sight not in real:
                rule = protocol.lengths_at(fps)
                real[sight] = captioned_motions(store, config.split, config.where, fps, rule, layout)
                _check_pool(real[sight], protocol, config)
    blocks: list[Block] = []
    for evaluator in evaluators:
        try:
            blocks += _OneEvaluator(config, protocol, evaluator, real[_sight(config, evaluator)]).blocks(models)
        except MotionkitError as error:
            if len(evaluators) == 1:
                raise
            config.missing.add(f"evaluator {evaluator.name!r}: {error}")
    if not blocks:
        raise UsageError("; ".join(config.missing.lines))
    return Content(
        caption=_caption(config, protocol, real),
        blocks=(*blocks, *map(paper_block, dict.fromkeys(fps for fps, _ in real))),
        definition={
            "protocol": asdict(protocol),
            "real_motions": {
                _label(sight): {
                    "motions": each.samples.num_sequences,
                    "different_captions": len(set(each.samples.captions)),
                    "cropped": each.num_cropped,
                    "left_out": dict(each.left_out),
                }
                for sight, each in real.items()
            },
        },
        notes=_notes(protocol, real),
        provenance={"runs": {each.run.name: dict(each.identity) for each in models.values()}},
    )


TABLE = Table(
    "nerm",
    "1",
    "text-to-motion at 20 fps",
    VERSION,
    compute,
    heading="Table 1: text-to-motion",
    shown=installed_models,
    reads=("evaluator",),
)


def text_motion_evaluators(config: EvalConfig) -> list[TextMotionEvaluator]:
    """The requested evaluators, by default `native`.

    Raises `UsageError` for a name that is not a text-motion evaluator, and if no evaluator is available.
    """
    known: dict[str, Callable[[], TextMotionEvaluator]] = {
        "native": lambda: _native(config),
        "guo": lambda: _guo(config),
        "motion-clip": lambda: _motion_clip(config),
        "tmr": lambda: _tmr(config),
    }
    wanted, found = config.evaluators or ("native",), []
    for name in wanted:
        if name not in known:
            raise UsageError(f"--evaluator {name}: not an evaluator of text and motion; give {', '.join(known)}")
    for name in wanted:
        with config.missing.skipping(f"evaluator {name!r}"):
            found.append(known[name]())
    if not found:
        raise UsageError("; ".join(config.missing.lines))
    return found


def _native(config: EvalConfig) -> TextMotionEvaluator:
    from eval.native_evaluator.evaluator import NativeTextMotion, load_native

    if config.run is None:
        raise MotionkitError("it belongs to a run, and none was given (motionkit train --stage evaluator)")
    return NativeTextMotion(load_native(config.run))


def _guo(config: EvalConfig) -> TextMotionEvaluator:
    from eval.text_motion.guo.evaluator import load_guo

    if config.guo is None:
        raise UsageError("--evaluator guo needs its weights: --weights finest.tar (docs/evaluators.md)")
    if config.guo.glove is None:
        raise UsageError("--evaluator guo reads captions with GloVe's word vectors: --glove DIR (docs/evaluators.md)")
    return load_guo(config.guo)


def _motion_clip(config: EvalConfig) -> TextMotionEvaluator:
    from eval.text_motion.motion_clip import load_motion_clip

    if config.motion_clip is None:
        raise UsageError("--evaluator motion-clip needs its folder: --motion-clip DIR (docs/evaluators.md)")
    return load_motion_clip(config.motion_clip)


def _tmr(config: EvalConfig) -> TextMotionEvaluator:
    from eval.native_evaluator.evaluator import load_tmr

    if config.run is None:
        raise MotionkitError("it belongs to a run, and none was given (motionkit train --stage tmr)")
    return load_tmr(config.run)


def _models(config: EvalConfig) -> dict[str, TrainedModel]:
    """The run's models that know texts and, if trained, those of a single framerate from the run `RUN-fixed`."""
    found = trained_models(config.run, config.missing)
    if config.run is not None:
        run = config.run.with_name(config.run.name + FIXED_SUFFIX)
        for loader in installed_models().values():
            if not loader.fixed_fps_setting:
                continue
            title = loader.title + FIXED_SUFFIX
            if not run.is_dir():
                setting = f"--set {loader.fixed_fps_setting}={float(DEFAULT_FPS):g}"
                command = f"motionkit train --run {run.name} {setting}"
                config.missing.add(f"{title}: there is no run {run.name!r} ({command} makes it)")
                continue
            with config.missing.skipping(title):
                model = Trained(loader, run)
                found[model.loaded.name + FIXED_ROW] = model
    for name in list(found):
        # A model without texts has no row, nor do its longest motions limit others'.
        if refused := refusal(found[name].loaded, GenerationRequest(None, "a person walks")):
            config.missing.add(f"{name}: {refused}")
            del found[name]
    return found


def _sight(config: EvalConfig, evaluator: TextMotionEvaluator) -> _Sight:
    asked = config.fps or (evaluator.fps or DEFAULT_FPS,)
    if len(asked) != 1:
        raise UsageError("table 1 compares whole motions at one framerate: give one --fps, such as 20 or 12.5")
    if evaluator.fps not in (None, asked[0]):
        only = float(evaluator.fps or 0)
        raise UsageError(f"--fps {float(asked[0]):g}: the evaluator {evaluator.name!r} is only valid at {only:g} fps")
    return asked[0], evaluator.layout


def _label(sight: _Sight) -> str:
    fps, layout = sight
    joints = "" if layout == SMPL22.name else f", {STANDARD_SKELETONS[layout].num_joints} joints of KIT-ML"
    return f"{float(fps):g} fps{joints}"


def _check_pool(real: CaptionedMotions, protocol: TextMotionProtocol, config: EvalConfig) -> None:
    """Raise if not a single pool can be filled."""
    if real.samples.num_sequences < protocol.pool:
        raise NoRealMotionError(
            f"{real.samples.name}: {real.samples.num_sequences} captioned motions take part, but a text chooses among "
            f"{protocol.pool} (protocol {protocol.name!r}); name a larger split (--split all) or ingest more"
        )
    if config.max_motions < protocol.pool:
        raise UsageError(
            f"--motions {config.max_motions}: a text chooses among {protocol.pool}; give at least that many"
        )


class _OneEvaluator:
    """One evaluator's rows and blocks."""

    def __init__(
        self, config: EvalConfig, protocol: TextMotionProtocol, evaluator: TextMotionEvaluator, real: CaptionedMotions
    ) -> None:
        self.config, self.protocol, self.evaluator, self.real = config, protocol, evaluator, real
        self.embedder = Embedder(evaluator, config.results / FOLDER)
        with task(config.on_progress, f"{evaluator.name}: embedding real motion"):
            texts, motions = self.embedder.texts(real.captions), self.embedder.motions(real.samples)
            self.pairs = TextMotionPairs(texts, motions, real.samples.sequence_ids)
        self.chosen = self._chosen()
        self.pair_score = evaluator.pair_score
        # Embeddings of the real motions' captions by an encoder independent of the evaluators, for retrieval.
        self.sentences: Float32[np.ndarray, "pairs numbers"] | None = None
        if protocol.retrieval:
            self.sentences = load_text_encoder(SENTENCES).encode([caption.text for caption in real.captions])

    def blocks(self, models: Mapping[str, TrainedModel]) -> list[Block]:
        """All scores, retrieval, and differences of rows."""
        fps, missing = self.real.samples.fps, self.config.missing
        rows = [self._real_row()]
        for name, model in models.items():
            with missing.skipping(f"{name}, {self.evaluator.name}", (MotionkitError, ValueError)):
                rows += self._model_rows(name, model)
        for folder in self.config.sample_folders:
            with missing.skipping(f"{folder.name}, {self.evaluator.name}", (MotionkitError, ValueError)):
                rows.append(self._sample_row(folder))
        head = f"{self.evaluator.name} evaluator, protocol {self.protocol.name}, {float(fps):g} fps"
        main, other_way, *differences = scored_blocks(rows, self.pairs, self.protocol, self.config.seed, head)
        main = replace(main, note=" ".join(filter(None, (main.note, self.evaluator.remark_at(fps)))))
        provenance = {
            "evaluator": self.evaluator.name,
            "fingerprint": self.evaluator.fingerprint,
            "protocol": self.protocol.name,
        }
        found = [main, other_way]
        if self.sentences is not None:
            own, sentences = self.pairs.select(self.chosen), self.sentences[self.chosen]
            found += [
                retrieval_block(rule, index, rows, own, sentences, self.config.seed, head)
                for index, rule in enumerate(self.protocol.retrieval)
            ]
        return [*(replace(block, provenance=provenance) for block in found), *differences]

    def _chosen(self) -> npt.NDArray[np.int64]:
        """The real motions to generate for: all, or a random subset of the requested size."""
        number = self.real.samples.num_sequences
        most = min(self.config.max_motions, self.protocol.num_motions or number)
        if number <= most:
            return np.arange(number)
        return np.sort(np.random.default_rng((self.config.seed, 7)).choice(number, size=most, replace=False))

    def _real_row(self) -> ScoredRow:
        """Real motion under the protocol; without FID if that would be a set's distance from itself."""
        own = self.pairs.select(self.chosen)
        scores = self._score(own if self.protocol.reference == "paired" else self.pairs, [own])
        if self.protocol.reference == "redraw":
            note = "its FID is what dropped remainders and the choice of motions leave"
            return ScoredRow(REAL, "reference", scores, note)
        for name in ("fid", "fid_infinity", "kid"):
            scores.replications.pop(name, None)
        return ScoredRow(REAL, "reference", scores, retrieval=self._retrieval(own, [own], self.chosen))

    def _model_rows(self, name: str, trained: TrainedModel) -> list[ScoredRow]:
        """A model's rows, as generated and planted."""
        config, lengths = self.config, kit_bone_lengths(self.real.samples)
        wanted = self.real.select(self.chosen)
        with task(config.on_progress, f"{self.evaluator.name}: {name}", note="motions generated") as work:
            motions = ModelMotions(name, trained.loaded, trained.identity, config.seed, lengths, work.advance)
            draws = [motions.draw(wanted, number, self.embedder) for number in range(config.draws)]
            repeated = motions.repeated(wanted, self.protocol.multimodality, config.max_motions, self.embedder)
        reference = self.pairs.select(self.chosen) if self.protocol.reference == "paired" else self.pairs
        rows = []
        for row in motions.rows:
            own = [draw[row] for draw in draws]
            remarks = size_remarks(self.pairs.motions, reference.motions, own[0].motions, config.seed)
            made = (training_note(trained), "" if lengths is None else MADE_OF_22, VARIANT_NOTES.get(row.variant))
            note = "; ".join((f"run {trained.run.name!r}", *filter(None, made), *remarks))
            scores = self._score(reference, own, repeated.get(row))
            rows.append(ScoredRow(row, "ours", scores, note, self._retrieval(reference, own, self.chosen)))
        return rows

    def _sample_row(self, folder: SampleFolder) -> ScoredRow:
        found = sample_embeddings(folder, self.real, self.protocol, self.embedder)
        reference, draws = self.pairs, list(found.draws)
        if found.real_rows is not None:
            reference = self.pairs.select(found.real_rows)
        scores = self._score(reference, draws, found.repeated)
        remarks = size_remarks(self.pairs.motions, reference.motions, draws[0].motions, self.config.seed)
        note = "; ".join((folder.describe(), *found.remarks, *remarks))
        ranked = self._retrieval(reference, draws, found.real_rows)
        return ScoredRow(RowId(folder.name), "ours", scores, note, ranked)

    def _retrieval(
        self, reference: TextMotionPairs, draws: list[TextMotionPairs], rows: npt.NDArray[np.int64] | None
    ) -> tuple[Mapping[str, Number], ...]:
        """Retrieval with motions for the captions of some of the real ones, under each of the protocol's rules."""
        if self.sentences is None:
            return ()
        sentences = self.sentences if rows is None else self.sentences[rows]
        return tuple(
            score_retrieval(reference, draws, rule, sentences, self.config.seed) for rule in self.protocol.retrieval
        )

    def _score(
        self,
        reference: TextMotionPairs,
        draws: list[TextMotionPairs],
        repeated: npt.NDArray[np.float64] | None = None,
    ) -> Scores:
        with task(self.config.on_progress, "scoring", self.protocol.replications) as work:
            return score_text_motion(
                reference,
                draws,
                self.protocol,
                self.config.seed,
                repeated=repeated,
                pair_score=self.pair_score,
                on_replication=work.advance,
            )


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
    names = ("r_precision_top3", "mm_dist", "fid", "diversity", "multimodality")
    return printed_block(
        f"Printed in the NeRM paper ({dataset})",
        figures,
        lambda figure: title_of(figure.metric),
        columns=tuple(title_of(name) for name in names if any(figure.metric == name for figure in figures)),
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


def retrieval_block(
    rule: RetrievalRule,
    index: int,
    rows: Sequence[ScoredRow],
    real: TextMotionPairs,
    sentences: Float32[np.ndarray, "pairs numbers"],
    seed: int,
    head: str,
) -> Block:
    """Recalls and median ranks of every row, between those of chance and of texts that stand for their motions."""
    names = [
        f"{name}{SUFFIXES[direction]}"
        for direction in rule.directions
        for name in (*(f"recall_at_{rank}" for rank in RECALL_RANKS), "median_rank")
    ]

    def cells(values: Mapping[str, Number]) -> dict[str, Cell]:
        return {title_of(name): Cell(values[name].value) for name in names}

    number, oracle = len(real.motions), TextMotionPairs(real.texts, real.texts)
    chance = score_retrieval(real, [real], rule, sentences, seed, no_distance)
    ceiling = score_retrieval(oracle, [oracle], rule, sentences, seed)
    same = share_of_same_texts(rule, real, sentences)
    merged = f" {same:.2%} of the other texts count as a text's own." if rule.same_above is not None else ""
    chosen_among = rule.pool or min(number, rule.least_similar or number)
    return Block(
        f"Retrieval, {rule.name}, N = {chosen_among}: {head}",
        tuple(map(title_of, names)),
        (
            Row(CHANCE, "reference", cells(chance), "an evaluator that sees nothing"),
            Row(ORACLE, "reference", cells(ceiling), "captions that stand in the set twice are its ceiling"),
            *(Row(str(each.row), each.origin, cells(each.retrieval[index])) for each in rows if each.retrieval),
        ),
        lower_is_better=False,
        note=(
            f"Shares, not per cent.{merged} Sentences are compared by {SENTENCES}; candidates at one distance share "
            "their ranks by expectation, where TMR's code takes their mean rank."
        ),
        metrics=tuple(measure(name, column=title_of(name)) for name in names),
    )


def _caption(config: EvalConfig, protocol: TextMotionProtocol, real: Mapping[_Sight, CaptionedMotions]) -> str:
    caption = (
        f"Whole motions and their captions, protocol {protocol.name!r} ({protocol.title}): mean over "
        f"{protocol.replications} replications ± half the 95 % interval over takes, {config.real}."
    )
    fewest = min(each.samples.num_sequences for each in real.values())
    if fewest < SMALL:
        caption += (
            f" A small-scale run: {fewest} real motions, so rows say how systems rank on this store and no more; FID "
            "has the bias of its N."
        )
    return caption


def _notes(protocol: TextMotionProtocol, real: Mapping[_Sight, CaptionedMotions]) -> tuple[str, ...]:
    notes = []
    for sight, each in real.items():
        without = "".join(f", {count} left out ({reason})" for reason, count in each.left_out.items())
        longest = protocol.lengths_at(sight[0]).longest_seconds
        cropped = f", {each.num_cropped} cropped to their middle {longest:g} s"
        notes.append(
            f"Real motions at {_label(sight)}: {each.samples.num_sequences} with "
            f"{len(set(each.samples.captions))} different captions{cropped if each.num_cropped else ''}{without}."
        )
    chance = ", ".join(f"{rank / protocol.pool:.3f}" for rank in (1, 2, 3))
    return (
        *notes,
        f"Pools of {protocol.pool}: chance is {chance}.",
        "Embeddings, and with them every number but the paper's, compare only under one evaluator's fingerprint.",
    )
