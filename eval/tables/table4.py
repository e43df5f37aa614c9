"""NeRM's Table 4: how well the first stage reconstructs motions at 20, 40, 60, 100 and 120 fps."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

from eval.real import of_split_and
from eval.report.results import Block, Cell, Result, Row, environment
from eval.reported import reported_figures
from eval.tables.registry import Table, TableRequest
from motionkit.errors import UsageError

if TYPE_CHECKING:
    import numpy as np
    import torch

    from motionkit.clips import PositionSource, Windows
    from motionkit.store.reader import Store
    from nerm.field_model import TrainedField
    from nerm.reconstruction import Reconstruction

VERSION = "reconstruction/1"
COLUMNS = tuple(Fraction(rate) for rate in (20, 40, 60, 100, 120))
TRAINING = "training windows, from their μ"
HELD_OUT = "held-out windows, encoded by optimisation"
MOST_WINDOWS = 384
GLOBAL = "global MPJPE, mm"
COUNT = "windows"


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


def build_table4(request: TableRequest) -> Result:
    """Root-aligned MPJPE of training and of held-out windows by framerate.

    Raises `UsageError` without a run or with a run of another store, and what loading the run or the store raises.
    """
    from motionkit.store.reader import Store
    from nerm.field_model import load_field

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
    blocks = (
        _block("Takes fast enough for every column", trained, sets, rates, same=True, missing=missing),
        _block("All takes at least as fast as the column", trained, sets, rates, same=False, missing=missing),
        _paper_block(),
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
        },
        notes=("The global error of every cell is in its details.",),
        missing=tuple(missing),
        provenance={
            "store": {"path": request.store.name, "fingerprint": store.fingerprint},
            "run": request.run.name,
            "seed": request.seed,
            "environment": environment(),
        },
    )


TABLE = Table("nerm", "4", "reconstruction MPJPE by framerate", build_table4)


def training_windows(trained: "TrainedField", store: "Store", request: TableRequest) -> EncodedWindows:
    """A sample of the windows that a field was trained on, with their posterior means."""
    from motionkit.store.cache import open_cache
    from nerm.reconstruction import separate_windows

    source = open_cache(store, layout="smpl22", where=trained.config.where or None)
    everything = EncodedWindows(source, trained.windows, trained.posterior_mean)
    return everything.select(_sample(separate_windows(trained.windows), trained.windows, request))


def held_out_windows(
    trained: "TrainedField", store: "Store", request: TableRequest, missing: list[str]
) -> EncodedWindows | None:
    """A sample of another split's windows, encoded against the frozen field; None where there is none."""
    from motionkit.clips import cut_windows
    from motionkit.store.cache import open_cache
    from nerm.reconstruction import encode_windows, separate_windows

    try:
        if request.split in ("all", "train"):
            raise UsageError(f"split {request.split!r} holds training windows; name another (--split test)")
        source = open_cache(store, layout="smpl22", where=of_split_and(request.split, request.where))
        windows = cut_windows(
            source,
            max_duration_seconds=trained.max_duration_seconds,
            min_duration_seconds=trained.config.min_duration_seconds,
        )
    except UsageError as error:
        missing.append(f"{HELD_OUT}: {error}")
        return None
    windows = windows.select(_sample(separate_windows(windows), windows, request))
    return EncodedWindows(source, windows, encode_windows(trained, source, windows))


def _sample(rows: "np.ndarray", windows: "Windows", request: TableRequest) -> "np.ndarray":
    """At most `MOST_WINDOWS` of the rows, in order: drawn from the seed, those fast enough for every column first."""
    import numpy as np

    from nerm.reconstruction import comparable

    shuffled = np.random.default_rng(request.seed).permutation(rows)
    fast = comparable(windows, request.fps or COLUMNS)[shuffled]
    first_fast = np.concatenate((shuffled[fast], shuffled[~fast]))
    return np.sort(first_fast[: min(MOST_WINDOWS, request.max_motions)])


def _block(
    title: str,
    trained: "TrainedField",
    sets: dict[str, EncodedWindows | None],
    rates: Sequence[Fraction],
    *,
    same: bool,
    missing: list[str],
) -> Block:
    import numpy as np

    from nerm.reconstruction import comparable, reconstructions

    rows = []
    for name, encoded in sets.items():
        if encoded is None:
            continue
        chosen = encoded.select(np.flatnonzero(comparable(encoded.windows, rates))) if same else encoded
        cells = {}
        for fps in rates:
            cell = error_cell(reconstructions(trained, chosen.source, chosen.windows, chosen.latents, fps))
            if cell is None:
                missing.append(f"{name}, {_label(fps)}: no take is that fast")
            else:
                cells[_label(fps)] = cell
        if cells:
            rows.append(Row(name, "ours", cells))
    return Block(f"{title} (mm)", tuple(_label(fps) for fps in rates), tuple(rows))


def error_cell(windows: "Iterable[Reconstruction]") -> Cell | None:
    """Root-aligned and global MPJPE in millimetres, windows weighing by duration; None where there is no window."""
    from eval.metrics.reconstruction import mpjpe_global, mpjpe_root_aligned

    aligned = whole = seconds = 0.0
    count = 0
    for window in windows:
        aligned += window.seconds * mpjpe_root_aligned(window.found, window.truth)
        whole += window.seconds * mpjpe_global(window.found, window.truth)
        seconds += window.seconds
        count += 1
    if not count:
        return None
    return Cell(1000.0 * aligned / seconds, None, {GLOBAL: 1000.0 * whole / seconds, COUNT: float(count)})


def _paper_block() -> Block:
    figures = [figure for figure in reported_figures("nerm", "4") if figure.metric == "mpjpe_m"]
    cells: dict[str, dict[str, Cell]] = {}
    for figure in figures:
        if figure.value is not None:
            cells.setdefault(figure.method, {})[_label(figure.setting)] = Cell(1000.0 * figure.value, figure.ci95)
    return Block(
        title="Printed in the NeRM paper (HumanML3D; metres there, millimetres here)",
        columns=tuple(dict.fromkeys(_label(figure.setting) for figure in figures)),
        rows=tuple(Row(f"{method} (paper)", "paper", found) for method, found in cells.items()),
        note=(
            "100 sequences of another data set; the paper says neither if they were in training nor what is aligned."
        ),
    )


def _label(fps: Fraction | str) -> str:
    return f"{str(fps).removesuffix('fps').strip()} fps"
