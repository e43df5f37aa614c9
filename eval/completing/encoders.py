"""The rows of the completion tables: what needs no training, and the trained encoders of runs."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from eval.baselines.row_curves import CUBIC, LINEAR
from motionkit.encoders import load_encoder, runs_with, trained_encoder_names
from motionkit.errors import MotionkitError, UsageError
from motionkit.interpolation.fields import INTERPOLATORS
from motionkit.motionfield import MotionEncoder
from motionkit.training.run import RunFolder, commit, versions

# Names of trained encoders as the paper prints them; any other is called what its entry point is.
TITLES = {
    "pahires": "PA-HiRes",
    "liif": "LIIF",
    "meta-sr": "Meta-SR",
    "a-liif": "A-LIIF",
    "lmf": "LMF",
    "delta-interp": "Δ-Interp",
    "ts-former": "TS-Former",
    "nerm": "NeRM (latents by optimisation)",
}


@dataclass(frozen=True)
class Completer:
    """A row: an encoder, what it is, and what its figures depend on beside the protocol."""

    name: str
    encoder: MotionEncoder
    note: str
    fingerprint: str
    trained: bool = False


HOLD = Completer("hold", INTERPOLATORS["hold"], "each given pose until the next one", "hold/1")
INTERPOLATION = (
    HOLD,
    Completer("linear", LINEAR, "straight lines through the pose's 135 numbers (rotations as two columns)", "linear/1"),
    Completer("SLERP", INTERPOLATORS["slerp"], "rotations on great arcs, root on straight lines", "slerp/1"),
    Completer(
        "Catmull-Rom",
        INTERPOLATORS["rotation-catmull-rom"],
        "Hermite curves on the logarithms of turns between quaternions",
        "catmull-rom/1",
    ),
    Completer("SQUAD", INTERPOLATORS["squad"], "spherical quadrangles, root Catmull-Rom", "squad/1"),
    Completer("cubic spline", CUBIC, "not-a-knot spline through the pose's 135 numbers", "cubic/1"),
)


def trained_completers(
    names: Sequence[str], run: Path | None, more: Sequence[tuple[str, Path]], missing: list[str]
) -> list[Completer]:
    """Encoders of these names that `run` holds, then (name, run) pairs asked for by name, which must be there.

    What a table would show and `run` lacks is told in `missing`, with the runs that have it. Raises `UsageError` for a
    name that no installed package has, and what loading an encoder that was asked for raises.
    """
    known = trained_encoder_names()
    found: list[Completer] = []
    asked = {name for name, _ in more}
    for name in names:
        if name not in known:
            missing.append(f"{TITLES.get(name, name)}: no installed package has an encoder called {name!r}")
        elif run is not None and RunFolder(run).stage(name).is_complete:
            try:
                found.append(completer_of(name, run, TITLES.get(name, name)))
            except MotionkitError as error:
                missing.append(f"{TITLES.get(name, name)}: {error}")
        elif name not in asked:
            missing.append(_told_untrained(name, run))
    for name, folder in more:
        if name not in known:
            raise UsageError(f"--encoder {name}={folder.name}: trained encoders are {', '.join(known) or 'none'}")
        found.append(completer_of(name, folder, f"{TITLES.get(name, name)} ({folder.name})"))
    return found


def completer_of(name: str, run: Path, title: str) -> Completer:
    """The row of a run's trained encoder; raises what loading it raises."""
    encoder = load_encoder(name, run)
    model = RunFolder(run).stage(name).model_path
    digest = hashlib.sha256(model.read_bytes()).hexdigest() if model.is_file() else str(run)
    # What a network answers depends on the code that asks it: figures of another commit are not taken for this one's.
    return Completer(title, encoder, f"run {run.name!r}", f"{name}-{digest}-{code_version()}", trained=True)


@cache
def code_version() -> str:
    """The commit of this code, or the package's version where there is no checkout."""
    return commit() or versions()["motionkit"]


def _told_untrained(name: str, run: Path | None) -> str:
    title = TITLES.get(name, name)
    others = [] if run is None else [path.name for path in runs_with(name, run.parent)]
    if others:
        return f"{title}: run {run.name if run else ''!r} has none; --encoder {name}={others[-1]} shows that of another"
    return f"{title}: not trained (motionkit train --stage {name}" + (f" --run {run.name})" if run else ")")
