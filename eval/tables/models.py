"""The installed models and encoders in a run: a table has a row for each."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from eval.config import EvalConfig
from eval.sets.motions import (
    Window,
    detailed_fields,
    generate_fields,
    is_framed,
    is_unconditional,
    planted_fields,
    windows_of,
)
from eval.sets.sets import Missing, RowId, SampleSet, Variant, check_sample_names
from motionkit.core.errors import DamagedFileError, MotionkitError, UsageError
from motionkit.core.files import sha256_of
from motionkit.core.progress import task, tracked
from motionkit.data.reconstruction import ReconstructsWindows
from motionkit.edit.encoders import installed_encoders
from motionkit.fields.motion_field import MotionEncoder, MotionField
from motionkit.generate.models import GenerativeModel, installed_models
from motionkit.training.detail import has_detail, load_detail
from motionkit.training.run import Loader, RunError, RunFolder

if TYPE_CHECKING:
    from motionkit.store.reader import Store

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Trained(Generic[T]):
    """A loader's object from a run, loaded on first use."""

    loader: Loader[T]
    run: Path

    @cached_property
    def loaded(self) -> T:
        """The model; raises what loading it raises."""
        return self.loader.load(self.run)

    @cached_property
    def identity(self) -> Mapping[str, str]:
        """Hexadecimal sha256 of each of its stages' results; raises `RunError` if one is not trained."""
        found = {}
        for name in self.loader.stages:
            stage = RunFolder(self.run).stage(name)
            if not stage.model_path.is_file():
                stage.read_summary()
            found[name] = sha256_of(stage.model_path if stage.model_path.is_file() else stage.summary_path)
        return found


# A generative model of a run.
TrainedModel = Trained[GenerativeModel]


def trained_models(run: Path | None, missing: Missing) -> dict[str, TrainedModel]:
    """The installed models in a run by their row names; those that it lacks are missing, with what trains them."""
    loaders = list(installed_models().values())
    if run is None or not run.is_dir():
        where = "no run was given" if run is None else f"there is no run {str(run)!r}"
        missing.add(*(f"{each.title}: {where} ({each.train_command(run)})" for each in loaders))
        return {}
    found: dict[str, TrainedModel] = {}
    for loader in loaders:
        if not loader.begun_in(run):
            missing.add(f"{loader.title}: run {run.name!r} has none ({loader.train_command(run)})")
            continue
        model = Trained(loader, run)
        try:
            name = model.loaded.name
        except DamagedFileError:
            raise
        except MotionkitError as error:
            missing.add(f"{loader.title}: {error}")
            continue
        if name in found:
            missing.add(f"{loader.title}: another model of the run is called {name!r} too")
        else:
            found[name] = model
    return found


def training_note(trained: Trained[Any]) -> str:
    """A note on a model's training from its stages' summaries: steps, parameters, processor time, framerate."""
    notes = []
    for name in trained.loader.stages:
        effort = RunFolder(trained.run).stage(name).effort()
        facts = [
            f"{value} of {fact}" if fact == "processor time" else f"{value} {fact}" for fact, value in effort.items()
        ]
        notes += [f"{name}: {', '.join(facts)}"] if effort else []
    model = trained.loaded
    rate = f"trained at up to {float(model.max_training_fps):g} fps"
    if is_unconditional(model):
        rate += ", knows no texts and no actions"
    return "; ".join((*notes, rate)) if notes else ""


def require_models(run: Path | None, what: str, missing: Missing) -> dict[str, TrainedModel]:
    """As `trained_models`; raises `UsageError` without a run, `RunError` if it holds no model."""
    if run is None:
        raise UsageError(f"{what} needs trained systems: --run NAME (motionkit train --for {what.replace(' ', ':')})")
    if not any(loader.begun_in(run) for loader in installed_models().values()):
        raise RunError(f"{str(run)!r} holds no trained system: motionkit train --for table:2 --run {run.name}")
    found = trained_models(run, missing)
    if not found:
        raise RunError("; ".join(missing.lines))
    return found


@dataclass(frozen=True, eq=False)
class Generated:
    """Motion fields by row, and each model's `training_note` by its name."""

    rows: Mapping[RowId, dict[Window, MotionField]]
    training: Mapping[str, str]


def generated_fields(config: EvalConfig, real: SampleSet) -> Generated:
    """Motions that each model of the run generates for the captions and durations of a real set.

    As generated, planted, and, if the run has a trained detail stage and the model is continuous in time, planted with
    detail. Raises `UsageError` for samples that are named like one of these rows.
    """
    run, most, draws = config.run, config.max_motions, config.draws
    models = trained_models(run, config.missing)
    check_sample_names(config.samples, models)
    detail = load_detail(run) if run is not None and has_detail(run) else None
    rows: dict[RowId, dict[Window, MotionField]] = {}
    for name, trained in tracked(config.on_progress, "systems", models.items(), len(models)):
        with config.missing.skipping(name):
            windows = windows_of(real, trained.loaded.max_duration_seconds)
            with task(config.on_progress, f"generating {name}", draws * min(len(windows), most)) as work:
                fields = generate_fields(
                    trained.loaded, windows, config.seed, most, draws=draws, on_motions=work.advance
                )
            standing = planted_fields(fields)
            rows |= {RowId(name): fields, RowId(name, Variant.PLANTED): standing}
            if detail is not None and not is_framed(fields):
                rows[RowId(name, Variant.DETAILED)] = detailed_fields(standing, detail, config.seed)
    return Generated(rows, {name: training_note(model) for name, model in models.items()})


def trained_reconstructors(run: Path) -> dict[str, Trained[MotionEncoder]]:
    """The installed encoders in a run that reconstruct windows of motion, by name.

    Raises `RunError` if there is none, and what loading them raises.
    """
    loaders = installed_encoders("reconstruction").values()
    held = [Trained(loader, run) for loader in loaders if loader.begun_in(run)]
    if not held:
        commands = " or ".join(loader.train_command(run) for loader in loaders) or "none is installed"
        raise RunError(f"run {run.name!r} holds no model that reconstructs windows of motion: {commands}")
    return {each.loaded.name: each for each in held}


def reconstructor(trained: Trained[MotionEncoder], store: "Store") -> ReconstructsWindows:
    """An encoder that reconstructs windows, trained on this store.

    Raises `UsageError` for other encoders, and for one that was trained on another state of the store.
    """
    encoder = trained.loaded
    if not isinstance(encoder, ReconstructsWindows):
        raise UsageError(f"{trained.loader.title} doesn't reconstruct windows of motion")
    if encoder.store_fingerprint != store.fingerprint:
        raise UsageError(
            f"{encoder.name} of {trained.run} was trained on another state of the store (fingerprint "
            f"{encoder.store_fingerprint[:16]}, now {store.fingerprint[:16]}): name that store, or train again"
        )
    return encoder
