"""NeRM's Table 1: text-to-motion with whole motions at one framerate, under a protocol."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from fractions import Fraction

import numpy as np
from threadpoolctl import threadpool_limits

from eval.metrics.distributions import fit_gaussian, frechet_distance
from eval.metrics.intervals import Number, Scores, over_replications
from eval.metrics.registry import find_metric
from eval.metrics.retrieval import RECALL_RANKS
from eval.native_evaluator.evaluator import load_evaluator
from eval.report.results import Block, Cell, Row, cell_of, measure, score_differences, with_differences
from eval.sets.motions import VARIANT_NOTES, NoRealMotionError, refusal
from eval.sets.sets import REAL, RowId, check_sample_names, size_remark
from eval.tables.systems import Trained, trained_models
from eval.tables.table import SOURCES, Content, EvalConfig, Table, printed_block, reported_figures
from eval.text_motion.guo import load_guo, load_motion_clip
from eval.text_motion.motions import (
    FROM_22_JOINTS,
    Embedded,
    ModelMotions,
    TextMotionEvaluator,
    captioned_motions,
    embed_captions,
    kit_bone_lengths,
    sample_embeddings,
)
from eval.text_motion.protocol import KIT_FPS, RetrievalRule, TextMotionProtocol, find_text_motion_protocol
from eval.text_motion.scores import (
    SUFFIXES,
    PairTerms,
    TextMotionPairs,
    score_retrieval,
    score_text_motion,
    share_of_same_texts,
)
from motionkit.core.errors import MotionkitError, UsageError, counted
from motionkit.core.progress import task
from motionkit.generate.models import GenerationRequest, GenerativeModel, installed_models
from motionkit.store.reader import Store
from motionkit.training.run import RunFolder
from motionkit.training.text import load_text_encoder

DEFAULT_FPS = Fraction(20)
FIXED_SUFFIX, FIXED_ROW = "-fixed", ", fixed framerate"
"""Suffixes of a run whose models were trained at a single framerate, and of their rows."""
SENTENCES = "minilm"
EVALUATOR_STAGES = {"native": "evaluator", "tmr": "tmr"}
CHANCE, ORACLE, FLOOR = "chance", "each motion on its caption's point", "real, disjoint halves"
COUNT = "N"
COUNT_NOTE = "N: motions of a row; FIDs of different N do not compare."
OTHER_WAY_NOTE = "The reference code asks with a text for its motion; the paper's words, with a motion for its text."


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
        longest = min((each.loaded.max_duration_seconds for each in models.values()), default=math.inf)
    lengths, kit_lengths = (rule.limited(longest) for rule in (protocol.lengths, protocol.kit_lengths))
    protocol = replace(protocol, lengths=lengths, kit_lengths=kit_lengths)
    comparisons = [_Comparison(config, protocol, evaluator, store) for evaluator in evaluators]
    return Content(
        caption=(
            f"Whole motions and their captions, protocol {protocol.name!r} ({protocol.title}): mean over "
            f"{counted(protocol.replications, 'replication')} ± half the 95 % interval over takes, {config.real}."
        ),
        blocks=(
            *(block for each in comparisons for block in each.blocks(models)),
            *map(paper_block, dict.fromkeys(each.real.samples.fps for each in comparisons)),
        ),
        definition={
            "protocol": asdict(protocol),
            "real_motions": {
                each.evaluator.name: {
                    "fps": str(each.real.samples.fps),
                    "layout": each.evaluator.layout,
                    "motions": each.real.samples.num_sequences,
                    "cropped": each.real.num_cropped,
                    "left_out": dict(each.real.left_out),
                }
                for each in comparisons
            },
        },
        provenance={
            "runs": {each.run.name: RunFolder(each.run).fingerprints(each.loader.stages) for each in models.values()}
        },
    )


TABLE = Table(
    *("nerm", "1", "text-to-motion at 20 fps", "text-motion/1", compute),
    heading="Table 1: text-to-motion",
    shown=installed_models,
    reads=("evaluator",),
)


def text_motion_evaluators(config: EvalConfig) -> list[TextMotionEvaluator]:
    """The chosen evaluators that there are, by default `native`; raises `UsageError` if there is none."""
    evaluators = []
    for name in config.evaluators or ("native",):
        with config.missing.skipping(f"--evaluator {name}"):
            evaluators.append(_evaluator(name, config))
    if not evaluators:
        raise UsageError("; ".join(config.missing.lines))
    return evaluators


def _evaluator(name: str, config: EvalConfig) -> TextMotionEvaluator:
    if name == "guo":
        if config.guo is None or config.guo.glove is None:
            raise UsageError("it needs --weights finest.tar and --glove DIR (docs/evaluators.md)")
        return load_guo(config.guo)
    if name == "motion-clip":
        if config.motion_clip is None:
            raise UsageError("it needs its folder: --motion-clip DIR (docs/evaluators.md)")
        return load_motion_clip(config.motion_clip)
    if name not in EVALUATOR_STAGES:
        raise UsageError("not an evaluator of text and motion; give native, guo, motion-clip or tmr")
    stage = EVALUATOR_STAGES[name]
    if config.run is None:
        raise UsageError(f"it belongs to a run, and none was given (motionkit train --stage {stage})")
    return load_evaluator(config.run, stage)


def _models(config: EvalConfig) -> dict[str, Trained[GenerativeModel]]:
    """The run's models that know texts and, if trained, those of a single framerate from the run `RUN-fixed`."""
    models = trained_models(config.run, config.missing)
    for loader in installed_models().values():
        if config.run is None or not loader.fixed_fps_setting:
            continue
        run = config.run.with_name(config.run.name + FIXED_SUFFIX)
        with config.missing.skipping(loader.title + FIXED_SUFFIX):
            if not run.is_dir():
                setting = f"--set {loader.fixed_fps_setting}={float(DEFAULT_FPS):g}"
                raise MotionkitError(f"there is no run {run.name!r} (motionkit train --run {run.name} {setting})")
            model = Trained(loader, run)
            models[model.loaded.name + FIXED_ROW] = model
    for name in list(models):
        # A model without texts has no row, nor do its longest motions limit others'.
        if refused := refusal(models[name].loaded, GenerationRequest(None, "a person walks")):
            config.missing.add(f"{name}: {refused}")
            del models[name]
    return models


