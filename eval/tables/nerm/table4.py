"""NeRM's Table 4: how well the first stage reconstructs motions at 20, 40, 60, 100 and 120 fps."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

from eval.report.results import Block, Cell, Result, Row, environment
from eval.samples.real import of_split_and
from eval.tables.reconstruction_errors import WindowErrors, mpjpe_cell, mre_cell, window_errors
from eval.tables.registry import Table, TableRequest
from eval.tables.reported import reported_figures
from motionkit.errors import UsageError

if TYPE_CHECKING:
    import numpy as np
    import torch

    from motionkit.clips.windows import PositionSource, Windows
    from motionkit.store.reader import Store
    from nerm.field.trained import TrainedField

VERSION = "reconstruction/2"
COLUMNS = tuple(Fraction(rate) for rate in (20, 40, 60, 100, 120))
TRAINING = "training windows, from their μ"
HELD_OUT = "held-out windows, encoded by optimisation"
MOST_WINDOWS = 384
PAPER_NOTE = "100 sequences of another data set; the paper says neither if they were in training nor what is aligned."


@dataclass(frozen=True, eq=False)
class EncodedWindows:
    """Windows of a source with a latent each."""

    source: "PositionSource"
    windows: "Windows"
    latents: "torch.Tensor"

    def select(self, rows: "np.ndarray") -> "EncodedWindows":
        """Some of them."""
        import torch

        return EncodedWindows(self.source, self.windows.select(rows), self.latents[torch.from_numpy(rows)])


@dataclass(frozen=True, eq=False)
class _Measured:
    """The errors of windows at each framerate, and which of them have a truth at every one."""

    errors: dict[Fraction, dict[int, WindowErrors]]
    comparable: frozenset[int]

    def at(self, fps: Fraction, *, same: bool) -> list[WindowErrors]:
        """Errors at one framerate: of all windows that have a truth there, or of the same windows at each."""
        return [error for row, error in self.errors[fps].items() if row in self.comparable or not same]


def build_table4(request: TableRequest) -> Result:
    """MPJPE and MRE of training and of held-out windows by framerate.

    Raises `UsageError` without a run or with a run of another store, and what loading the run or the store raises.
    """
    from motionkit.store.reader import Store
    from nerm.field.saved import load_field

    if request.run is None:
        raise UsageError("table 4 needs a trained field: --run NAME (motionkit train --stage field makes one)")
    trained, store = load_field(request.run), Store.open(request.store)
    if trained.store_fingerprint != store.fingerprint:
        raise UsageError(
            f"the field of {request.run} was trained on another state of the store (fingerprint "
            f"{trained.store_fingerprint[:16]}, now {store.fingerprint[:16]}): name that store, or train again"
        )
    rates = request.fps or COLUMNS
    missing: list[str] = []
    sets = {
        TRAINING: training_windows(trained, store, request),
        HELD_OUT: held_out_windows(trained, store, request, missing),
    }
    measured = {name: _measure(trained, each, rates) for name, each in sets.items() if each is not None}
    _tell_missing(measured, missing)
    blocks = (
        _block("MPJPE in mm, takes fast enough for every column", measured, rates, mpjpe_cell, same=True),
        _block("MPJPE in mm, all takes at least as fast as the column", measured, rates, mpjpe_cell, same=False),
        _paper_block("MPJPE printed in the NeRM paper (HumanML3D; metres there, millimetres here)", "mpjpe_m", 1000.0),
        _block("MRE, takes fast enough for every column", measured, rates, mre_cell, same=True),
        _paper_block("MRE printed in the NeRM paper (HumanML3D)", "mre", 1.0),
    )
    return Result(
        task="nerm-table4",
        version=VERSION,
        title="Table 4: reconstruction by framerate",
        caption=(
            "Root-aligned mean per-joint position error in millimetres over 22 joints, windows weighing by duration. "
            f"Held-out windows are of split {request.split!r}{request.restriction}."
        ),
        blocks=tuple(block for block in blocks if block.rows),
        definition={
            "truth": "the capture, brought down band-limited to the column's framerate; slower takes are left out",
            "root-aligned": "both roots at the origin, no rotation fitted; the root counts as a joint with error 0",
            "training windows": "do not overlap, not mirrored; decoded from the posterior mean, not fitted again",
            "sample": f"at most {MOST_WINDOWS} windows a row, those fast enough for every column first",
            "held-out sequences": of_split_and(request.split, request.where),
            "held-out windows": "z by L-BFGS on evenly spaced native poses against the frozen field",
            "MRE": "root of the mean squared difference of `native` pose vectors (263 numbers; m, m/s, rad/s)",
        },
        notes=(
            "The global error of every cell is in its details.",
            "The paper words MRE as the Euclidean distance of two vectors, which its figures cannot be (a distance of "
            "0.041 does not leave room for an MPJPE of 0.016); that distance is in the details. Vectors hold "
            "velocities, so capture noise counts, the more the higher the framerate.",
        ),
        missing=tuple(missing),
        provenance={
            "store": {"path": request.store.name, "fingerprint": store.fingerprint},
            "run": request.run.name,
            "seed": request.seed,
            "environment": environment(),
        },
    )


TABLE = Table("nerm", "4", "reconstruction MPJPE and MRE by framerate", build_table4, takes_samples=False)


def training_windows(trained: "TrainedField", store: "Store", request: TableRequest) -> EncodedWindows:
    """A sample of the windows that a field was trained on, with their posterior means."""
    from nerm.field.reconstruction import separate_windows

    source, _ = trained.vectors.open(store, trained.config.where or None)
    everything = EncodedWindows(source, trained.windows, trained.posterior_mean)
    return everything.select(_sample(separate_windows(trained.windows), trained.windows, request))


def held_out_windows(
    trained: "TrainedField", store: "Store", request: TableRequest, missing: list[str]
) -> EncodedWindows | None:
    """A sample of another split's windows, encoded against the frozen field; None where there is none."""
    from motionkit.clips.windows import cut_windows
    from nerm.field.reconstruction import encode_windows, separate_windows

    try:
        if request.split in ("all", "train"):
            raise UsageError(f"split {request.split!r} holds training windows; name another (--split test)")
        source, frames = trained.vectors.open(store, of_split_and(request.split, request.where))
        windows = cut_windows(
            source,
            max_duration_seconds=trained.max_duration_seconds,
            min_duration_seconds=trained.config.min_duration_seconds,
        )
    except UsageError as error:
        missing.append(f"{HELD_OUT}: {error}")
        return None
    windows = windows.select(_sample(separate_windows(windows), windows, request))
    return EncodedWindows(source, windows, encode_windows(trained, source, windows, frames))


