"""Cost of `motionkit ingest` for one long BVH file: peak resident memory and CPU time.

    python -m benchmarks.formats.long_takes [--frames 10000 100000 1000000]

Files of 21 joints, as large as recorded ones (513 bytes a frame), are written into a temporary folder, each is ingested
by a process of its own with one worker. A table goes to stderr, JSON to stdout.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from rich.table import Table

from benchmarks.command import arguments_parser, print_table_and_json

SPINE = ["Spine", "Spine1", "Neck", "Head"]
ARM = ["Shoulder", "Arm", "ForeArm", "Hand"]
LEG = ["UpLeg", "Leg", "Foot", "ToeBase"]
# Each chain with its parent, and the offsets of its bones (cm).
CHAINS = [
    ("Hips", SPINE, (0, 17, 0)),
    *(("Spine1", [f"{side}{bone}" for bone in ARM], (18 * sign, 0, 0)) for side, sign in (("Left", 1), ("Right", -1))),
    *(("Hips", [f"{side}{bone}" for bone in LEG], (2 * sign, -30, 2)) for side, sign in (("Left", 1), ("Right", -1))),
]
ROWS_AT_ONCE = 5000
COMMAND = "import sys; from motionkit.cli.app import main; sys.exit(main())"


def hierarchy() -> str:
    def joint(name: str, offset: tuple[int, int, int]) -> list[str]:
        children = [(chain[0], bone) for above, chain, bone in CHAINS if above == name]
        children += [
            (chain[place + 1], bone) for _, chain, bone in CHAINS for place in range(3) if chain[place] == name
        ]
        places = "6 Xposition Yposition Zposition" if name == "Hips" else "3"
        lines = [f"{'ROOT' if name == 'Hips' else 'JOINT'} {name}", "{", "OFFSET {} {} {}".format(*offset)]
        lines.append(f"CHANNELS {places} Zrotation Xrotation Yrotation")
        for child, bone in children:
            lines += joint(child, bone)
        return [*lines, *([] if children else ["End Site", "{", "OFFSET 0 5 0", "}"]), "}"]

    return "\n".join(["HIERARCHY", *joint("Hips", (0, 90, 0))])


def write_take(path: Path, num_frames: int) -> None:
    steps = np.random.default_rng(0).normal(0, 0.3, (ROWS_AT_ONCE, 66))
    table = np.cumsum(steps - steps.mean(axis=0), axis=0)  # it ends where it began
    table[:, 1] += 90
    lines = [" ".join(f"{value:.4f}" for value in row) + "\n" for row in table]
    with path.open("w") as file:
        file.write(f"{hierarchy()}\nMOTION\nFrames: {num_frames}\nFrame Time: .0083333\n")
        for start in range(0, num_frames, ROWS_AT_ONCE):
            file.writelines(lines[: num_frames - start])


def ingest(take: Path, store: Path) -> dict[str, float]:
    process = subprocess.Popen(
        [sys.executable, "-c", COMMAND, "ingest", take, "--store", store, "--workers", "1"], stdout=subprocess.DEVNULL
    )
    _, status, used = os.wait4(process.pid, 0)
    if status:
        sys.exit(f"ingest of {take} failed")
    return {"peak_mb": used.ru_maxrss / 1024, "cpu_seconds": used.ru_utime + used.ru_stime}


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("--frames", type=int, nargs="+", default=[10_000, 100_000, 1_000_000])
    table = Table("frames", "file, MB", "peak, MB", "bytes a frame and joint", "CPU, s")
    results = []
    for num_frames in parser.parse_args().frames:
        with tempfile.TemporaryDirectory() as folder:
            take = Path(folder) / "take.bvh"
            write_take(take, num_frames)
            result = {"frames": num_frames, "file_mb": take.stat().st_size / 2**20}
            result |= ingest(take, Path(folder) / "store")
        base = results[0] if results else {}
        if base:
            grown = (result["peak_mb"] - base["peak_mb"]) * 2**20
            result["bytes_a_frame_and_joint"] = grown / (num_frames - base["frames"]) / 21
        results.append(result)
        share = f"{result['bytes_a_frame_and_joint']:.0f}" if base else ""
        table.add_row(
            f"{num_frames:,}",
            f"{result['file_mb']:,.0f}",
            f"{result['peak_mb']:,.0f}",
            share,
            f"{result['cpu_seconds']:.1f}",
        )
    print_table_and_json(table, {"takes": results})


if __name__ == "__main__":
    main()
