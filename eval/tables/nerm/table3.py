"""NeRM's Table 3: motions generated for actions, scored by an action recogniser."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from eval.actions.recogniser import ActionRecogniser
from eval.actions.recognisers import RecogniserSource, find_recogniser
from eval.actions.scores import ActionProtocol, LabelledRecognition, find_action_protocol, score_actions
from eval.actions.sets import ActionSet, NoActionsError, generated_like, known_actions, known_to_all, with_rotations
from eval.metrics.actions import accuracy
from eval.metrics.gaussian import kid
from eval.metrics.number import Number, Scores, half_width
from eval.report.differences import DRAWING, differences_block, of_interest, score_differences
from eval.report.results import Block, Cell, Origin, Result, Row, measure
from eval.sets.generated import is_unconditional
from eval.sets.partial import PartialResult, collect
from eval.sets.planted import VARIANT_NOTES
from eval.sets.real import RealMotion, has_training, real_motion
from eval.sets.remarks import size_remarks
from eval.sets.row_ids import REAL, RowId, check_sample_names
from eval.sets.sets import SampleSet
from eval.tables.models import trained_models, training_note
from eval.tables.parts import SOURCES, printed_rows, reported_figures
from eval.tables.registry import Table, TableRequest
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.progress import task, tracked
from motionkit.generate.models import installed_models

if TYPE_CHECKING:
    from motionkit.store.reader import Store

VERSION = "action-to-motion/1"
DEFAULT = "linear"
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
class _Real:
    """Real motions of the recogniser's actions: the reference, and those of the training split if there is one."""

    compared: ActionSet
    train: ActionSet | None


@dataclass(frozen=True, eq=False)
class _System:
    """One row: independent draws of its motions, and remarks."""

    row: RowId
    draws: tuple[LabelledRecognition, ...]
    note: str
    is_reference: bool = False


def build_table3(request: TableRequest) -> Result:
    """Accuracy, FID, Diversity and MultiModality of real motion, the run's and other systems' samples.

    Raises `UsageError` for an unknown recogniser or protocol or missing weights, `CheckpointError` for other weights,
    and `NoActionsError` if the store has no motion of the recogniser's actions.
    """
    source, protocols = _choices(request)
    store = request.open_store()
    with task(request.on_progress, "recogniser"):
        recogniser = _recogniser(source, store, request)
    with task(request.on_progress, "real motion"):
        found = _real(source, recogniser, store, request)
        real = found.value
        systems = [_real_system(real, recogniser, request)]
    with task(request.on_progress, "generating"):
        models, others = _models(real, recogniser, request), _folders(source, recogniser, request)
        systems += [*models.value, *others.value]
    references = _references(real, recogniser)
    scored = [_block(protocol, source, references, systems, request) for protocol in protocols]
    absent = (found.missing, models.missing, others.missing, *(each.missing for each in scored))
    blocks = [
        *chain.from_iterable(each.value for each in scored),
        _by_action(recogniser, systems),
        *_paper_blocks(source),
    ]
    return Result(
        task="nerm-table3",
        version=VERSION,
        title="Table 3: action-to-motion",
        caption=_caption(source, real, request),
        blocks=tuple(blocks),
        definition=_definition(source, recogniser, protocols, real, request),
        notes=_notes(source, real),
        missing=tuple(dict.fromkeys(chain(*absent))),
        provenance=request.provenance(
            store, run=request.evaluated.run.name if request.evaluated.run and models.value else None
        ),
    )


TABLE = Table(
    "nerm", "3", "action-to-motion", build_table3, shown=installed_models, settings=("conditions.kind=action",)
)


def _choices(request: TableRequest) -> tuple[RecogniserSource, list[ActionProtocol]]:
    names = request.evaluators.names or (DEFAULT,)
    if len(names) != 1:
        raise UsageError(f"--evaluator {','.join(names)}: table 3 has one recogniser of actions at a time")
    return find_recogniser(names[0]), [find_action_protocol(name) for name in request.published.name.split(",")]


def _recogniser(source: RecogniserSource, store: "Store", request: TableRequest) -> ActionRecogniser:
    def train() -> SampleSet:
        if not has_training(store):
            raise UsageError(
                f"{request.real.store} has no training split, and {source.name!r} is fitted on one: `motionkit split` "
                "makes it"
            )
        return _long_enough(real_motion(store, "train").at(source.fps))

    return source.make(train, request.evaluators.guo.weights if request.evaluators.guo else None)


