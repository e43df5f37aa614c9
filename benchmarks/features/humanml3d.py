"""P6: frames a second of the `humanml3d` pose vectors on one core, beside HumanML3D's own code if a clone is given.

    python -m benchmarks.features.humanml3d [--peer CLONE] [--json]

Both sides take the same raw joints through uniform skeleton, floor, origin, facing and vectors. The peer's functions
are read from its notebook and run in this process; the inputs are walks of 10,000 and of 170 frames.
"""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.command import arguments_parser, print_json
from motionkit.core.skeleton import SMPL22
from motionkit.features import humanml3d
from motionkit.features.layout import SMPL22_LAYOUT

WORK = (
    "raw joints → pose vectors on one core, CPU time. ours: humanml3d.process, then humanml3d.vectors. "
    "peer: the notebook's own process_file, unchanged and whole: uniform_skeleton (inverse and forward kinematics), "
    "floor, origin, facing, foot_detect, get_cont6d_params (inverse kinematics), get_rifke, local velocities."
)

Pipeline = Callable[[np.ndarray], np.ndarray]


def wandering_body(num_frames: int, rng: np.random.Generator) -> np.ndarray:
    """Raw joints [T, 22, 3]: the rest pose with swaying joints, turning and walking."""
    rest = np.zeros((22, 3))
    for joint, parent in enumerate(SMPL22.parents[1:], start=1):
        rest[joint] = rest[parent] + SMPL22.offsets[joint]
    seconds = np.arange(num_frames) / 20
    sway = 0.05 * np.sin(seconds[:, None, None] * rng.uniform(1, 9, (22, 3)) + rng.uniform(0, 6, (22, 3)))
    yaw = 1.5 * np.sin(0.4 * seconds)
    cosine, sine = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    body = rest + sway
    x, z = body[..., 0].copy(), body[..., 2].copy()
    body[..., 0], body[..., 2] = cosine * x + sine * z + np.sin(seconds)[:, None], cosine * z - sine * x
    return (body + np.array([0, 0.9, 0])).astype(np.float32)


def ours(raw: np.ndarray) -> np.ndarray:
    return humanml3d.vectors(humanml3d.process(raw, "smpl22"), "smpl22")


def peer_pipeline(clone: Path) -> Pipeline:
    """HumanML3D's `process_file`, with the globals that its notebook sets for the 22-joint data set."""
    for name, alias in (("float", float), ("int", int), ("bool", bool)):
        if name not in np.__dict__:
            setattr(np, name, alias)  # its code predates numpy 1.24
    sys.path.insert(0, str(clone))
    import torch

    torch.set_num_threads(1)
    names: dict[str, Any] = {}
    for cell in json.loads((clone / "motion_representation.ipynb").read_text())["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "code" and ("import" in source.split("\n")[0] or source.lstrip().startswith("def ")):
            exec(source.replace("from tqdm import tqdm", ""), names)
    body = SMPL22_LAYOUT
    lengths = humanml3d.standard_bone_lengths("smpl22")
    directions = np.array(body.bone_directions, dtype=np.float32)
    names |= {
        "l_idx1": 5,
        "l_idx2": 8,
        "fid_r": [8, 11],
        "fid_l": [7, 10],
        "face_joint_indx": [2, 1, 17, 16],
        "joints_num": 22,
        "n_raw_offsets": torch.from_numpy(np.array(body.bone_directions)),
        "kinematic_chain": [list(chain) for chain in body.chains],
        "tgt_offsets": torch.from_numpy(directions * lengths[:, None]),
    }
    return lambda raw: names["process_file"](raw.copy(), body.contact_threshold)[0]


def frames_per_second(pipeline: Pipeline, raw: np.ndarray, seconds: float) -> float:
    """Median over repetitions of frames per second of CPU time."""
    pipeline(raw)
    rates: list[float] = []
    stop = time.process_time() + seconds
    while len(rates) < 3 or time.process_time() < stop:
        start = time.process_time()
        pipeline(raw)
        rates.append(len(raw) / (time.process_time() - start))
    return float(np.median(rates))


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("--peer", type=Path, help="a clone of EricGuo5513/HumanML3D")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--seconds", type=float, default=5.0, help="CPU time per measurement")
    options = parser.parse_args()
    peer = peer_pipeline(options.peer) if options.peer else None
    rows = []
    for num_frames in (10_000, 170):
        raw = wandering_body(num_frames, np.random.default_rng(0))
        row: dict[str, float] = {"frames": num_frames, "ours_fps": frames_per_second(ours, raw, options.seconds)}
        if peer is not None:
            row["peer_fps"] = frames_per_second(peer, raw, options.seconds)
            row["ratio"] = row["ours_fps"] / row["peer_fps"]
            row["largest_difference"] = float(np.abs(ours(raw) - peer(raw)).max())
        rows.append(row)
    if options.json:
        print_json({"work": WORK, "rows": rows})
        return
    print(WORK)
    print("  ".join(f"{name:>18}" for name in rows[0]))
    for row in rows:
        print("  ".join(f"{value:18.4g}" for value in row.values()))


if __name__ == "__main__":
    main()