@dataclass(frozen=True)
class ScoredRow:
    """A row's scores, and its retrieval by each of the protocol's rules."""

    row: RowId
    note: str
    scores: Scores
    retrieval: tuple[Mapping[str, Number], ...]

    def with_cells(self, cells: Mapping[str, Cell], note: str = "") -> Row:
        """The row of a block."""
        return Row(str(self.row), "reference" if self.row == REAL else "ours", cells, note)


class _Comparison:
    """Real motions as one evaluator embeds them, and the rows that are compared with them."""

    def __init__(
        self, config: EvalConfig, protocol: TextMotionProtocol, evaluator: TextMotionEvaluator, store: Store
    ) -> None:
        rates = config.fps or (evaluator.fps or DEFAULT_FPS,)
        if len(rates) != 1 or evaluator.fps not in (None, rates[0]):
            only = "" if evaluator.fps is None else f", for {evaluator.name!r} {float(evaluator.fps):g}"
            raise UsageError(f"table 1 compares whole motions at one framerate: give one --fps{only}")
        rule = protocol.lengths_at(rates[0])
        real = captioned_motions(store, config.split, config.where, rates[0], rule, evaluator.layout)
        number = real.samples.num_sequences
        if min(number, config.max_motions) < protocol.pool:
            raise NoRealMotionError(
                f"{real.samples.name}: {counted(number, 'captioned motion')}, --motions {config.max_motions}, "
                f"but a text chooses among {protocol.pool} (protocol {protocol.name!r}); name a larger split (--split "
                "all), ingest more, or give more --motions"
            )
        self.config, self.protocol, self.evaluator, self.real = config, protocol, evaluator, real
        self.head = f"{evaluator.name} evaluator, protocol {protocol.name}, {float(rates[0]):g} fps"
        self.provenance = {"evaluator": evaluator.name, "fingerprint": evaluator.fingerprint, "protocol": protocol.name}
        with task(config.on_progress, f"{evaluator.name}: embedding real motion"):
            texts, motions = embed_captions(evaluator, real.captions), evaluator.embed_motions(real.samples)
            self.pairs = TextMotionPairs(texts, motions, real.samples.sequence_ids)
        # The real motions to generate for: all, or a random subset of the requested size.
        most = min(config.max_motions, protocol.num_motions or number)
        self.chosen = np.arange(number)
        if most < number:
            self.chosen = np.sort(np.random.default_rng((config.seed, 7)).choice(number, size=most, replace=False))
        self.own = self.pairs.select(self.chosen)
        self.chosen_rows = self.chosen if protocol.reference == "paired" else None
        # Embeddings of the real motions' captions by an encoder independent of the evaluators, for retrieval.
        if protocol.retrieval:
            self.sentences = load_text_encoder(SENTENCES).encode([caption.text for caption in real.captions])

    def blocks(self, models: Mapping[str, Trained[GenerativeModel]]) -> list[Block]:
        """All metrics with the protocol's direction of R-Precision, the other direction, retrieval, differences."""
        config, protocol = self.config, self.protocol
        real = self._scored(REAL, Embedded([self.own], self.chosen_rows))
        if protocol.reference != "redraw":
            del real.scores.replications["fid"]  # a set's distance from itself
        rows = [real]
        for name, model in models.items():
            with config.missing.skipping(f"{name}, {self.evaluator.name}", (MotionkitError, ValueError)):
                rows += self._model_rows(name, model)
        for folder in config.sample_folders:
            with config.missing.skipping(f"{folder.name}, {self.evaluator.name}", (MotionkitError, ValueError)):
                embedded = sample_embeddings(folder, self.real, protocol, self.evaluator)
                rows.append(self._scored(RowId(folder.name), embedded))
        texts_ask = [f"r_precision_top{rank}" for rank in (1, 2, 3)]
        motions_ask = [f"{name}_motion_asks" for name in texts_ask]
        main_way, other_way = (texts_ask, motions_ask) if protocol.asks == "text" else (motions_ask, texts_ask)
        every = [*main_way, "mm_dist", *filter(None, [self.evaluator.pair_score])]
        every += ["fid", "diversity", protocol.multimodality.metric]
        oracle = self._oracle()

        def block(title: str, names: list[str], own_rows: Sequence[Row], note: str) -> Block:
            shown = {title_of(name): oracle[name] for name in names if name in oracle}
            ceiling = Row(ORACLE, "reference", shown, "the ceiling: motions that share a caption are indistinguishable")
            measures = tuple(measure(name, column=title_of(name)) for name in names)
            columns = (*map(title_of, names), COUNT)
            return Block(f"{title}: {self.head}", columns, (ceiling, *own_rows), False, note, self.provenance, measures)

        notes = (COUNT_NOTE, *protocol.remarks, self.evaluator.remark_at(self.real.samples.fps))
        shown = [self._floor(), *(row.with_cells(_cells(row.scores, every), row.note) for row in rows)]
        own = {each.row: each.scores.values for each in rows if each.row != REAL}
        main, *differences = with_differences(
            block("Table 1", every, shown, " ".join(filter(None, notes))),
            score_differences(own, {name: title_of(name) for name in every}),
        )
        shown = [row.with_cells(_cells(row.scores, other_way)) for row in rows]
        other = block("R-Precision the other way round", other_way, shown, OTHER_WAY_NOTE)
        retrieval = (self._retrieval(rule, index, rows) for index, rule in enumerate(protocol.retrieval))
        return [main, other, *retrieval, *differences]

    def _model_rows(self, name: str, trained: Trained[GenerativeModel]) -> list[ScoredRow]:
        """A model's rows, as generated and planted."""
        config, lengths, real = self.config, kit_bone_lengths(self.real.samples), self.real.select(self.chosen)
        with task(config.on_progress, f"{self.evaluator.name}: {name}", note="motions generated") as work:
            motions = ModelMotions(name, trained.loaded, self.evaluator, config.seed, lengths, work.advance)
            draws = [motions.draw(real, self.own.texts, number) for number in range(config.draws)]
            repeated = motions.repeated(real, self.protocol.multimodality, config.max_motions)
        rows = []
        for row in draws[0]:
            notes = (trained.note, "" if lengths is None else FROM_22_JOINTS, VARIANT_NOTES.get(row.variant))
            note = "; ".join((f"run {trained.run.name!r}", *filter(None, notes)))
            embedded = Embedded([draw[row] for draw in draws], self.chosen_rows, repeated.get(row), note)
            rows.append(self._scored(row, embedded))
        return rows

    def _scored(self, row: RowId, embedded: Embedded) -> ScoredRow:
        config, notes = self.config, [embedded.note]
        reference = self.pairs if embedded.real_rows is None else self.pairs.select(embedded.real_rows)
        if row != REAL:
            notes.append(size_remark(reference.motions, embedded.draws[0].motions, config.seed))
        ranked = tuple(
            score_retrieval(reference, embedded.draws, rule, self.sentences[embedded.real_rows], config.seed)
            for rule in self.protocol.retrieval
        )
        with task(config.on_progress, "scoring"):
            scores = score_text_motion(
                reference,
                embedded.draws,
                self.protocol,
                config.seed,
                repeated=embedded.repeated,
                pair_score=self.evaluator.pair_score,
            )
        sizes = scores.sizes
        notes.append(f"N = {sizes['generated']:,} against {counted(sizes['real'], 'real motion')}")
        if "multimodality texts" in sizes:
            texts = counted(sizes["multimodality texts"], "text")
            notes.append(f"{counted(sizes['multimodality generations'], 'motion')} of {texts}")
        notes += [line for line in scores.remarks if line not in self.protocol.remarks]
        return ScoredRow(row, "; ".join(filter(None, notes)), scores, ranked)

    def _oracle(self) -> dict[str, Cell]:
        """R-Precision of an oracle that embeds motions as their texts."""
        scores, own = Scores(), TextMotionPairs(self.pairs.texts, self.pairs.texts, self.pairs.takes)
        terms = PairTerms([own])
        for replication in range(self.protocol.replications):
            order = np.random.default_rng((self.config.seed, replication, 5)).permutation(len(own.texts))
            terms.add(0, order, self.protocol.pool, scores)
        scores.resampled |= terms.resampled_means()
        return {name: cell_of(score) for name, score in scores.values.items()}

    def _floor(self) -> Row:
        """FID between random halves of the real motions."""
        motions, values = self.pairs.motions, []
        with threadpool_limits(1, "blas"):
            for replication in range(self.protocol.replications):
                order = np.random.default_rng((self.config.seed, replication, 6)).permutation(len(motions))
                first, second = order[: len(order) // 2], order[len(order) // 2 :]
                values.append(frechet_distance(fit_gaussian(motions[first]), fit_gaussian(motions[second])))
        floor = over_replications(values)
        cells = {
            title_of("fid"): Cell(floor.value, floor.ci95 * math.sqrt(len(values)) or None),
            COUNT: Cell(len(motions) // 2),
        }
        return Row(FLOOR, "reference", cells, "FID between random halves of the real motions; ± is of a single split")

    def _retrieval(self, rule: RetrievalRule, index: int, rows: Sequence[ScoredRow]) -> Block:
        """Recalls and median ranks of every row, between those of chance and of texts that stand for their motions."""
        real, sentences, seed = self.own, self.sentences[self.chosen], self.config.seed
        names = [
            f"{name}{SUFFIXES[direction]}"
            for direction in rule.directions
            for name in (*(f"recall_at_{rank}" for rank in RECALL_RANKS), "median_rank")
        ]

        def cells(values: Mapping[str, Number]) -> dict[str, Cell]:
            return {title_of(name): Cell(values[name].value) for name in names}

        number, oracle = len(real.motions), TextMotionPairs(real.texts, real.texts, real.takes)
        chance = cells(score_retrieval(real, [real], rule, sentences, seed, lambda a, b: np.zeros((len(a), len(b)))))
        ceiling = cells(score_retrieval(oracle, [oracle], rule, sentences, seed))
        note = f"Shares, not per cent; sentences are compared by {SENTENCES}."
        if rule.same_above is not None:
            note += f" {share_of_same_texts(rule, real, sentences):.2%} of the other texts count as a text's own."
        return Block(
            f"Retrieval, {rule.name}, N = {rule.pool or min(number, rule.least_similar or number)}: {self.head}",
            tuple(map(title_of, names)),
            (
                Row(CHANCE, "reference", chance, "an evaluator that sees nothing"),
                Row(ORACLE, "reference", ceiling, "captions that stand in the set twice are its ceiling"),
                *(each.with_cells(cells(each.retrieval[index])) for each in rows),
            ),
            lower_is_better=False,
            note=note,
            provenance=self.provenance,
            metrics=tuple(measure(name, column=title_of(name)) for name in names),
        )


def title_of(name: str) -> str:
    """A metric as a column's name, with the direction of better values: ↑, ↓, or → for as close to real as can be."""
    metric = find_metric(name)
    arrow = "→" if metric.higher_is_better is None else "↑" if metric.higher_is_better else "↓"
    return f"{metric.title} {arrow}"


def _cells(scores: Scores, names: Sequence[str]) -> dict[str, Cell]:
    """A row's cells of these metrics, with FID∞ and KID as details of its FID, and its number of motions."""
    values = scores.values
    cells = {title_of(name): cell_of(values[name]) for name in names if name in values}
    if fid := cells.get(title_of("fid")):
        further = {find_metric(name).title: values[name].value for name in ("fid_infinity", "kid") if name in values}
        cells[title_of("fid")] = replace(fid, details={**fid.details, **further})
    return {**cells, COUNT: Cell(scores.sizes["generated"])}


def paper_block(fps: Fraction) -> Block:
    """The paper's figures for the data set of this framerate."""
    dataset = "KIT" if fps == KIT_FPS else "HumanML3D"
    return printed_block(
        f"Printed in the NeRM paper ({dataset})",
        [figure for figure in reported_figures("nerm", "1") if figure.dataset == dataset],
        lambda figure: title_of(figure.metric),
        lower_is_better=False,
        note=f"Theirs, by another evaluator on other motions (docs/tables.md). Source: {SOURCES['nerm']}.",
    )
