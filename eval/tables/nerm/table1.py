"""NeRM's Table 1: text-to-motion with whole motions at one framerate, under a protocol."""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from fractions import Fraction

import numpy as np
from threadpoolctl import threadpool_limits

from eval.metrics.distributions import fit_gaussian, frechet_distance
from eval.metrics.number import Number, Scores, over_replications
from eval.metrics.registry import find_metric
from eval.metrics.retrieval import RECALL_RANKS
from eval.native_evaluator.evaluator import load_evaluator
from eval.report.results import (
    DRAWING,
    Block,
    Cell,
    Origin,
    Row,
    cell_of,
    measure,
    score_differences,
    with_differences,
)
from eval.sample_folder import SampleFolder
from eval.sample_folder.folder import rows_by_name
from eval.sets.motions import VARIANT_NOTES, NoRealMotionError, refusal
from eval.sets.sets import REAL, RowId, SampleSet, check_sample_names, middle, size_remarks
from eval.tables.systems import Trained, TrainedModel, trained_models
from eval.tables.table import SOURCES, Content, EvalConfig, Table, printed_block, reported_figures
from eval.text_motion.embedder import FOLDER, Embedder, PoseVectorEvaluator, TextMotionEvaluator, fingerprint_of
from eval.text_motion.guo import load_guo
from eval.text_motion.motion_clip import load_motion_clip
from eval.text_motion.motions import (
    MADE_OF_22,
    CaptionedMotions,
    ModelMotions,
    as_kit_joints,
    captioned_motions,
    kit_bone_lengths,
)
from eval.text_motion.protocol import RetrievalRule, TextMotionProtocol, find_text_motion_protocol
from eval.text_motion.scores import (
    PAIR_SCORES,
    SUFFIXES,
    PairTerms,
    TextMotionPairs,
    no_distance,
    score_retrieval,
    score_text_motion,
    share_of_same_texts,
)
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.motion import Caption
from motionkit.core.progress import task
from motionkit.core.shapes import Float32, Float64, Int64
from motionkit.generate.models import GenerationRequest, installed_models
from motionkit.store.reader import Store
from motionkit.training.text import load_text_encoder

DEFAULT_FPS = Fraction(20)
FIXED_SUFFIX, FIXED_ROW = "-fixed", ", fixed framerate"
"""Suffixes of a run whose models were trained at a single framerate, and of their rows."""
SMALL = 1000
"""With fewer motions the caption calls the table small-scale."""
SENTENCES = "minilm"
EVALUATORS = ("native", "guo", "motion-clip", "tmr")
CHANCE, ORACLE, FLOOR = "chance", "each motion on its caption's point", "real, disjoint halves"
NOTES = {
    ORACLE: "the ceiling of R-Precision: motions that share a caption are indistinguishable",
    FLOOR: "FID between random halves of the real motions; ± is of a single split",
}
AS_VECTORS = "read as the pose vectors that they came as"
BY_JOINTS = "read as pose vectors made of joint positions"
COUNT = "N"


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
            lengths, kit_lengths = (rule.limited(longest) for rule in (protocol.lengths, protocol.kit_lengths))
            protocol = replace(protocol, lengths=lengths, kit_lengths=kit_lengths)
    every = [_OneEvaluator(config, protocol, evaluator, store) for evaluator in evaluators]
    blocks: list[Block] = []
    for one in every:
        # A single evaluator's error is the table's.
        with config.missing.skipping(f"evaluator {one.evaluator.name!r}", (MotionkitError,) if len(every) > 1 else ()):
            blocks += one.blocks(models)
    fewest = min(len(each.real.captions) for each in every)
    small = "" if fewest >= SMALL else f" A small-scale run: {fewest} real motions, and FID has the bias of its N."
    return Content(
        caption=(
            f"Whole motions and their captions, protocol {protocol.name!r} ({protocol.title}): mean over "
            f"{protocol.replications} replications ± half the 95 % interval over takes, {config.real}.{small}"
        ),
        blocks=(*blocks, *map(paper_block, dict.fromkeys(each.real.samples.fps for each in every))),
        definition={
            "protocol": asdict(protocol),
            "real_motions": {
                each.evaluator.name: {
                    "fps": str(each.real.samples.fps),
                    "layout": each.evaluator.layout,
                    "motions": each.real.samples.num_sequences,
                    "different_captions": len(set(each.real.samples.captions)),
                    "cropped": each.real.num_cropped,
                    "left_out": dict(each.real.left_out),
                }
                for each in every
            },
        },
        provenance={"runs": {each.run.name: each.identity for each in models.values()}},
    )


