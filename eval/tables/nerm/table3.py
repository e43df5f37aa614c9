"""NeRM's Table 3: motions generated for actions, scored by an action recogniser."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from eval.actions.linear import MIN_FRAMES
from eval.actions.recogniser import ActionRecogniser
from eval.actions.recognisers import RecogniserSource, find_recogniser
from eval.actions.scores import ActionProtocol, LabelledRecognition, find_action_protocol, score_actions
from eval.actions.sets import ActionSet, NoActionsError, generated_like, known_actions, known_to_all, with_rotations
from eval.config import EvalConfig
from eval.metrics.actions import accuracy
from eval.metrics.distributions import kid
from eval.metrics.number import Number, Scores, half_width
from eval.report.results import DRAWING, Block, Cell, Row, differences_block, measure, of_interest, score_differences
from eval.sets.motions import VARIANT_NOTES, RealMotion, has_training, is_unconditional, real_motion
from eval.sets.sets import REAL, RowId, SampleSet, check_sample_names, size_remarks
from eval.tables.models import TrainedModel, trained_models, training_note
from eval.tables.table import SOURCES, Content, Table, printed_block, reported_figures
from motionkit.core.errors import UsageError
from motionkit.core.progress import task, tracked
from motionkit.generate.models import installed_models
from motionkit.store.reader import Store

VERSION = "action-to-motion/1"
ACCURACY, DIVERSITY, MULTIMODALITY = "Accuracy", "Diversity", "MultiModality"
COLUMN_OF = {
    "accuracy": ACCURACY,
    "diversity": DIVERSITY,
    "diversity_with_replacement": DIVERSITY,
    "multimodality_by_class": MULTIMODALITY,
    "multimodality_by_class_with_replacement": MULTIMODALITY,
}
VARIANCE = '1.96 · variance (ACTOR\'s "±")'
PAPER_COLUMNS = {
    "fid_train": "FID (train)",
    "fid_test": "FID (test)",
    "accuracy": ACCURACY,
    "diversity": DIVERSITY,
    "multimodality": MULTIMODALITY,
}
PAPER_NOTE = (
    "The paper words its protocol as 20 evaluations of 1,000 motions with 95 % intervals. What stands after ± in "
    "ACTOR's row is 1.96 · variance, which is no interval, and ACTOR counts whole sets: the table mixes both. These "
    "are other motions: nothing above compares with them."
)
BEST_WHERE_REAL = "Diversity and MultiModality are best where real motion has them."
SMALL_MOTIONS = 1000


@dataclass(frozen=True, eq=False)
class _System:
    """One row: independent draws of its motions, and remarks."""

    row: RowId
    draws: tuple[LabelledRecognition, ...]
    note: str
    is_reference: bool = False


def compute(config: EvalConfig, store: Store) -> Content:
    """Accuracy, FID, Diversity and MultiModality of real motion, the run's and other systems' samples.

    Raises `UsageError` for an unknown recogniser or protocol or missing weights, `CheckpointError` for other weights,
    and `NoActionsError` if the store has no motion of the recogniser's actions.
    """
    names = config.evaluators or ("linear",)
    if len(names) != 1:
        raise UsageError(f"--evaluator {','.join(names)}: table 3 has one recogniser of actions at a time")
    source = find_recogniser(names[0])
    protocols = [find_action_protocol(name) for name in config.protocol.split(",")]
    with task(config.on_progress, "recogniser"):
        weights = config.guo.weights if config.guo else None
        recogniser = source.make(lambda: _training_samples(source, store, config), weights)
    with task(config.on_progress, "real motion"):
        compared, train = _real(source, recogniser, store, config)
        references = {"test": compared.recognised(recogniser)}
        if train is not None:
            references["train"] = train.recognised(recogniser)
        note = _counted(compared.samples.num_sequences, 1)
        note += "" if train is None else "; its FID (train) is what other takes leave"
        systems = [_System(RowId(f"{REAL} ({config.split})"), (references["test"],), note, is_reference=True)]
    with task(config.on_progress, "generating"):
        systems += [*_generated(compared, recogniser, config), *_samples(source, recogniser, config)]
    features = {name: found.recognition.features for name, found in references.items()}
    counts = np.bincount(compared.labels)
    return Content(
        caption=_caption(source, compared, config),
        blocks=(
            *(block for protocol in protocols for block in _blocks(protocol, source, features, systems, config)),
            _by_action(recogniser, systems),
            *_paper_blocks(source),
        ),
        definition={
            "recogniser": {
                "name": source.name,
                "fingerprint": recogniser.fingerprint,
                "actions": list(recogniser.actions),
            },
            "fps": str(source.fps),
            "protocols": {protocol.name: protocol.version for protocol in protocols},
            "motions": {
                "compared": compared.samples.num_sequences,
                "train": None if train is None else train.samples.num_sequences,
            },
        },
        notes=(
            f"Always naming the commonest action has an accuracy of {counts.max() / counts.sum():.3f}.",
            f"All motions are seen at {source.fps} fps: slower real ones are left out, generated ones are asked for at "
            "it.",
            "FIDs of different numbers of motions do not compare; rows name theirs. Intervals resample motions, and "
            "generations where there are several (--draws).",
        ),
    )


TABLE = Table(
    "nerm",
    "3",
    "action-to-motion",
    VERSION,
    compute,
    shown=installed_models,
    settings=("conditions.kind=action",),
)


def _training_samples(source: RecogniserSource, store: Store, config: EvalConfig) -> SampleSet:
    """The training motions that a recogniser is fitted on."""
    if not has_training(store):
        raise UsageError(
            f"{config.store} has no training split, and {source.name!r} is fitted on one: `motionkit split` makes it"
        )
    samples = real_motion(store, "train").at(source.fps)
    return samples.select(np.flatnonzero(samples.sequences.num_frames >= MIN_FRAMES))


def _real(
    source: RecogniserSource, recogniser: ActionRecogniser, store: Store, config: EvalConfig
) -> tuple[ActionSet, ActionSet | None]:
    """Real motions of the recogniser's actions: the reference, and those of the training split if it is another one."""

    def known(motion: RealMotion) -> ActionSet:
        found = known_actions(motion.at(source.fps), recogniser.actions)
        return replace(found, samples=with_rotations(store, found.samples)) if source.needs_rotations else found

    compared = known(real_motion(store, config.split, config.where))
    config.missing.add(*(f"real ({config.split}): {line}" for line in compared.left_out))
    train = None
    if config.split not in ("train", "all") and has_training(store):
        with config.missing.skipping("FID (train)", (NoActionsError,)):
            train = known(real_motion(store, "train"))
    return compared, train