def _long_enough(samples: SampleSet) -> SampleSet:
    from eval.actions.linear import MIN_FRAMES

    return samples.select(np.flatnonzero(samples.sequences.num_frames >= MIN_FRAMES))


def _real(
    source: RecogniserSource, recogniser: ActionRecogniser, store: "Store", request: TableRequest
) -> PartialResult[_Real]:
    def known(motion: RealMotion) -> ActionSet:
        found = known_actions(motion.at(source.fps), recogniser.actions)
        return replace(found, samples=with_rotations(store, found.samples)) if source.needs_rotations else found

    compared = known(real_motion(store, request.real.split, request.real.where))
    missing = tuple(f"real ({request.real.split}): {line}" for line in compared.left_out)
    if request.real.split in ("train", "all") or not has_training(store):
        return PartialResult(_Real(compared, None), missing)
    try:
        return PartialResult(_Real(compared, known(real_motion(store, "train"))), missing)
    except NoActionsError as error:
        return PartialResult(_Real(compared, None), (*missing, f"FID (train): {error}"))


def _real_system(real: _Real, recogniser: ActionRecogniser, request: TableRequest) -> _System:
    return _System(
        RowId(f"{REAL} ({request.real.split})"),
        (real.compared.recognised(recogniser),),
        _counted(real.compared.samples.num_sequences, 1)
        + ("" if real.train is None else "; its FID (train) is what other takes leave"),
        is_reference=True,
    )


def _counted(motions: int, draws: int) -> str:
    return f"{motions:,} motions" + (f", generated {draws} times" if draws > 1 else "")


def _models(real: _Real, recogniser: ActionRecogniser, request: TableRequest) -> PartialResult[list[_System]]:
    """Each model of the run, as it is and planted: `draws` motions per real one (of at most `max_motions`)."""
    models = trained_models(request.evaluated.run)
    check_sample_names(request.evaluated.samples, (f"{REAL} ({request.real.split})", *models.value))
    known = known_to_all(real.compared, {name: trained.loaded for name, trained in models.value.items()})
    asked = known.value.at_most(request.evaluated.max_motions, request.seed)
    count = request.evaluated.draws
    counted = f"{_counted(asked.samples.num_sequences, count)}, with the"

    def systems(name: str) -> list[_System]:
        trained = models.value[name]
        note = f"{counted} {'' if is_unconditional(trained.loaded) else 'actions and '}durations of real ones"
        draws = [
            generated_like(asked, trained.loaded, draw, request.seed)
            for draw in tracked(request.on_progress, name, range(count), count)
        ]
        return [
            _System(
                row,
                tuple(draw[row].recognised(recogniser) for draw in draws),
                "; ".join(filter(None, (note, training_note(trained), VARIANT_NOTES.get(row.variant)))),
            )
            for row in draws[0]
        ]

    found = collect(models.value, systems)
    made = list(chain.from_iterable(found.value.values()))
    return PartialResult(made, (*models.missing, *known.missing, *found.missing))


def _folders(
    source: RecogniserSource, recogniser: ActionRecogniser, request: TableRequest
) -> PartialResult[list[_System]]:
    systems, missing = [], []
    for folder in request.sample_folders:
        try:
            folder.require_actions()
            known = known_actions(folder.at(source.fps), recogniser.actions)
            recognised = known.recognised(recogniser)
        except MotionkitError as error:
            missing.append(f"{folder.name}: {error}")
            continue
        missing += [f"{folder.name}: {line}" for line in known.left_out]
        note = f"{_counted(known.samples.num_sequences, 1)}; {folder.describe()}"
        systems.append(_System(RowId(folder.name), (recognised,), note))
    return PartialResult(systems, tuple(missing))


def _references(real: _Real, recogniser: ActionRecogniser) -> dict[str, np.ndarray]:
    """Features of real motion by the names of `score_actions`: "test" is what is compared, "train" another set."""
    found = {"test": real.compared.recognised(recogniser).recognition.features}
    if real.train is not None:
        found["train"] = real.train.recognised(recogniser).recognition.features
    return found