TABLE = Table(
    "nerm",
    "1",
    "text-to-motion at 20 fps",
    "text-motion/1",
    compute,
    heading="Table 1: text-to-motion",
    shown=installed_models,
    reads=("evaluator",),
)


def text_motion_evaluators(config: EvalConfig) -> list[TextMotionEvaluator]:
    """The requested evaluators, by default `native`.

    Raises `UsageError` for a name that is not a text-motion evaluator, and if no evaluator is available.
    """
    names, found = config.evaluators or ("native",), []
    for name in names:
        if name not in EVALUATORS:
            raise UsageError(f"--evaluator {name}: not an evaluator of text and motion; give {', '.join(EVALUATORS)}")
    for name in names:
        with config.missing.skipping(f"evaluator {name!r}"):
            found.append(_evaluator(name, config))
    if not found:
        raise UsageError("; ".join(config.missing.lines))
    return found


def _evaluator(name: str, config: EvalConfig) -> TextMotionEvaluator:
    if name == "guo":
        if config.guo is None or config.guo.glove is None:
            raise UsageError("--evaluator guo needs --weights finest.tar and --glove DIR (docs/evaluators.md)")
        return load_guo(config.guo)
    if name == "motion-clip":
        if config.motion_clip is None:
            raise UsageError("--evaluator motion-clip needs its folder: --motion-clip DIR (docs/evaluators.md)")
        return load_motion_clip(config.motion_clip)
    stage = "evaluator" if name == "native" else name
    if config.run is None:
        raise MotionkitError(f"it belongs to a run, and none was given (motionkit train --stage {stage})")
    return load_evaluator(config.run, stage)


def _models(config: EvalConfig) -> dict[str, TrainedModel]:
    """The run's models that know texts and, if trained, those of a single framerate from the run `RUN-fixed`."""
    found = trained_models(config.run, config.missing)
    if config.run is not None:
        run = config.run.with_name(config.run.name + FIXED_SUFFIX)
        for loader in installed_models().values():
            if not loader.fixed_fps_setting:
                continue
            with config.missing.skipping(loader.title + FIXED_SUFFIX):
                if not run.is_dir():
                    setting = f"--set {loader.fixed_fps_setting}={float(DEFAULT_FPS):g}"
                    command = f"motionkit train --run {run.name} {setting}"
                    raise MotionkitError(f"there is no run {run.name!r} ({command} makes it)")
                model = Trained(loader, run)
                found[model.loaded.name + FIXED_ROW] = model
    for name in list(found):
        # A model without texts has no row, nor do its longest motions limit others'.
        if refused := refusal(found[name].loaded, GenerationRequest(None, "a person walks")):
            config.missing.add(f"{name}: {refused}")
            del found[name]
    return found


