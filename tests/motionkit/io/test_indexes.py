"""Indexes: the published ones, bad rows, and native-framerate HumanML3D from AMASS files of both generations."""

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.core.skeletons.mapping import map_joints
from motionkit.edit.export import Selection, export, export_kinds
from motionkit.features import humanml3d
from motionkit.io.amass import read_amass
from motionkit.io.cuts import StepCut, TimeCut
from motionkit.io.indexes import Index, file_key, read_index
from motionkit.io.registry import IndexOptions, ReadOptions, SourceItem
from motionkit.store.ingest import ingest
from tests.helpers.amass_samples import smplh_fields, stageii_fields, write_amass
from tests.helpers.refusal import refusal
from tests.helpers.seed_samples import G1_STANDS, SOMA, seed_row, soma_bvh, soma_motion, write_seed

HEADER = "source_path,start_frame,end_frame,new_name\n"


@pytest.fixture(scope="module")
def annotations(captures: Path) -> Path:
    folder = captures / "annotations"
    if not folder.is_dir():
        pytest.skip(f"needs the published indexes in {folder}")
    return folder


@pytest.fixture(scope="module")
def published(annotations: Path) -> Index:
    return read_index(annotations / "humanml3d-index.csv")


def read(tmp_path: Path, text: str | bytes, name: str = "index.csv") -> Index:
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_index(path)


def test_humanml3d(published):
    index = published
    assert (index.name, index.problems, len(index.entries)) == ("humanml3d", (), 14_616)
    assert Counter(entry.dataset for entry in index.entries).most_common(2) == [("KIT", 4648), ("CMU", 2913)]
    by_name = {entry.name: entry for entry in index.entries}
    assert by_name["000000"].cut == StepCut(0, 117)
    assert by_name["012314"].cut == StepCut(149, 320, trim_frames=60)
    assert by_name["012314"].key == ("Eyes_Japan_Dataset", "yamaoka", "tennis-15-first_service-yamaoka")
    assert by_name["000001"].cut == StepCut(0, None, seen_fps=20.0)
    assert by_name["000014"].cut == StepCut(647, 847, trim_frames=20, seen_fps=60.0)
    # Many clips of one file, and no two files that a generous comparison of names would take for one.
    assert len({entry.key for entry in index.entries}) == len({entry.parts for entry in index.entries}) == 11_715


def test_kit(annotations):
    index = read_index(annotations / "kitml-annotations.json")
    assert (index.name, index.problems, len(index.entries)) == ("kitml", (), 5766)
    assert sum(entry.mirrored for entry in index.entries) == 2883
    assert all(entry.name.startswith("M") == entry.mirrored for entry in index.entries)
    assert sum(len(entry.captions) for entry in index.entries) == 12_164
    once = Counter(entry.dataset for entry in index.entries if not entry.mirrored)
    assert once == {"KIT": 2051, "CMU": 790, "EKUT": 42}
    first = index.entries[0]
    assert (first.name, first.parts) == ("00001", ("KIT", "4", "WalkingStraightForward01_poses.npz"))
    assert first.cut == TimeCut(file_seconds=3.78)
    assert first.captions == (mk.Caption("A person is walking forwards."),)
    assert all(isinstance(entry.cut, TimeCut) and entry.cut.is_whole for entry in index.entries)


