"""AMASS reading: file to joint positions of a 10,000-frame take, beside numpy's own loading of the same arrays.

    python -m benchmarks.formats.amass [--frames 10000] [--repeats 5]

AMASS can't be shared, so the takes are random rotations in the published layouts, and the body models random vertices.
CPU seconds of one thread, best of the repeats, files in the page cache. A table goes to stderr, JSON to stdout.
"""

import platform
import tempfile
from pathlib import Path

import numpy as np
from rich.table import Table

from benchmarks.command import arguments_parser, best_cpu_seconds, print_table_and_json
from motionkit.io.amass import read_amass
from motionkit.io.registry import ReadOptions, SourceItem
from motionkit.io.smpl_body import LAYOUTS

NUM_VERTICES = {"smplh": 6890, "smplx": 10475}


def write_take(path: Path, width: int, num_frames: int, compressed: bool) -> None:
    rng = np.random.default_rng(0)
    save = np.savez_compressed if compressed else np.savez
    save(
        path,
        poses=rng.normal(0, 0.3, (num_frames, width)),
        trans=rng.normal(0, 1, (num_frames, 3)),
        betas=rng.normal(0, 1, 16),
        gender=np.array("neutral"),
        mocap_framerate=np.array(120.0),
    )


def write_body_model(folder: Path, family: str) -> None:
    rng = np.random.default_rng(1)
    vertices = NUM_VERTICES[family]
    np.savez(
        folder / f"{family.upper()}_NEUTRAL.npz",
        v_template=rng.normal(0, 0.5, (vertices, 3)),
        shapedirs=rng.normal(0, 0.05, (vertices, 3, 400)),
        J_regressor=np.full((LAYOUTS[family].num_joints, vertices), 1 / vertices),
    )


def measure(folder: Path, family: str, compressed: bool, num_frames: int, repeats: int) -> dict[str, float | str]:
    path = folder / f"{family}_poses.npz"
    write_take(path, 3 * LAYOUTS[family].num_joints, num_frames, compressed)
    item = SourceItem("amass", path, folder, family)

    def load() -> None:
        with np.load(path) as archive:
            _ = archive["poses"], archive["trans"]

    def read(body_models: Path | None) -> None:
        read_amass(item, ReadOptions(body_models=body_models))

    read(folder)
    return {
        "take": f"{family}, {'deflated' if compressed else 'stored'}",
        "megabytes": path.stat().st_size / 1e6,
        "numpy_load_seconds": best_cpu_seconds(load, repeats),
        "mean_shape_seconds": best_cpu_seconds(lambda: read(None), repeats),
        "body_model_seconds": best_cpu_seconds(lambda: read(folder), repeats),
    }


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for family in NUM_VERTICES:
            write_body_model(folder, family)
        rows = [
            measure(folder, family, compressed, arguments.frames, arguments.repeats)
            for family in NUM_VERTICES
            for compressed in (False, True)
        ]
    table = Table("take", "MB", "np.load, ms", "to 22 joints, ms", "to all joints, ms")
    for row in rows:
        times = [f"{1e3 * float(row[key]):.0f}" for key in row if key.endswith("_seconds")]
        table.add_row(str(row["take"]), f"{row['megabytes']:.1f}", *times)
    print_table_and_json(table, {"machine": platform.processor(), "frames": arguments.frames, "takes": rows})


if __name__ == "__main__":
    main()