class _OneEvaluator:
    """One evaluator's rows and blocks."""

    def __init__(
        self, config: EvalConfig, protocol: TextMotionProtocol, evaluator: TextMotionEvaluator, store: Store
    ) -> None:
        rates = config.fps or (evaluator.fps or DEFAULT_FPS,)
        if len(rates) != 1 or evaluator.fps not in (None, rates[0]):
            only = "" if evaluator.fps is None else f", for {evaluator.name!r} {float(evaluator.fps):g}"
            raise UsageError(f"table 1 compares whole motions at one framerate: give one --fps{only}")
        rule = protocol.lengths_at(rates[0])
        real = captioned_motions(store, config.split, config.where, rates[0], rule, evaluator.layout)
        if min(real.samples.num_sequences, config.max_motions) < protocol.pool:
            raise NoRealMotionError(
                f"{real.samples.name}: {real.samples.num_sequences} captioned motions, --motions {config.max_motions}, "
                f"but a text chooses among {protocol.pool} (protocol {protocol.name!r}); name a larger split (--split "
                "all), ingest more, or give more --motions"
            )
        self.config, self.protocol, self.evaluator, self.real = config, protocol, evaluator, real
        self.embedder = Embedder(evaluator, config.results / FOLDER)
        with task(config.on_progress, f"{evaluator.name}: embedding real motion"):
            texts, motions = self.embedder.texts(real.captions), self.embedder.motions(real.samples)
            self.pairs = TextMotionPairs(texts, motions, real.samples.sequence_ids)
        # The real motions to generate for: all, or a random subset of the requested size.
        number = real.samples.num_sequences
        most = min(config.max_motions, protocol.num_motions or number)
        self.chosen = np.arange(number)
        if most < number:
            self.chosen = np.sort(np.random.default_rng((config.seed, 7)).choice(number, size=most, replace=False))
        # Embeddings of the real motions' captions by an encoder independent of the evaluators, for retrieval.
        self.sentences: Float32[np.ndarray, "pairs numbers"] | None = None
        if protocol.retrieval:
            self.sentences = load_text_encoder(SENTENCES).encode([caption.text for caption in real.captions])

    def blocks(self, models: Mapping[str, TrainedModel]) -> list[Block]:
        """All scores, retrieval, and differences of rows."""
        config, fps, evaluator = self.config, self.real.samples.fps, self.evaluator
        rows = [self._real_row()]
        for name, model in models.items():
            with config.missing.skipping(f"{name}, {evaluator.name}", (MotionkitError, ValueError)):
                rows += self._model_rows(name, model)
        for folder in config.sample_folders:
            with config.missing.skipping(f"{folder.name}, {evaluator.name}", (MotionkitError, ValueError)):
                rows.append(self._sample_row(folder))
        head = f"{evaluator.name} evaluator, protocol {self.protocol.name}, {float(fps):g} fps"
        main, other_way, *differences = scored_blocks(rows, self.pairs, self.protocol, config.seed, head)
        found = [replace(main, note=" ".join(filter(None, (main.note, evaluator.remark_at(fps))))), other_way]
        if self.sentences is not None:
            own, sentences = self.pairs.select(self.chosen), self.sentences[self.chosen]
            found += [
                retrieval_block(rule, index, rows, own, sentences, config.seed, head)
                for index, rule in enumerate(self.protocol.retrieval)
            ]
        provenance = {
            "evaluator": evaluator.name,
            "fingerprint": evaluator.fingerprint,
            "protocol": self.protocol.name,
        }
        return [*(replace(block, provenance=provenance) for block in found), *differences]

    def _real_row(self) -> ScoredRow:
        """Real motion under the protocol; without FID if that would be a set's distance from itself."""
        own, reference = self.pairs.select(self.chosen), self.protocol.reference
        note = "its FID is what dropped remainders and the choice of motions leave" if reference == "redraw" else ""
        row = self._scored(REAL, note, own if reference == "paired" else self.pairs, [own], self.chosen)
        for name in ("fid", "fid_infinity", "kid") if reference != "redraw" else ():
            row.scores.replications.pop(name, None)
        return row

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
            made = (trained.note, "" if lengths is None else MADE_OF_22, VARIANT_NOTES.get(row.variant))
            note = "; ".join((f"run {trained.run.name!r}", *filter(None, made)))
            own = [draw[row] for draw in draws]
            rows.append(self._scored(row, note, reference, own, self.chosen, repeated.get(row)))
        return rows

    def _sample_row(self, folder: SampleFolder) -> ScoredRow:
        found = sample_embeddings(folder, self.real, self.protocol, self.embedder)
        reference = self.pairs if found.real_rows is None else self.pairs.select(found.real_rows)
        note = "; ".join((folder.describe(), *found.remarks))
        return self._scored(RowId(folder.name), note, reference, list(found.draws), found.real_rows, found.repeated)

    def _scored(
        self,
        row: RowId,
        note: str,
        reference: TextMotionPairs,
        draws: list[TextMotionPairs],
        real_rows: Int64[np.ndarray, "pairs"] | None,
        repeated: Float64[np.ndarray, "texts generations features"] | None = None,
    ) -> ScoredRow:
        """A row's scores, and its retrieval for the captions of these real motions (None: of all)."""
        remarks = []
        if row != REAL:
            remarks = size_remarks(self.pairs.motions, reference.motions, draws[0].motions, self.config.seed)
        ranked: tuple[Mapping[str, Number], ...] = ()
        if self.sentences is not None:
            sentences = self.sentences if real_rows is None else self.sentences[real_rows]
            ranked = tuple(
                score_retrieval(reference, draws, rule, sentences, self.config.seed) for rule in self.protocol.retrieval
            )
        with task(self.config.on_progress, "scoring", self.protocol.replications) as work:
            scores = score_text_motion(
                reference,
                draws,
                self.protocol,
                self.config.seed,
                repeated=repeated,
                pair_score=self.evaluator.pair_score,
                on_replication=work.advance,
            )
        origin: Origin = "reference" if row == REAL else "ours"
        return ScoredRow(row, origin, scores, "; ".join(filter(None, (note, *remarks))), ranked)