@pytest.mark.parametrize(
    ("row", "reason"),
    [
        (",0,5,a.npy", "index-entry"),
        ("KIT/x.npy,0,5,../a.npy", "index-entry"),
        ("KIT/x.npy,-1,5,a.npy", "index-entry"),
        ("KIT/x.npy,5,5,a.npy", "index-entry"),
        ("KIT/x.npy,0,nan,a.npy", "index-entry"),
        ("KIT/x.npy,0", "index-entry"),
        ("KIT/x, y.npy,0,5,a.npy", "index-entry"),
        ("KIT/x.npy,0,5,good.npy", "duplicate-id"),
    ],
)
def test_a_bad_row_is_reported_and_the_others_are_kept(tmp_path, row, reason):
    """A byte-order mark, "./" and floats for whole numbers, as spreadsheets write them, are none."""
    index = read(tmp_path, f"\ufeff{HEADER}./pose_data/KIT/3/a.npy,0.0,5.0,good.npy\n{row}\n".replace("\n", "\r\n"))
    assert [(entry.name, entry.cut, entry.parts) for entry in index.entries] == [
        ("good", StepCut(0, 5), ("KIT", "3", "a.npy"))
    ]
    assert [(problem.reason, problem.line) for problem in index.problems] == [(reason, 3)]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (b"source_path,new_name\na,b\n", "index"),
        (b"source_path;start_frame;end_frame;new_name\na;0;5;b\n", "index"),
        (b"HIERARCHY\n", "index"),
        (HEADER.encode() + b"KIT/\xff.npy,0,5,a.npy\n", "encoding"),
        (b"", "empty"),
        (HEADER.encode() + b'"KIT/x.npy,0,5,a.npy\n', "index"),
        (b'{"a": 5}', "index"),
        (b'{"a": {"path": "x", "annotations": []}, "b": ' + b"[" * 100_000, "index"),
    ],
)
def test_files_that_are_no_index(tmp_path, text, reason):
    assert refusal(read, tmp_path, text).reason == reason


def tmr(**changes: object) -> dict[str, object]:
    said = {"seg_id": "a_0", "text": "a person walks", "start": 0.0, "end": 3.78}
    return {"path": "KIT/4/walk01_poses", "duration": 3.78, "annotations": [said], **changes}


@pytest.mark.parametrize(
    "value",
    [
        {"path": 5},
        {"annotations": "walk"},
        {"annotations": [{"start": 0, "end": 1}]},
        {"annotations": [{"text": "a", "start": 0, "end": float("nan")}]},
        {"duration": 10**400},
    ],
)
def test_a_bad_annotation_is_reported_and_the_others_are_kept(tmp_path, value):
    index = read(tmp_path, json.dumps({"good": tmr(), "bad": tmr(**value)}))
    assert [entry.name for entry in index.entries] == ["good"]
    assert [problem.reason for problem in index.problems] == ["index-entry"]
    assert "bad" in str(index.problems[0])


def label(text: str, categories: object, **seconds: float) -> dict[str, object]:
    return {"raw_label": text, "proc_label": text.lower(), "seg_id": "s", "act_cat": categories, **seconds}


def test_babel(tmp_path):
    value = {
        "5": {
            "babel_sid": 5,
            "feat_p": "MPIHDM05/MPI_HDM05/dg/HDM_dg_03-11_03_120_poses.npz",
            "dur": 5.4,
            "seq_ann": {"mul_act": True, "labels": [label("Walking about", ["walk"])]},
            "frame_ann": {"labels": [label("turn", ["turn", "spin"], start_t=2.5, end_t=1.0)]},
        },
        "6": {
            "babel_sid": 6,
            "feat_p": "CMU/CMU/01/01_01_poses.npz",
            "dur": 2.0,
            "seq_ann": {"labels": [label("a", ["walk", "run"]), label("b", None)]},
            "frame_ann": None,
        },
        # The extra_ files have several annotators.
        "8": {
            "feat_p": "CMU/CMU/01/01_01_poses.npz",
            "seq_anns": [{"labels": [label("jump", ["jump"])]}, {"labels": [label("jump", ["jump"])]}],
            "frame_anns": None,
        },
    }
    index = read(tmp_path, json.dumps(value), "val.json")
    first, second, extra = index.entries
    assert (index.name, first.name, first.dataset, first.split) == ("babel", "5", "MPI_HDM05", "val")
    assert first.captions == (mk.Caption("Walking about"), mk.Caption("turn", 1.0, 2.5))
    assert (first.action, first.cut) == ("walk", TimeCut(file_seconds=5.4))
    assert (second.action, len(second.captions)) == ("", 2)
    assert (extra.action, extra.captions) == ("jump", (mk.Caption("jump"),))


