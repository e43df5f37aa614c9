"""Readers of motion files: every format, and the files beside them."""

from collections.abc import Iterator
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
from benchmarks.trust.fuzz.target import Make, Target, named

from motionkit.core.errors import FormatError, MotionkitError
from motionkit.core.skeletons.mapping import read_skeleton_map
from motionkit.edit.motions import find_motions
from motionkit.features.quality import measure
from motionkit.generate.request import read_prompts
from motionkit.io.indexes import read_index
from motionkit.io.registry import IndexOptions, ReadOptions, readers
from motionkit.io.scan import read, read_rules, scan
from motionkit.io.smpl_body import LAYOUTS
from motionkit.viz.player import check_places, panel_of
from tests.helpers.amass_samples import smplh_fields, stageii_fields, write_amass
from tests.helpers.every_format import SOURCES, bodies, write_arrays, write_text
from tests.helpers.format_samples import bvh_text, write_asfamc
from tests.helpers.side_files import BESIDE, RULES
from tests.motionkit.core.test_skeletons import robot_map

STATED = ReadOptions(fps=Fraction(30), unit_metres=1.0)
# Formats whose files do not state the framerate or the unit.
SAYS_NO_FRAMERATE = ("asfamc", "joints-npy")
INDEX = b"source_path,start_frame,end_frame,new_name\n./pose_data/KIT/3/a_poses.npy,0,-1,000000.npy\n"
INDEX += b"./pose_data/CMU/01/01_01_poses.npy,0,2,000001.npy\n"
BABEL = b"""{"1": {"babel_sid": 1, "feat_p": "KIT/KIT/3/a_poses.npz", "dur": 4.1,
"seq_ann": {"labels": [{"raw_label": "walk", "proc_label": "walk", "act_cat": ["walk"]}]}, "frame_ann": {"labels": [
{"raw_label": "turn", "act_cat": ["turn"], "start_t": 0.5, "end_t": 2.0}]}},
"2": {"feat_p": "CMU/CMU/01/01_01_poses.npz", "dur": 1, "seq_ann": null, "frame_ann": null}}"""
ANNOTATIONS = b"""{"000000": {"path": "KIT/3/a_poses", "duration": 4.1, "annotations": [
{"seg_id": "000000_0", "text": "a person walks", "start": 0.0, "end": 4.1}]},
"M000001": {"path": "CMU/01/01_01_poses", "duration": 1, "annotations": []}}"""
PROMPTS = {
    "prompts.txt": b"a person walks\nsomeone jumps\n",
    "prompts.csv": b"text,action,seconds\na person walks,,2.5\n,wave,\n",
}


def read_folder(folder: Path, options: ReadOptions = ReadOptions()) -> None:
    """Scan and read a folder as an ingest does; raises the first own error, or `AssertionError` for an invalid motion.

    Motions must be finite, timed, and measurable; errors must name the file and a reason.
    """
    found = scan([folder], options)
    problems = [_explained(problem, folder) for problem in found.problems]
    for item in found.items:
        assert item.path.is_relative_to(folder.resolve()), f"{item.path} lies outside"
        try:
            motion = read(item, options)
        except FormatError as problem:
            problems.append(_explained(problem, folder))
            continue
        assert np.isfinite(motion.joint_positions).all(), "a number that is not finite was read"
        assert 1 <= motion.fps <= 10_000, f"{motion.fps} fps were read"
        measure(motion)
    if problems:
        raise problems[0]


def _explained(problem: MotionkitError, folder: Path) -> MotionkitError:
    assert folder.name in str(problem), f"does not name its file: {problem}"
    return problem


def view_folder(folder: Path) -> None:
    """Read the motions of a folder as `motionkit view` and `complete` do, holes included."""
    sources, problems = find_motions([str(folder)], ReadOptions(fps=Fraction(30)), folder / "no-store")
    for source in sources:
        loaded = source.load()
        if loaded.valid.all():
            check_places(panel_of(loaded.motion, source.short_name))
    if problems:
        raise problems[0]


def read_indexed(folder: Path) -> None:
    """Read an index and the files that it names."""
    [index] = (path for path in folder.iterdir() if path.is_file())
    for entry in read_index(index).entries:
        assert ".." not in entry.parts and not Path(*entry.parts).is_absolute(), entry.parts
        assert Path(entry.name).name == entry.name, entry.name
    options = ReadOptions(index=IndexOptions((index,)))
    for item in scan([folder / "amass"], options).items:
        read(item, options)