@dataclass(frozen=True, eq=False)
class SampleEmbeddings:
    """`draws` are the k-th motions of every prompt, `real_rows` their real motions if the protocol pairs them.

    `remarks` states how motions were converted for an evaluator of pose vectors, and which have no real motion.
    """

    draws: tuple[TextMotionPairs, ...]
    repeated: Float64[np.ndarray, "texts generations features"] | None
    real_rows: Int64[np.ndarray, "pairs"] | None
    remarks: tuple[str, ...] = ()


def sample_embeddings(
    folder: SampleFolder, real: CaptionedMotions, protocol: TextMotionProtocol, embedder: Embedder
) -> SampleEmbeddings:
    """Embed a folder's motions and captions; motions longer than allowed are cropped like the real ones.

    A caption that the real set has too keeps its tokens. If the protocol pairs motions with real ones, prompts
    without a real motion are dropped. Raises `SampleFolderError` for a missing caption, and `UsageError` if no sample
    matches a real motion by name or caption.
    """
    folder.require("caption")
    fps = real.samples.fps
    most_frames = protocol.lengths_at(fps).most_frames(fps)
    samples = folder.at(fps)
    cropped = [middle(sequence, most_frames) for sequence in samples.sequences]
    samples = samples.with_positions(samples.name, samples.fps, cropped)
    motions, path = _embedded(folder, samples, real.samples, most_frames, embedder)
    texts = embedder.texts([real.known_captions.get(text, Caption(text)) for text in samples.captions])
    groups = [np.array(rows) for rows in samples.rows_by_group().values()]
    most = max(map(len, groups))
    repeated = motions[np.stack([rows for rows in groups if len(rows) == most])] if most > 1 else None
    found = _real_rows(samples.select(np.array([rows[0] for rows in groups])), real)
    remarks, paired = [path] if path else [], None
    if protocol.reference == "paired":
        paired = np.array([row for row in found if row is not None], dtype=np.int64)
        if not len(paired):
            raise UsageError(
                f"protocol {protocol.name!r} compares with the real motions of the same texts; name the files after "
                "the real sequences, or give them the captions of real sequences of this split"
            )
        if without := len(groups) - len(paired):
            remarks.append(
                f"{without:,} of {len(groups):,} have no real motion of their text that takes part: left out"
            )
        groups = [rows for rows, row in zip(groups, found, strict=True) if row is not None]
        found = [row for row in found if row is not None]
    ids = real.samples.sequence_ids
    takes = tuple(f"prompt {number}" if row is None else ids[row] for number, row in enumerate(found))
    fewest = min(map(len, groups))
    draws = [np.array([rows[number] for rows in groups]) for number in range(fewest)]
    pairs = tuple(TextMotionPairs(texts[rows], motions[rows], takes) for rows in draws)
    return SampleEmbeddings(pairs, repeated, paired, tuple(remarks))