@pytest.mark.parametrize(
    ("index", "file"),
    [
        ("KIT/3/kick_high_left02_poses.npy", "KIT/3/kick_high_left02_poses.npz"),
        ("KIT/3/kick_high_left02_poses.npy", "smplh/KIT/KIT/3/kick_high_left02_poses.npz"),
        ("CMU/01/01_01_poses.npy", "cmu/01/01_01.amc"),
        ("BioMotionLab_NTroje/rub110/0001_treadmill_fast_poses.npy", "BMLrub/rub110/0001_treadmill_fast_stageii.npz"),
        ("ACCAD/F1_c3d/C19 -  run to hop to walk_poses.npy", "ACCAD/F1_c3d/C19_-__run_to_hop_to_walk_stageii.npz"),
        ("MPI_HDM05/mm/HDM_mm_08-01_01_120_poses.npy", "HDM05/mm/HDM_mm_08-01_01_120_stageii.npz"),
        (
            "Eyes_Japan_Dataset/yamaoka/tennis-15-first service-yamaoka_poses.npy",
            "EyesJapanDataset/yamaoka/tennis-15-first_service-yamaoka_stageii.npz",
        ),
        ("humanact12/humanact12/P11G01R02F1812T1847A0402.npy", "humanact12/P11G01R02F1812T1847A0402.npy"),
    ],
)
def test_spellings_of_one_file(index, file):
    assert file_key(index.split("/")) == file_key(file.split("/"))


# The store keeps numbers on a grid of 2^-22.
STORED = 2.0**-22
TRIMS = {"Eyes_Japan_Dataset": 60, "MPI_HDM05": 60}

# File below AMASS, frames, what it states, its path in the index, published frames; step and true rate, by hand.
CLIPS = (
    ("KIT/3/kick_poses.npz", 500, 100.0, "KIT/3/kick", (3, 63), 5, 100),
    ("SFU/0005/jog_stageii.npz", 700, 120.00004577636719, "SFU/0005/jog", (10, 60), 6, 120),
    ("BMLrub/rub1/walk_stageii.npz", 300, 59.9999885, "BioMotionLab_NTroje/rub1/walk", (5, 105), 2, 60),
    ("EyesJapanDataset/a/b_c-d_stageii.npz", 700, 59.94, "Eyes_Japan_Dataset/a/b  c-d", (5, 105), 2, "60000/1001"),
    ("MPI_HDM05/mm/x_poses.npz", 1000, 150.0, "MPI_HDM05/mm/x", (7, 27), 7, 150),
)


