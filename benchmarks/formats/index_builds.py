"""Native-framerate HumanML3D from an index: finding its files, and reading its clips, mirrored ones too.

    python -m benchmarks.formats.index_builds index.csv [--files 60]

The index is the published one. Its files are found in a tree of empty ones with the SMPL-X release's names; some of
them are written as compressed AMASS files of made-up poses at 120 fps and read. CPU seconds of one thread. The peer is
what any reader has to do: numpy's loading of the arrays, once a file, and once a clip as scripts commonly do. A table
goes to stderr, JSON to stdout.
"""

import platform
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.command import arguments_parser, print_table_and_json
from motionkit.io.cuts import StepCut
from motionkit.io.indexes import Entry, read_index
from motionkit.io.reading import read
from motionkit.io.registry import IndexOptions, ReadOptions, SourceItem
from motionkit.io.scan import scan

FPS = 120
RENAMED = {
    "BioMotionLab_NTroje": "BMLrub", "DFaust_67": "DFaust", "Eyes_Japan_Dataset": "EyesJapanDataset",
    "MPI_HDM05": "HDM05", "MPI_Limits": "PosePrior", "MPI_mosh": "MoSh", "SSM_synced": "SSM",
    "Transitions_mocap": "Transitions",
}  # fmt: skip


def cpu_seconds(work: Callable[[], Any]) -> tuple[float, Any]:
    start = time.process_time()
    result = work()
    return time.process_time() - start, result


def smplx_name(entry: Entry) -> Path:
    first, *middle, name = entry.parts
    name = name.replace("_poses.npy", "_stageii.npz")
    return Path(RENAMED.get(first, first), *middle, name.replace(" ", "_"))


def write_file(path: Path, num_frames: int, rng: np.random.Generator) -> None:
    seconds = np.arange(num_frames)[:, None] / FPS
    # Smooth, with noise in the last digits, so that it compresses as captures do.
    poses = 0.3 * np.sin(seconds * rng.uniform(1, 5, 156)) + 1e-4 * rng.normal(size=(num_frames, 156))
    trans = np.cumsum(rng.normal(scale=1e-3, size=(num_frames, 3)), axis=0)
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        path,
        poses=poses,
        trans=trans,
        betas=np.zeros(16),
        gender=np.array("male"),
        mocap_framerate=np.array(float(FPS)),
    )


def load(item: SourceItem) -> None:
    with np.load(item.path) as arrays:
        arrays["poses"], arrays["trans"]


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("index", type=Path)
    parser.add_argument("--files", type=int, default=60)
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    entries = [entry for entry in read_index(arguments.index).entries if entry.dataset != "humanact12"]
    options = ReadOptions(index=IndexOptions((arguments.index,), mirrored=True))
    with tempfile.TemporaryDirectory() as name:
        empty, root = Path(name, "empty"), Path(name, "amass")
        for path in {empty / smplx_name(entry) for entry in entries}:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
        seconds: dict[str, float] = {}
        seconds["find"], found = cpu_seconds(lambda: scan([empty], options))
        chosen = {entries[number].key for number in rng.choice(len(entries), arguments.files, replace=False)}
        longest: dict[Path, int] = {}
        for entry in entries:
            if entry.key in chosen and isinstance(entry.cut, StepCut) and entry.cut.end_frame is not None:
                num_frames = (entry.cut.trim_frames + entry.cut.end_frame) * FPS // 20
                longest[smplx_name(entry)] = max(num_frames, longest.get(smplx_name(entry), 0))
        for path, num_frames in longest.items():
            write_file(root / path, num_frames, rng)
        items = scan([root], options).items
        read(items[0], options)
        seconds["clips"], motions = cpu_seconds(lambda: [read(item, options) for item in items])
        firsts = {item.path: item for item in items}
        seconds["numpy_once_a_file"], _ = cpu_seconds(lambda: [load(item) for item in firsts.values()])
        seconds["numpy_once_a_clip"], _ = cpu_seconds(lambda: [load(item) for item in items])
        megabytes = sum(path.stat().st_size for path in firsts) / 1e6
    report = {
        "benchmark": "index_builds",
        "machine": platform.processor() or platform.machine(),
        "sequences_found": len(found.items),
        "files": len(firsts),
        "megabytes": round(megabytes, 1),
        "clips": len(items),
        "frames": sum(motion.num_frames for motion in motions),
        "cpu_seconds": {what: round(value, 3) for what, value in seconds.items()},
        "times_numpy_once_a_file": round(seconds["clips"] / seconds["numpy_once_a_file"], 2),
        "minutes_for_all_files": round(seconds["clips"] / len(firsts) * len({entry.key for entry in entries}) / 60, 1),
    }
    table = Table("", "CPU s", "per clip, ms")
    for what, value in seconds.items():
        count = len(found.items) if what == "find" else len(items)
        table.add_row(what, f"{value:.2f}", f"{1000 * value / count:.2f}")
    print_table_and_json(table, report)


if __name__ == "__main__":
    main()
