"""NeRM's Table 3: motions generated for actions, scored by an action recogniser."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from eval.actions.recogniser import MIN_FRAMES, ActionRecogniser, RecogniserSource, find_recogniser, fit_linear
from eval.actions.scores import ActionProtocol, Recognition, find_action_protocol, score_actions
from eval.actions.sets import ActionSet, NoActionsError, generated_like, known_actions, known_to_all, with_rotations
from eval.metrics.actions import accuracy
from eval.metrics.distributions import kid
from eval.metrics.intervals import Number
from eval.report.results import Block, Cell, Row, cell_of, measure, score_differences, with_differences
from eval.sets.motions import VARIANT_NOTES, RealMotion, has_training, real_motion
from eval.sets.sets import REAL, RowId, check_sample_names, size_remark
from eval.tables.systems import trained_models
from eval.tables.table import SOURCES, Content, EvalConfig, Table, printed_block, reported_figures
from motionkit.core.errors import UsageError, counted
from motionkit.core.progress import task, tracked
from motionkit.generate.models import installed_models
from motionkit.store.reader import Store

COLUMNS = {
    "fid_train": "FID (train)",
    "fid_test": "FID (test)",
    "accuracy": "Accuracy",
    "diversity": "Diversity",
    "diversity_with_replacement": "Diversity",
    "multimodality": "MultiModality",
    "multimodality_by_class": "MultiModality",
    "multimodality_by_class_with_replacement": "MultiModality",
}
VARIANCE = '1.96 · variance (ACTOR\'s "±")'


@dataclass(frozen=True, eq=False)
class System:
    """One row: independent draws of its motions, and remarks."""

    row: RowId
    draws: tuple[Recognition, ...]
    note: str


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
        recogniser = _recogniser(source, store, config)

    def real_actions(motion: RealMotion) -> ActionSet:
        known = known_actions(motion.at(source.fps), recogniser.actions)
        return replace(known, samples=with_rotations(store, known.samples)) if source.needs_rotations else known

    with task(config.on_progress, "real motion"):
        compared = real_actions(real_motion(store, config.split, config.where))
        config.missing.add(*(f"real ({config.split}): {line}" for line in compared.left_out))
        number, counts = compared.samples.num_sequences, np.bincount(compared.labels)
        row = RowId(f"{REAL} ({config.split})")
        real = System(row, (compared.recognised(recogniser),), counted(number, "motion"))
        references = {"test": real.draws[0].features}
        if config.split not in ("train", "all") and has_training(store):
            with config.missing.skipping("FID (train)", (NoActionsError,)):
                train = real_actions(real_motion(store, "train"))
                references["train"] = train.recognised(recogniser).features
    with task(config.on_progress, "generating"):
        systems = [real, *_generated(compared, recogniser, config), *_samples(source, recogniser, config)]
    return Content(
        caption=(
            f"What a recogniser of actions ({source.title}) says of {counted(number, 'real motion')} of "
            f"{counted(int(np.count_nonzero(counts)), 'action')}, {config.real}, and of motions generated for the same "
            f"actions at {source.fps} fps: mean over the protocol's replications ± half the 95 % interval over motions."
        ),
        blocks=(
            *(block for protocol in protocols for block in _blocks(protocol, source, references, systems, config)),
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
            "motions": {name: len(features) for name, features in references.items()},
        },
        notes=(
            f"Always naming the commonest action has an accuracy of {counts.max() / counts.sum():.3f}.",
            "FIDs of different numbers of motions do not compare; rows name theirs.",
        ),
    )


TABLE = Table(
    *("nerm", "3", "action-to-motion", "action-to-motion/1", compute),
    shown=installed_models,
    settings=("conditions.kind=action",),
)


def _recogniser(source: RecogniserSource, store: Store, config: EvalConfig) -> ActionRecogniser:
    """The recogniser, fitted on the training motions or read from the file of weights."""
    weights = config.guo.weights if config.guo else None
    if source.dataset:
        from eval.actions.published import load_humanact12, load_uestc  # deferred: torch

        if weights is None:
            raise UsageError(f"--evaluator {source.name} needs the file of its weights: --weights FILE")
        return (load_uestc if source.needs_rotations else load_humanact12)(weights)
    if weights is not None:
        raise UsageError("--weights needs a published recogniser: --evaluator humanact12 or uestc")
    if not has_training(store):
        raise UsageError(
            f"{config.store} has no training split, and {source.name!r} is fitted on one: `motionkit split` makes it"
        )
    samples = real_motion(store, "train").at(source.fps)
    return fit_linear(samples.select(np.flatnonzero(samples.sequences.num_frames >= MIN_FRAMES)))


def _generated(compared: ActionSet, recogniser: ActionRecogniser, config: EvalConfig) -> list[System]:
    """Each model of the run, as it is and planted: `draws` motions per real one (of at most `max_motions`)."""
    models = trained_models(config.run, config.missing)
    check_sample_names(config.samples, (f"{REAL} ({config.split})", *models))
    known = known_to_all(compared, {name: trained.loaded for name, trained in models.items()}, config.missing)
    real, systems = known.at_most(config.max_motions, config.seed), []
    times = f", generated {config.draws} times" if config.draws > 1 else ""
    for name, trained in models.items():
        with config.missing.skipping(name):
            draws = [
                generated_like(real, trained.loaded, draw, config.seed)
                for draw in tracked(config.on_progress, name, range(config.draws), config.draws)
            ]
            for row in draws[0]:
                size = counted(real.samples.num_sequences, "motion")
                notes = (f"{size}{times}", trained.note, VARIANT_NOTES.get(row.variant))
                recognised = tuple(draw[row].recognised(recogniser) for draw in draws)
                systems.append(System(row, recognised, "; ".join(filter(None, notes))))
    return systems


def _samples(source: RecogniserSource, recogniser: ActionRecogniser, config: EvalConfig) -> list[System]:
    systems = []
    for folder in config.sample_folders:
        with config.missing.skipping(folder.name):
            folder.require("action")
            known = known_actions(folder.at(source.fps), recogniser.actions)
            note = f"{counted(known.samples.num_sequences, 'motion')}; {folder.describe()}"
            systems.append(System(RowId(folder.name), (known.recognised(recogniser),), note))
            config.missing.add(*(f"{folder.name}: {line}" for line in known.left_out))
    return systems


def _blocks(
    protocol: ActionProtocol,
    source: RecogniserSource,
    references: Mapping[str, np.ndarray],
    systems: Sequence[System],
    config: EvalConfig,
) -> list[Block]:
    """A protocol's scores, and which rows differ; the first system is real motion."""
    columns = COLUMNS | {"fid_test": f"FID ({config.split})"}
    rows: list[Row] = []
    own: dict[RowId, Mapping[str, Number]] = {}
    metrics: dict[str, str] = {}
    for system in systems:
        is_real, first = system is systems[0], system.draws[0].features
        # Real motion has no distance from itself.
        reference = {name: features for name, features in references.items() if not (is_real and name == "test")}
        with config.missing.skipping(f"{system.row}, protocol {protocol.name!r}", (ValueError,)):
            scores = score_actions(reference, system.draws, protocol, config.seed)
            cells = {}
            for name, number in scores.values.items():
                values = scores.replications[name]
                differ = np.ptp(values) > 1e-9 * abs(number.value)
                spread = {VARIANCE: 1.96 * float(np.var(values))} if differ else {}
                metrics[name], cells[columns[name]] = columns[name], cell_of(number, spread)
            for name, features in reference.items():
                # KID of the first draw beside every FID, since it is unbiased for few motions.
                cell = cells[columns[f"fid_{name}"]]
                cells[columns[f"fid_{name}"]] = replace(cell, details={**cell.details, "KID": kid(features, first)})
            notes = [system.note]
            if not is_real:
                own[system.row] = scores.values
                notes += [line for line in scores.remarks if line not in protocol.remarks]
                notes.append(size_remark(references["test"], first, config.seed))
            if len(first) <= first.shape[1]:
                notes.append(f"no more motions than the recogniser's {first.shape[1]} features: read KID, not FID")
            rows.append(Row(str(system.row), "reference" if is_real else "ours", cells, "; ".join(filter(None, notes))))
    block = Block(
        f"Protocol {protocol.name!r}: {source.title}",
        tuple(column for column in dict.fromkeys(columns.values()) if any(column in row.cells for row in rows)),
        tuple(rows),
        note=" ".join(
            (source.note, "Diversity and MultiModality are best where real motion has them.", *protocol.remarks)
        ),
        provenance={"protocol": asdict(protocol)},
        metrics=tuple(measure(name, column=column) for name, column in metrics.items()),
    )
    return with_differences(block, score_differences(own, metrics))