def _counted(motions: int, draws: int) -> str:
    return f"{motions:,} motions" + (f", generated {draws} times" if draws > 1 else "")


def _generated(compared: ActionSet, recogniser: ActionRecogniser, config: EvalConfig) -> list[_System]:
    """Each model of the run, as it is and planted: `draws` motions per real one (of at most `max_motions`)."""
    models = trained_models(config.run, config.missing)
    check_sample_names(config.samples, (f"{REAL} ({config.split})", *models))
    known = known_to_all(compared, {name: trained.loaded for name, trained in models.items()}, config.missing)
    wanted, systems = known.at_most(config.max_motions, config.seed), []
    for name, trained in models.items():
        with config.missing.skipping(name):
            systems += _of_model(name, trained, wanted, recogniser, config)
    return systems


def _of_model(
    name: str, trained: TrainedModel, wanted: ActionSet, recogniser: ActionRecogniser, config: EvalConfig
) -> list[_System]:
    actions = "" if is_unconditional(trained.loaded) else "actions and "
    note = f"{_counted(wanted.samples.num_sequences, config.draws)}, with the {actions}durations of real ones"
    draws = [
        generated_like(wanted, trained.loaded, draw, config.seed)
        for draw in tracked(config.on_progress, name, range(config.draws), config.draws)
    ]
    return [
        _System(
            row,
            tuple(draw[row].recognised(recogniser) for draw in draws),
            "; ".join(filter(None, (note, training_note(trained), VARIANT_NOTES.get(row.variant)))),
        )
        for row in draws[0]
    ]


def _samples(source: RecogniserSource, recogniser: ActionRecogniser, config: EvalConfig) -> list[_System]:
    systems = []
    for folder in config.sample_folders:
        with config.missing.skipping(folder.name):
            folder.require("action")
            known = known_actions(folder.at(source.fps), recogniser.actions)
            note = f"{_counted(known.samples.num_sequences, 1)}; {folder.describe()}"
            systems.append(_System(RowId(folder.name), (known.recognised(recogniser),), note))
            config.missing.add(*(f"{folder.name}: {line}" for line in known.left_out))
    return systems