@pytest.fixture(scope="module")
def amass(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("amass")
    rng = np.random.default_rng(0)
    rows = []
    for number, (name, num_frames, stated, indexed, (start, end), _, _) in enumerate(CLIPS):
        time = np.arange(num_frames)[:, None] / stated
        poses = np.zeros((num_frames, 165 if "stageii" in name else 156))
        poses[:, 0] = np.pi / 2
        poses[:, 3:66] = 0.4 * np.sin(time * rng.uniform(1, 5, 63) + rng.uniform(0, 6, 63))
        trans = np.stack((time[:, 0], 0.3 * time[:, 0], np.ones(num_frames)), axis=1)
        if "stageii" in name:
            parts = {"root_orient": poses[:, :3], "pose_body": poses[:, 3:66], "pose_hand": poses[:, 75:]}
            fields = stageii_fields(num_frames, poses=poses, trans=trans, mocap_frame_rate=np.array(stated), **parts)
        else:
            fields = smplh_fields(num_frames, poses=poses, trans=trans, mocap_framerate=np.array(stated))
        write_amass(root / name, fields)
        rows.append(f"./pose_data/{indexed}_poses.npy,{start},{end},{number:06}.npy\n")
    (root / "index.csv").write_text(HEADER + "".join(rows))
    return root


@pytest.fixture(scope="module")
def stores(amass: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[bool, mk.Store]:
    """Native and published clips, mirrored ones among them."""
    found = {}
    for published in (False, True):
        index = IndexOptions((amass / "index.csv",), mirrored=True, published=published)
        path = tmp_path_factory.mktemp("store") / "s"
        report = ingest([amass], path, options=ReadOptions(index=index), num_workers=1)
        assert (report.problems, report.stored.num_rows) == ((), 2 * len(CLIPS))
        found[published] = mk.Store.open(path)
    return found


def whole(amass: Path, name: str) -> mk.Motion:
    return read_amass(SourceItem("amass", amass / name, amass, "whole"), ReadOptions())


@pytest.mark.parametrize("number", range(len(CLIPS)))
def test_native_clips_are_the_files_own_frames(amass, stores, number):
    name, _, stated, indexed, (start, end), step, fps = CLIPS[number]
    clip = stores[False].read(f"humanml3d/{number:06}")
    trim = TRIMS.get(indexed.split("/")[0], 0)
    frames = slice((trim + start) * step, (trim + end) * step)
    file = whole(amass, name)
    assert str(clip.fps) == str(fps)
    assert clip.provenance.stated_fps == str(stated)
    for name in ("joint_positions", "local_rotations", "root_translation"):
        np.testing.assert_allclose(getattr(clip, name), getattr(file, name)[frames], rtol=0, atol=STORED)
    assert clip.num_frames == (end - start) * step


def as_published(amass: Path, name: str, dataset: str, start: int, end: int) -> np.ndarray:
    """The steps of raw_pose_processing.ipynb, word by word, on joints as they stand in AMASS: z up."""
    motion = whole(amass, name)
    x, y, z = np.moveaxis(motion.joint_positions, -1, 0)
    z_up = np.stack((x, -z, y), axis=-1)
    joints = z_up[:: int(float(motion.provenance.stated_fps) / 20)]
    joints = joints @ np.float32([[1, 0, 0], [0, 0, 1], [0, 1, 0]])
    joints = joints[TRIMS.get(dataset, 0) :][start:end].copy()
    joints[..., 0] *= -1
    return joints


@pytest.mark.parametrize("number", range(len(CLIPS)))
def test_published_clips_are_the_notebooks_up_to_the_heading_that_processing_removes(amass, stores, number):
    name, _, _, indexed, (start, end), _, _ = CLIPS[number]
    clip = stores[True].read(f"humanml3d-20fps/{number:06}")
    expected = as_published(amass, name, indexed.split("/")[0], start, end)
    assert (clip.fps, clip.num_frames) == (20, end - start)
    # Both are turns of the file's z-up joints, half a turn about y apart; neither swaps left and right.
    np.testing.assert_allclose(clip.joint_positions, expected * np.float32([-1, 1, -1]), atol=1e-6)
    ours, theirs = (humanml3d.process(joints, "smpl22") for joints in (clip.joint_positions, expected))
    np.testing.assert_allclose(ours, theirs, atol=1e-5)
    left_hip = ours[0, 1] - ours[0, 0]
    assert left_hip[0] > 0  # faces Z+ with its left at X+


def test_published_clips_exported_are_the_published_folder(amass, stores, tmp_path):
    """What the notebooks write from the same joints: names, poses, the 263 numbers."""
    export(Selection(stores[True], stores[True].select(None)), tmp_path / "out", export_kinds()["humanml3d"])
    for number, (name, _, _, indexed, (start, end), _, _) in enumerate(CLIPS):
        raw = as_published(amass, name, indexed.split("/")[0], start, end)
        vectors = humanml3d.vectors(humanml3d.process(raw, "smpl22"), "smpl22")
        written = np.load(tmp_path / f"out/new_joint_vecs/{number:06}.npy")
        assert written.shape == (end - start - 1, 263)
        np.testing.assert_allclose(written, vectors, atol=2e-5)
        assert (tmp_path / f"out/new_joints/M{number:06}.npy").is_file()


def seed_store(tmp_path: Path, source: str, *, mirrored: bool = False) -> tuple[mk.Store, list[str]]:
    options = IndexOptions(
        (tmp_path / "SEED/metadata/seed_metadata_v004.csv",), None, tmp_path / "SEED/splits", mirrored
    )
    report = ingest([tmp_path / source], tmp_path / "store", options=ReadOptions(index=options), overwrite=True)
    return mk.Store.open(tmp_path / "store"), [problem.reason for problem in (*report.problems, *report.warnings)]


def test_bones_seed(tmp_path: Path) -> None:
    """Native framerate, joints, captions with their seconds, Kimodo's splits; the mirrored files only on request."""
    root, world, joints = soma_motion()
    rows = [
        seed_row("walk_001__A001", split="train"),
        seed_row("walk_001__A001_M", split="train"),
        seed_row("walk_002__A001", split="test_repetition", content_natural_desc_4="A person walks forward."),
        seed_row("bow_001__A001", split="test_content", move_soma_uniform_path="", move_soma_proportional_path=""),
    ]
    events = {"walk_001__A001": [{"start_time": 0.0, "end_time": 0.25, "description": "The person starts."}]}
    write_seed(tmp_path / "SEED", rows, events)
    for name in ("walk_001__A001", "walk_001__A001_M", "walk_002__A001"):
        path = tmp_path / f"SEED/soma_uniform/bvh/240101/{name}.bvh"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(soma_bvh(root, world))
    store, reasons = seed_store(tmp_path, "SEED/soma_uniform")
    assert reasons == ["missing-file"]
    assert list(store) == ["seed/walk_001__A001", "seed/walk_002__A001"]
    motion = store["seed/walk_001__A001"]
    assert (motion.fps, motion.split, motion.action, motion.style) == (120, "train", "walking", "neutral")
    assert (motion.provenance.subject, motion.provenance.source, motion.provenance.subset) == (
        *("A001", "seed", "soma_uniform"),
    )
    order = [motion.skeleton.joint_names.index(name) for name in SOMA.joint_names]
    np.testing.assert_allclose(motion.joint_positions[:, order], joints, atol=1e-4)
    assert map_joints(motion, "smpl22").shape == (48, 22, 3)
    assert motion.captions == (
        mk.Caption("A person walks forward."),
        mk.Caption("Someone strolls ahead, relaxed."),
        mk.Caption("walk forward"),
        mk.Caption("The person starts.", 0.0, 0.25),
    )
    assert (store["seed/walk_002__A001"].split, len(store["seed/walk_002__A001"].captions)) == ("val", 3)
    # The robot's table is read where the sources have no other form of the motion; the mirrored file as it is.
    table = tmp_path / "SEED/g1/csv/240101/bow_001__A001.csv"
    table.parent.mkdir(parents=True)
    table.write_text(G1_STANDS)
    store, reasons = seed_store(tmp_path, "SEED", mirrored=True)
    assert not reasons and len(store) == 4
    assert (store["seed/bow_001__A001"].split, store["seed/bow_001__A001"].provenance.subset) == ("test", "g1")
    np.testing.assert_array_equal(store["seed/walk_001__A001_M"].joint_positions, motion.joint_positions)


def test_what_is_wrong_with_bones_seed_is_reported(tmp_path: Path) -> None:
    rows = [seed_row("a", move_soma_uniform_path="", move_soma_proportional_path="", move_g1_path=""), seed_row("b")]
    path = write_seed(tmp_path / "SEED", rows, {"b": [{"start_time": "soon", "end_time": 1, "description": "x"}]})
    index = read_index(path)
    assert [(problem.reason, problem.line) for problem in index.problems] == [("index-entry", 2), ("index-entry", 3)]
    (path.parent / "seed_metadata_v002_temporal_labels.jsonl").write_text('{"filename": "b"}\n')
    assert refusal(read_index, path).reason == "index"