def _by_action(recogniser: ActionRecogniser, systems: Sequence[System]) -> Block:
    """Accuracy per action, over all draws."""
    labels = systems[0].draws[0].labels
    rows = []
    for label, action in enumerate(recogniser.actions):
        cells = {}
        for system in systems:
            scores = np.concatenate([draw.scores[draw.labels == label] for draw in system.draws])
            if len(scores):
                cells[str(system.row)] = Cell(accuracy(scores, np.full(len(scores), label)))
        rows += [Row(f"{action} ({int((labels == label).sum())})", "ours", cells)] if cells else []
    columns = tuple(str(system.row) for system in systems)
    return Block("Accuracy by action (real motions of it)", columns, tuple(rows), lower_is_better=False)


def _paper_blocks(source: RecogniserSource) -> list[Block]:
    figures = [each for each in reported_figures("nerm", "3") if source.dataset in ("", each.dataset)]
    return [
        printed_block(
            f"Printed in the NeRM paper for {dataset} ({SOURCES['nerm']})",
            [figure for figure in figures if figure.dataset == dataset],
            lambda figure: COLUMNS[figure.metric],
            note="Of other motions, and of two protocols (docs/tables.md): nothing above compares with them.",
        )
        for dataset in dict.fromkeys(figure.dataset for figure in figures)
    ]
