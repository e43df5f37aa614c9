"""Training time until windows are reconstructed to 25 mm: our settings against the paper's, on the same windows.

    python benchmarks/nerm/time_to_quality.py STORE --out DIR [--ours-seconds 150] [--paper-seconds 450] [--json]

Root-aligned MPJPE (mm) over 22 joints at 20 fps of up to 64 non-overlapping training windows of the fastest takes,
decoded from μ, against CPU seconds of training (one thread; scales and the first fit count, measuring doesn't).
The paper's settings are scaled to fit a processor: hidden width 256 for 1,024 and batches of 128 clips of 32 poses for
4,096; both sides read Fourier features without the codebook's attention, which is left out in the paper's favour.
Writes time-to-quality.json and time-to-quality.png to DIR.
"""

import json
import time
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch

from benchmarks.command import arguments_parser
from eval.metrics.reconstruction import mpjpe_root_aligned
from eval.reconstruction.windows import comparable, reconstructions, separate_windows
from eval.report.results import provenance
from motionkit.data.corpus import FrameValues
from motionkit.data.poses import WindowPoses
from motionkit.store.cache import PositionCache, open_cache
from motionkit.store.reader import Store
from motionkit.training.config import apply_overrides
from motionkit.training.loop import step_generator
from nerm.field.trained import TrainedField
from nerm.field.training import FieldTraining, training_windows
from nerm.recipes import nano, paper
from nerm.settings import FieldConfig

TARGET_MM = 25.0
FPS = Fraction(20)
MOST_WINDOWS = 64
GROWTH = 1.3
FIRST_SECONDS = 3.0


@dataclass(frozen=True)
class Point:
    """One measurement."""

    cpu_seconds: float
    steps: int
    aligned_mm: float


def settings(ours_steps: int) -> dict[str, FieldConfig]:
    """Both sides' settings."""
    return {
        "ours": apply_overrides(nano().field, [f"schedule.steps={ours_steps}", "encoder.kind=fourier"]),
        "the paper's, scaled": apply_overrides(
            paper().field,
            ["windows.stride_seconds=2.0", "decoder.width=256", "schedule.batch_size=128", "encoder.kind=fourier"],
        ),
    }


def curve(store: Store, config: FieldConfig, budget_seconds: float) -> list[Point]:
    """Train until the budget or the last step, measuring at times that grow by `GROWTH`."""
    source = open_cache(store, layout="smpl22", where=config.where)
    windows = training_windows(source, config)
    rows = separate_windows(windows)
    fast = rows[comparable(windows.select(rows), [Fraction(120)])]
    chosen = np.sort(np.random.default_rng(0).permutation(fast if len(fast) else rows)[:MOST_WINDOWS])
    spent, started = 0.0, time.process_time()
    training = FieldTraining(
        WindowPoses(windows, FrameValues.of_positions(source)),
        config,
        codebook=None,
        seed=0,
        device=torch.device("cpu"),
    )
    spent += time.process_time() - started
    points = [Point(spent, 0, _error_mm(training, source, chosen, store))]
    step, next_at = 0, FIRST_SECONDS
    while spent < budget_seconds and step < training.steps:
        started = time.process_time()
        training.step(step, step_generator(0, "field", step))
        spent, step = spent + time.process_time() - started, step + 1
        if spent >= next_at or step == training.steps:
            next_at = max(next_at, spent) * GROWTH
            points.append(Point(spent, step, _error_mm(training, source, chosen, store)))
    if points[-1].steps != step:
        points.append(Point(spent, step, _error_mm(training, source, chosen, store)))
    return points


def _error_mm(training: FieldTraining, source: PositionCache, chosen: np.ndarray, store: Store) -> float:
    trained = TrainedField(
        network=training.network.eval(),
        scaling=training.scaling,
        components=training.components,
        posterior_mean=training.mean.table,
        posterior_log_variance=training.log_variance.table,
        windows=training.poses.windows,
        store_fingerprint=store.fingerprint,
    )
    windows = trained.windows.select(chosen)
    latents = trained.posterior_mean[torch.from_numpy(chosen)]
    fields = [
        trained.as_motion_field(latent, float(seconds))
        for latent, seconds in zip(latents, windows.duration_seconds, strict=True)
    ]
    found = reconstructions(source, windows, fields, FPS)
    errors = [(window.seconds, mpjpe_root_aligned(window.found, window.truth)) for window in found]
    training.network.train()
    return 1000.0 * sum(seconds * error for seconds, error in errors) / sum(seconds for seconds, _ in errors)


def reached(points: list[Point]) -> float | None:
    """CPU seconds until the error reaches the target and stays there; None if it never does."""
    for index, point in enumerate(points):
        if all(later.aligned_mm <= TARGET_MM for later in points[index:]):
            return point.cpu_seconds
    return None


def draw(curves: dict[str, list[Point]], path: Path) -> None:
    """Both curves on logarithmic axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.subplots()
    for name, points in curves.items():
        axes.plot(
            [point.cpu_seconds for point in points],
            [point.aligned_mm for point in points],
            marker="o",
            markersize=3,
            label=name,
        )
    axes.axhline(TARGET_MM, color="0.6", linewidth=0.8, linestyle="--")
    axes.set(xscale="log", yscale="log", xlabel="CPU seconds of training, one thread", ylabel="aligned MPJPE, mm")
    axes.set_xlim(left=1.0)
    axes.set_yticks([10, 20, 25, 50, 100, 200], labels=["10", "20", "25", "50", "100", "200"])
    axes.minorticks_off()
    axes.legend()
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--ours-steps", type=int, default=1500)
    parser.add_argument("--ours-seconds", type=float, default=150.0)
    parser.add_argument("--paper-seconds", type=float, default=450.0)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    store = Store.open(arguments.store)
    configs = settings(arguments.ours_steps)
    budgets = dict(zip(configs, (arguments.ours_seconds, arguments.paper_seconds), strict=True))
    curves = {name: curve(store, config, budgets[name]) for name, config in configs.items()}
    figures = {
        "target_mm": TARGET_MM,
        "cpu_seconds_to_target": {name: reached(points) for name, points in curves.items()},
        "curves": {name: [asdict(point) for point in points] for name, points in curves.items()},
        "provenance": provenance(arguments.store),
    }
    arguments.out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(figures, indent=2)
    (arguments.out / "time-to-quality.json").write_text(text + "\n", encoding="utf-8")
    draw(curves, arguments.out / "time-to-quality.png")
    if arguments.json:
        print(text)
        return
    for name, points in curves.items():
        when = reached(points)
        result = f"{TARGET_MM:g} mm after {when:.0f} CPU s" if when is not None else f"{TARGET_MM:g} mm not reached"
        last = points[-1]
        print(f"{name:22} {result}; {last.aligned_mm:.1f} mm after {last.cpu_seconds:.0f} CPU s, {last.steps} steps")


if __name__ == "__main__":
    main()