def _embedded(
    folder: SampleFolder, samples: SampleSet, real: SampleSet, most_frames: int, embedder: Embedder
) -> tuple[Float64[np.ndarray, "motions features"], str]:
    """Embeddings of a folder's motions: from its pose vectors if the evaluator reads them, else from joints."""
    evaluator = embedder.evaluator
    if not isinstance(evaluator, PoseVectorEvaluator):
        return embedder.motions(samples), ""
    if not folder.vectors:
        reason = "not all came as vectors of one size"
    elif (size := folder.vectors[0].shape[1]) != evaluator.vector_size:
        reason = f"vectors of {size} numbers, it reads {evaluator.vector_size}"
    elif set(folder.fps) != {evaluator.fps}:
        reason = f"vectors of another framerate than {evaluator.fps} fps"
    else:
        # T poses make T − 1 vectors, so the longest motion has one vector fewer than poses.
        lengths = folder.sequences.num_frames.tolist()
        vectors = [
            middle(motion[:frames], most_frames - 1) for motion, frames in zip(folder.vectors, lengths, strict=True)
        ]
        key = {"vectors": fingerprint_of(vectors)}
        return embedder.kept(key, len(vectors), lambda: evaluator.embed_vectors(vectors)), AS_VECTORS
    kit_lengths = kit_bone_lengths(real)
    if kit_lengths is None:
        return embedder.motions(samples), f"{BY_JOINTS} ({reason})"
    if folder.kit_joints and set(folder.fps) == {samples.fps}:
        joints = [middle(motion, most_frames) for motion in folder.kit_joints]
        own = samples.with_positions(samples.name, samples.fps, joints)
        return embedder.motions(own), f"{BY_JOINTS} of KIT-ML's joints as they came ({reason})"
    return embedder.motions(as_kit_joints(samples, kit_lengths)), f"{BY_JOINTS}, {MADE_OF_22} ({reason})"