def _sample(rows: "np.ndarray", windows: "Windows", request: TableRequest) -> "np.ndarray":
    """At most `MOST_WINDOWS` of the rows, in order: drawn from the seed, those fast enough for every column first."""
    import numpy as np

    from nerm.field.reconstruction import comparable

    shuffled = np.random.default_rng(request.seed).permutation(rows)
    fast = comparable(windows, request.fps or COLUMNS)[shuffled]
    first_fast = np.concatenate((shuffled[fast], shuffled[~fast]))
    return np.sort(first_fast[: min(MOST_WINDOWS, request.max_motions)])


def _measure(trained: "TrainedField", encoded: EncodedWindows, rates: Sequence[Fraction]) -> _Measured:
    import numpy as np

    from nerm.field.reconstruction import comparable, reconstructions

    errors: dict[Fraction, dict[int, WindowErrors]] = {}
    for fps in rates:
        rows = np.flatnonzero(comparable(encoded.windows, [fps]))
        chosen = encoded.select(rows)
        found = reconstructions(trained, chosen.source, chosen.windows, chosen.latents, fps)
        errors[fps] = {int(row): window_errors(window, fps) for row, window in zip(rows, found, strict=True)}
    return _Measured(errors, frozenset(np.flatnonzero(comparable(encoded.windows, rates)).tolist()))


def _tell_missing(measured: dict[str, _Measured], missing: list[str]) -> None:
    for name, each in measured.items():
        missing.extend(f"{name}, {_label(fps)}: no take is that fast" for fps in each.errors if not each.errors[fps])


def _block(
    title: str,
    measured: dict[str, _Measured],
    rates: Sequence[Fraction],
    cell_of: Callable[[Sequence[WindowErrors]], Cell | None],
    *,
    same: bool,
) -> Block:
    rows = []
    for name, each in measured.items():
        cells = {_label(fps): cell_of(each.at(fps, same=same)) for fps in rates}
        found = {label: cell for label, cell in cells.items() if cell is not None}
        if found:
            rows.append(Row(name, "ours", found))
    return Block(title, tuple(_label(fps) for fps in rates), tuple(rows))


def _paper_block(title: str, metric: str, factor: float) -> Block:
    figures = [figure for figure in reported_figures("nerm", "4") if figure.metric == metric]
    cells: dict[str, dict[str, Cell]] = {}
    for figure in figures:
        if figure.value is not None:
            cells.setdefault(figure.method, {})[_label(figure.setting)] = Cell(factor * figure.value, figure.ci95)
    return Block(
        title=title,
        columns=tuple(dict.fromkeys(_label(figure.setting) for figure in figures)),
        rows=tuple(Row(f"{method} (paper)", "paper", found) for method, found in cells.items()),
        note=PAPER_NOTE,
    )


def _label(fps: Fraction | str) -> str:
    return f"{str(fps).removesuffix('fps').strip()} fps"