def _block(
    protocol: ActionProtocol,
    source: RecogniserSource,
    references: dict[str, np.ndarray],
    systems: Sequence[_System],
    request: TableRequest,
) -> PartialResult[list[Block]]:
    """A protocol's scores, and which rows differ."""
    fids = {"fid_train": "FID (train)", "fid_test": f"FID ({request.real.split})"}
    rows, missing = [], []
    shown: dict[str, str] = {}
    own: dict[RowId, Mapping[str, Number]] = {}
    for system in systems:
        against = {
            name: features for name, features in references.items() if not (system.is_reference and name == "test")
        }
        first = system.draws[0].recognition.features
        try:
            scores = score_actions(against, system.draws, protocol, request.seed)
        except ValueError as error:
            missing.append(f"{system.row}, protocol {protocol.name!r}: {error}")
            continue
        origin: Origin = "reference" if system.is_reference else "ours"
        own |= {} if system.is_reference else {system.row: scores.values}
        shown |= {name: (fids | COLUMN_OF)[name] for name in scores.values}
        cells = _with_kid(_cells(scores, fids | COLUMN_OF), fids, against, system)
        remarks = [] if system.is_reference else size_remarks(against["test"], against["test"], first, request.seed)
        rows.append(Row(str(system.row), origin, cells, "; ".join((_note(system, scores, protocol), *remarks))))
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
    return PartialResult([block] if tests is None else [block, tests], tuple(missing))


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


def _cells(scores: Scores, columns: dict[str, str]) -> dict[str, Cell]:
    return {columns[metric]: _cell(number, scores.replications[metric]) for metric, number in scores.values.items()}


def _with_kid(
    cells: dict[str, Cell], fids: dict[str, str], against: dict[str, np.ndarray], system: _System
) -> dict[str, Cell]:
    """KID beside every FID, of the first draw, since it is unbiased for few motions."""
    for name, features in against.items():
        column = fids[f"fid_{name}"]
        found = kid(features, system.draws[0].recognition.features)
        cells[column] = replace(cells[column], details={**cells[column].details, "KID": found})
    return cells


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
        if source.dataset not in ("", dataset):
            continue
        of_dataset = [figure for figure in figures if figure.dataset == dataset]
        rows = printed_rows(of_dataset, lambda figure: PAPER_COLUMNS[figure.metric])
        used = {column for row in rows for column in row.cells}
        blocks.append(
            Block(
                f"Printed in the NeRM paper for {dataset} ({SOURCES['nerm']})",
                tuple(column for column in PAPER_COLUMNS.values() if column in used),
                rows,
                note=PAPER_NOTE,
            )
        )
    return blocks


def _caption(source: RecogniserSource, real: _Real, request: TableRequest) -> str:
    compared = real.compared
    actions = len(np.unique(compared.labels))
    caption = (
        f"What a recogniser of actions ({source.title}) says of {compared.samples.num_sequences:,} real motions of "
        f"{actions} actions, {request.real.named}, and of motions generated for the same "
        "actions: mean over the protocol's replications ± half the 95 % interval over motions."
    )
    if compared.samples.num_sequences < SMALL_MOTIONS:
        caption += " A small-scale run: rows say how systems rank on this store and no more."
    return caption


def _definition(
    source: RecogniserSource,
    recogniser: ActionRecogniser,
    protocols: Sequence[ActionProtocol],
    real: _Real,
    request: TableRequest,
) -> dict[str, Any]:
    return {
        "version": VERSION,
        "recogniser": {"name": source.name, "fingerprint": recogniser.fingerprint, "actions": list(recogniser.actions)},
        "fps": str(source.fps),
        "protocols": {protocol.name: protocol.version for protocol in protocols},
        "motions": {
            "compared": real.compared.samples.num_sequences,
            "train": None if real.train is None else real.train.samples.num_sequences,
        },
        "generated": "one motion for every real one, with its action and its duration (l_max where that is longer)",
        "split": request.real.split,
        "where": request.real.where,
    }


def _notes(source: RecogniserSource, real: _Real) -> tuple[str, ...]:
    counts = np.bincount(real.compared.labels)
    return (
        f"Always naming the commonest action has an accuracy of {counts.max() / counts.sum():.3f}.",
        f"All motions are seen at {source.fps} fps: slower real ones are left out, generated ones are asked for at it.",
        "FIDs of different numbers of motions do not compare; rows name theirs. Intervals resample motions, and "
        "generations where there are several (--draws).",
    )