def _real_rows(samples: SampleSet, real: CaptionedMotions) -> list[int | None]:
    """The real motion of each sample, each used once, or None: by names if most match, else by captions."""
    named = rows_by_name(samples.sequence_ids, real.samples.sequence_ids)
    fitting = [row for row in named if row is not None]
    if 2 * len(fitting) > len(named) and len(set(fitting)) == len(fitting):
        return named
    by_caption: dict[str, list[int]] = defaultdict(list)
    for row in reversed(range(real.samples.num_sequences)):
        by_caption[real.samples.captions[row]].append(row)
    return [by_caption[text].pop() if by_caption[text] else None for text in samples.captions]


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
) -> list[Block]:
    """All metrics with the protocol's direction of R-Precision, the other direction, and differences of rows."""
    texts_ask = [f"r_precision_top{rank}" for rank in (1, 2, 3)]
    motions_ask = [f"{name}_motion_asks" for name in texts_ask]
    asked, turned = (texts_ask, motions_ask) if protocol.asks == "text" else (motions_ask, texts_ask)
    paired = [name for name in PAIR_SCORES if name in rows[0].scores.values]
    every = [*asked, "mm_dist", *paired, "fid", "diversity", protocol.multimodality.metric]
    shared = [remark for remark in rows[0].scores.remarks if all(remark in row.scores.remarks for row in rows)]
    oracle = _oracle(real, protocol, seed)
    floor = {title_of("fid"): cell_of(_halves(real, protocol, seed)), COUNT: Cell(len(real.motions) // 2)}
    remarks = (f"{COUNT}: motions of a row; FIDs of different {COUNT} do not compare", *shared)

    def block(title: str, names: list[str], found: Sequence[Row], note: str) -> Block:
        shown = {title_of(name): oracle[name] for name in names if name in oracle}
        ceiling = Row(ORACLE, "reference", shown, NOTES[ORACLE])
        measures = tuple(measure(name, column=title_of(name)) for name in names)
        columns = (*map(title_of, names), COUNT)
        return Block(f"{title}: {head}", columns, (ceiling, *found), False, note, metrics=measures)

    main = block(
        "Table 1",
        every,
        (Row(FLOOR, "reference", floor, NOTES[FLOOR]), *(_row(row, every, shared) for row in rows)),
        ". ".join(remark[0].upper() + remark[1:].rstrip(".") for remark in remarks) + ".",
    )
    other_way = block(
        "R-Precision the other way round",
        turned,
        [replace(_row(row, turned), note="") for row in rows],
        "The reference code asks with a text for its motion; the NeRM paper's words, with a motion for its text.",
    )
    own = {each.row: each.scores.values for each in rows if each.origin == "ours"}
    differences = score_differences(own, {name: title_of(name) for name in every})
    main, *tests = with_differences(main, differences)
    return [main, other_way, *tests]


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
        note=f"Theirs, by another evaluator on other motions (docs/tables.md). Source: {SOURCES['nerm']}.",
    )


def _row(row: ScoredRow, names: Sequence[str], leaving_out: Sequence[str] = ()) -> Row:
    values, sizes = row.scores.values, row.scores.sizes
    cells = {title_of(name): _score_cell(values[name]) for name in names if name in values}
    if fid := cells.get(title_of("fid")):
        further = {find_metric(name).title: values[name].value for name in ("fid_infinity", "kid") if name in values}
        cells[title_of("fid")] = replace(fid, details={**fid.details, **further})
    cells[COUNT] = Cell(sizes["generated"])
    counted = f"N = {sizes['generated']:,} against {sizes['real']:,} real motions"
    if "multimodality texts" in sizes:
        counted += f", {sizes['multimodality generations']} motions of {sizes['multimodality texts']} texts"
    remarks = [remark for remark in row.scores.remarks if remark not in leaving_out]
    return Row(str(row.row), row.origin, cells, "; ".join(filter(None, (row.note, counted, *remarks))))


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
        terms.add(0, order, protocol.pool, scores)
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

    def row(name: str, origin: Origin, values: Mapping[str, Number], note: str = "") -> Row:
        return Row(name, origin, {title_of(metric): Cell(values[metric].value) for metric in names}, note)

    number, oracle = len(real.motions), TextMotionPairs(real.texts, real.texts)
    chance = score_retrieval(real, [real], rule, sentences, seed, no_distance)
    ceiling = score_retrieval(oracle, [oracle], rule, sentences, seed)
    note = f"Shares, not per cent; sentences are compared by {SENTENCES}."
    if rule.same_above is not None:
        note += f" {share_of_same_texts(rule, real, sentences):.2%} of the other texts count as a text's own."
    return Block(
        f"Retrieval, {rule.name}, N = {rule.pool or min(number, rule.least_similar or number)}: {head}",
        tuple(map(title_of, names)),
        (
            row(CHANCE, "reference", chance, "an evaluator that sees nothing"),
            row(ORACLE, "reference", ceiling, "captions that stand in the set twice are its ceiling"),
            *(row(str(each.row), each.origin, each.retrieval[index]) for each in rows if each.retrieval),
        ),
        lower_is_better=False,
        note=note,
        metrics=tuple(measure(name, column=title_of(name)) for name in names),
    )