def _bytes(name: str, content: bytes) -> Make:
    return lambda folder: (folder / name).write_bytes(content)


def _beside(side: str) -> Make:
    def make(folder: Path) -> None:
        format_name, file_name, content = BESIDE[side]
        SOURCES[format_name](folder)
        (folder / file_name).parent.mkdir(exist_ok=True)
        (folder / file_name).write_bytes(content)

    return make


def _indexed(name: str, content: bytes) -> Make:
    def make(folder: Path) -> None:
        (folder / name).write_bytes(content)
        for place in ("KIT/3/a_poses.npz", "CMU/01/01_01_poses.npz"):
            write_amass(folder / "amass" / place, smplh_fields(12))

    return make


def _body_model(folder: Path) -> None:
    from tests.motionkit.io.test_body_models import write_body_model

    write_body_model(folder / "models" / "smpl" / "SMPL_NEUTRAL.npz", LAYOUTS["smpl"])
    write_amass(folder / "take_poses.npz", smplh_fields(3, 72, gender=np.array("neutral"), betas=np.zeros(10)))


def _read_with_model(folder: Path) -> None:
    read_folder(folder, ReadOptions(body_models=folder / "models"))


def _every_array(folder: Path) -> None:
    time, rng = np.arange(5) / 30, np.random.default_rng(1)
    rotations = rng.normal(size=(5, 22, 4)).astype(np.float32)
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    arrays = {"joint_positions": bodies(5, 22), "time_seconds": time, "captions": np.array(["walks", "turns"])}
    np.savez(folder / "take.npz", **arrays, local_rotations=rotations, action=np.array("walk"))  # type: ignore[arg-type]


def _counted(folder: Path) -> None:
    (folder / "take.csv").write_text("frame,a_x,a_y,a_z,b_x,b_y,b_z\n0,1,2,3,1,1,1\n1,1,2,3.5,1,1,1\n")
    (folder / "clips.csv").write_text("file,fps,caption\ntake.csv,30000/1001,walks\n")


MORE: dict[str, tuple[Make, ...]] = {
    "bvh": (write_text("long.bvh", bvh_text([[0.5 * k] * 51 for k in range(30)])),),
    "npz": (_every_array,),
    "amass": (lambda folder: write_amass(folder / "take_stageii.npz", stageii_fields(), compressed=True),),
    "asfamc": (lambda folder: write_asfamc(folder / "07", num_frames=6),),
    "csv": (_counted,),
    "uestc": (write_arrays("a1_d2_p002_c0_color.npz", pose=np.full((4, 72), 0.1, np.float32), trans=np.zeros((4, 3))),),
}


def targets() -> Iterator[Target]:
    """All of them."""
    for name in readers():
        makes = (SOURCES[name], *MORE.get(name, ()))
        options = STATED if name in SAYS_NO_FRAMERATE else ReadOptions()
        yield Target(name, makes, partial(read_folder, options=options))
    for side, (_, file_name, _) in BESIDE.items():
        reader = partial(read_folder, options=STATED if side == "skeleton" else ReadOptions())
        yield Target(f"beside-{side}", (_beside(side),), reader, named(Path(file_name).name))
    viewed = tuple(SOURCES[name] for name in ("bvh", "npz", "joints-npy", "humanml3d"))
    yield Target("view", viewed, view_folder)
    yield Target("body-model", (_body_model,), _read_with_model, named("SMPL_NEUTRAL.npz"))
    indexes = (_indexed("index.csv", INDEX), _indexed("train.json", BABEL), _indexed("annotations.json", ANNOTATIONS))
    yield Target("index", indexes, read_indexed, named("index.csv", "train.json", "annotations.json"))
    yield Target("fps-rules", (_bytes("rules.toml", RULES),), lambda folder: _each(folder, read_rules))
    yield Target(
        "skeleton-map", (_bytes("map.toml", robot_map().encode()),), lambda folder: _each(folder, read_skeleton_map)
    )
    prompts = tuple(_bytes(name, content) for name, content in PROMPTS.items())
    yield Target("prompts", prompts, lambda folder: _each(folder, read_prompts))


def _each(folder: Path, read_file: object) -> None:
    for path in sorted(folder.iterdir()):
        read_file(path)  # type: ignore[operator]