def _blocks(
    protocol: ActionProtocol,
    source: RecogniserSource,
    references: dict[str, np.ndarray],
    systems: Sequence[_System],
    config: EvalConfig,
) -> list[Block]:
    """A protocol's scores, and which rows differ."""
    fids = {"fid_train": "FID (train)", "fid_test": f"FID ({config.split})"}
    rows: list[Row] = []
    shown: dict[str, str] = {}
    own: dict[RowId, Mapping[str, Number]] = {}
    for system in systems:
        reference = {name: each for name, each in references.items() if not (system.is_reference and name == "test")}
        with config.missing.skipping(f"{system.row}, protocol {protocol.name!r}", (ValueError,)):
            scores = score_actions(reference, system.draws, protocol, config.seed)
            own |= {} if system.is_reference else {system.row: scores.values}
            shown |= {name: (fids | COLUMN_OF)[name] for name in scores.values}
            cells = {
                (fids | COLUMN_OF)[metric]: _cell(number, scores.replications[metric])
                for metric, number in scores.values.items()
            }
            first = system.draws[0].recognition.features
            for name, features in reference.items():
                # KID of the first draw beside every FID, since it is unbiased for few motions.
                cell = cells[fids[f"fid_{name}"]]
                cells[fids[f"fid_{name}"]] = replace(cell, details={**cell.details, "KID": kid(features, first)})
            remarks = (
                [] if system.is_reference else size_remarks(references["test"], references["test"], first, config.seed)
            )
            note = "; ".join((_note(system, scores, protocol), *remarks))
            rows.append(Row(str(system.row), "reference" if system.is_reference else "ours", cells, note))
    columns = (*fids.values(), ACCURACY, DIVERSITY, MULTIMODALITY)
    block = Block(
        f"Protocol {protocol.name!r}: {source.title}",
        tuple(column for column in columns if any(column in row.cells for row in rows)),
        tuple(rows),
        note=" ".join((source.note, BEST_WHERE_REAL, *protocol.remarks)),
        provenance={"protocol": asdict(protocol)},
        metrics=tuple(measure(name, column=column) for name, column in shown.items()),
    )
    tests = differences_block(block, of_interest(block, score_differences(own, shown)))
    return [block] if tests is None else [block, tests]


def _note(system: _System, scores: Scores, protocol: ActionProtocol) -> str:
    """The note below the table: the number of motions, and whether the protocol or FID needs more."""
    lines = [system.note]
    if not system.is_reference:
        lines += [line for line in scores.remarks if line not in protocol.remarks]
    motions, features = system.draws[0].recognition.features.shape
    if motions <= features:
        lines.append(
            f"no more motions than the recogniser's {features} features: FID says little, KID (below) has no bias"
        )
    return "; ".join(lines)


def _cell(number: Number, replications: Sequence[float]) -> Cell:
    """Mean and interval over motions; details are interval and variance over replications, if these differ."""
    over_takes = number.ci95 != number.drawing
    if np.ptp(replications) <= 1e-9 * abs(replications[0]):
        return Cell(number.value, half_width(number.resampled))
    details = {VARIANCE: 1.96 * float(np.var(replications))} | ({DRAWING: number.drawing} if over_takes else {})
    return Cell(number.value, number.ci95, details)


def _by_action(recogniser: ActionRecogniser, systems: Sequence[_System]) -> Block:
    """Accuracy per action, over all draws."""
    labels = systems[0].draws[0].labels
    rows = []
    for label, action in enumerate(recogniser.actions):
        cells = {str(system.row): _accuracy_of(system, label) for system in systems}
        found = {name: cell for name, cell in cells.items() if cell is not None}
        if found:
            rows.append(Row(f"{action} ({int((labels == label).sum())})", "ours", found))
    return Block(
        "Accuracy by action (real motions of it)",
        tuple(str(system.row) for system in systems),
        tuple(rows),
        lower_is_better=False,
    )


def _accuracy_of(system: _System, label: int) -> Cell | None:
    scores = np.concatenate([draw.recognition.scores[draw.labels == label] for draw in system.draws])
    return Cell(accuracy(scores, np.full(len(scores), label))) if len(scores) else None


def _paper_blocks(source: RecogniserSource) -> list[Block]:
    figures = reported_figures("nerm", "3")
    blocks = []
    for dataset in dict.fromkeys(figure.dataset for figure in figures):
        if source.dataset in ("", dataset):
            of_dataset = [figure for figure in figures if figure.dataset == dataset]
            used = {figure.metric for figure in of_dataset if figure.value is not None}
            blocks.append(
                printed_block(
                    f"Printed in the NeRM paper for {dataset} ({SOURCES['nerm']})",
                    of_dataset,
                    lambda figure: PAPER_COLUMNS[figure.metric],
                    columns=tuple(column for metric, column in PAPER_COLUMNS.items() if metric in used),
                    note=PAPER_NOTE,
                )
            )
    return blocks


def _caption(source: RecogniserSource, compared: ActionSet, config: EvalConfig) -> str:
    actions = len(np.unique(compared.labels))
    caption = (
        f"What a recogniser of actions ({source.title}) says of {compared.samples.num_sequences:,} real motions of "
        f"{actions} actions, {config.real}, and of motions generated for the same "
        "actions: mean over the protocol's replications ± half the 95 % interval over motions."
    )
    if compared.samples.num_sequences < SMALL_MOTIONS:
        caption += " A small-scale run: rows say how systems rank on this store and no more."
    return caption
