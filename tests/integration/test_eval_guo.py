"""Guo's evaluator, narrow and with random weights: clip-FID at 20 fps, Table 1 on KIT-ML's 21 joints at 12.5 fps."""

import json
from collections.abc import Callable
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import motionkit as mk
from eval.native_evaluator.evaluator import NativeEvaluator
from eval.tables.nerm import table1
from motionkit.core.skeletons.mapping import rest_positions
from motionkit.features import humanml3d
from motionkit.features.humanml3d import process, standard_bone_lengths
from motionkit.generate.models import GenerationRequest
from motionkit.io.humanml3d import KIT
from tests.helpers.published_guo import GuoWidths, write_archive, write_glove
from tests.helpers.scripted_model import PosesAt, ScriptedModel, install_models, trained_run

TAKES, FPS = 40, Fraction(25, 2)
SMALL = GuoWidths(movement=6, motion=5, text=4, shared=8)
TOKENS = ("a/DET man/NOUN walk/VERB", "a/DET person/NOUN turn/VERB left/ADV", "a/DET man/NOUN walk/VERB slowly/ADV")
LIMBS = [joint for joint, name in enumerate(mk.KIT21.joint_names) if name[1:] in ("E", "W", "K", "A", "Mrot", "F")]


def kit_vectors(take: int) -> np.ndarray:
    """The pose vectors of one take in KIT-ML's unit: a body that walks straight on and sways.

    Only its limbs sway: vectors of a turning trunk do not give back the joints that they were made of.
    """
    rng, num_frames = np.random.default_rng(take), 29 + 4 * (take % 5)
    time = np.arange(num_frames)[:, None, None] / float(FPS)
    body = 1000.0 * rest_positions(mk.KIT21) + np.array([0.0, 560.0, 0.0]) + np.zeros((num_frames, 1, 1))
    body[:, LIMBS] += 60.0 * np.sin(
        2 * np.pi * rng.uniform(0.2, 1, (len(LIMBS), 3)) * time + rng.uniform(0, 6, (len(LIMBS), 3))
    )
    body[..., 2] += 200.0 * rng.uniform(0, 1) * time[..., 0]
    target = 1000.0 * standard_bone_lengths("kit21")
    return humanml3d.vectors(process(body, "kit21", target), "kit21")


@pytest.fixture(scope="module")
def takes() -> list[np.ndarray]:
    return [kit_vectors(take) for take in range(TAKES)]


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory, takes: list[np.ndarray]) -> Path:
    """A folder in KIT-ML's own form."""
    folder = tmp_path_factory.mktemp("kit") / "KIT-ML"
    for name in ("new_joints", "new_joint_vecs", "texts"):
        (folder / name).mkdir(parents=True)
    for take, vectors in enumerate(takes):
        np.save(folder / "new_joint_vecs" / f"{take:05d}.npy", vectors)
        np.save(folder / "new_joints" / f"{take:05d}.npy", humanml3d.positions(vectors, "kit21"))
        line = f"take {take}#{TOKENS[take % 3]}#0.0#0.0\n"
        (folder / "texts" / f"{take:05d}.txt").write_text(line, encoding="utf-8")
    (folder / "test.txt").write_text("".join(f"{take:05d}\n" for take in range(TAKES)), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[object, ...]:
    """Narrow networks of 247 numbers in with random weights, and the statistics that belong to KIT's."""
    folder = tmp_path_factory.mktemp("published")
    weights = write_archive(folder / "kit", SMALL, num_inputs=247)
    return ("--evaluator", "guo", "--weights", weights, "--glove", write_glove(folder / "glove"))


def rows_of(outcome: Any, title: str = "Table 1: guo") -> dict[str, dict[str, Any]]:
    blocks = [each for each in json.loads(outcome.stdout)["blocks"] if "differences" not in each["title"]]
    (block,) = [each for each in blocks if each["title"].startswith(title)]
    return {row["name"]: row for row in block["rows"]}


def write_samples(root: Path, takes: list[np.ndarray]) -> dict[str, Path]:
    """The takes as folders of pose vectors, of joints in metres, and as one file of MDM's."""
    folders = {name: root / name for name in ("vectors", "mdm", "metres")}
    for name, stated in (
        ("vectors", 'statistics = "raw"'),
        ("mdm", f"fps = 12.5\nunit_metres = {KIT.unit_metres}"),
        ("metres", "fps = 12.5"),
    ):
        folders[name].mkdir()
        (folders[name] / "samples.toml").write_text(stated + "\n", encoding="utf-8")
    captions = "file,caption\n" + "".join(f"{take:05d}.npy,take {take}\n" for take in range(TAKES))
    longest = max(map(len, takes))
    batch = np.zeros((TAKES, 21, 3, longest), np.float32)
    for take, vectors in enumerate(takes):
        joints = humanml3d.positions(vectors, "kit21")
        batch[take, :, :, : len(joints)] = joints.transpose(1, 2, 0)
        np.save(folders["vectors"] / f"{take:05d}.npy", vectors)
        np.save(folders["metres"] / f"{take:05d}.npy", joints * np.float32(KIT.unit_metres))
    for name in ("vectors", "metres"):
        (folders[name] / "captions.csv").write_text(captions, encoding="utf-8")
    np.savez(
        folders["mdm"] / "results.npz",
        motion=batch,
        lengths=np.array([len(vectors) for vectors in takes]),
        text=np.array([f"take {take}" for take in range(TAKES)]),
    )
    return folders


def test_kit_reaches_its_evaluator_as_21_joints_and_as_vectors(
    motionkit: Callable[..., Any],
    published: Path,
    takes: list[np.ndarray],
    files: tuple[object, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    store = tmp_path / "store"
    assert motionkit("ingest", published, "--store", store).code == 0
    folders = write_samples(tmp_path, takes)
    samples = [part for name, folder in folders.items() for part in ("--samples", f"{name}={folder}")]
    table = ("eval", "--table", 1, "--store", store, "--results", tmp_path / "results", "--protocol", "t2m", *files)
    outcome = motionkit(*table, *samples, "--json")
    assert outcome.code == 0, outcome.stderr
    rows = rows_of(outcome)
    assert "as the pose vectors that they came as" in rows["vectors"]["note"]
    assert "KIT-ML's joints as they came" in rows["mdm"]["note"] and "KIT-ML's joints" in rows["metres"]["note"]
    for column, cell in rows["mdm"]["cells"].items():
        assert rows["metres"]["cells"][column]["value"] == pytest.approx(cell["value"], rel=1e-4, abs=1e-5), column
        # Vectors have one frame more than those made of the joints that they give.
        assert rows["vectors"]["cells"][column]["value"] == pytest.approx(cell["value"], rel=0.05, abs=0.02), column
        assert rows["real"]["cells"][column]["value"] == pytest.approx(cell["value"], rel=1e-4, abs=1e-5), column
    assert list(json.loads(outcome.stdout)["definition"]["real_motions"]) == ["guo"]
    assert "Printed in the NeRM paper (KIT)" in outcome.stdout

    def listens(request: GenerationRequest, chance: tuple[int, int]) -> PosesAt:
        return partial(walking, take=int(request.text.split()[-1]))

    trained_run(tmp_path / "runs" / "nano")
    install_models(monkeypatch, lambda run: ScriptedModel(listens, 20.0))
    monkeypatch.setattr(table1, "load_evaluator", lambda run, stage: Lengths())
    both = motionkit(
        *table, "--evaluator", "native,guo", "--fps", 12.5, "--motions", 32, "--runs", tmp_path / "runs", "--json"
    )
    assert both.code == 0, both.stderr
    made = rows_of(both)["NeRM"]
    assert "its 21 joints made of 22, with the real motions' bone lengths" in made["note"]
    assert made["cells"]["FID ↓"]["value"] > rows["real"]["cells"]["FID ↓"]["value"]
    # The same store at 12.5 fps as 22 joints, for an evaluator that reads these.
    assert rows_of(both, "Table 1: lengths")["real"]["cells"]["N"]["value"] == 32
    compared = json.loads(both.stdout)["definition"]["real_motions"]
    assert {name: each["layout"] for name, each in compared.items()} == {"lengths": "smpl22", "guo": "kit21"}


def walking(times_seconds: np.ndarray, take: int) -> np.ndarray:
    """22 joints that walk straight on."""
    body = rest_positions(mk.SMPL22) + np.array([0.0, 0.95, 0.0]) + np.zeros((len(times_seconds), 1, 1))
    body[:, 4:] += 0.02 * np.sin((take + 1) * times_seconds)[:, None, None]
    body[..., 2] += 0.4 * times_seconds[:, None]
    return body.astype(np.float32)


class Lengths(NativeEvaluator):
    """An evaluator of 22 joints that sees how long a motion is and how far it goes."""

    name, fingerprint, pair_score = "lengths", "1", ""

    def __init__(self) -> None: ...

    def remark_at(self, fps: Fraction) -> str:
        return ""

    def embed_motions(self, samples: Any) -> np.ndarray:
        assert samples.sequences.values.shape[1] == 22
        return np.array([[len(one), float(one[-1, 0, 2]), float(one[:, 20, 1].std())] for one in samples.sequences])

    def embed_texts(self, captions: Any) -> np.ndarray:
        return np.zeros((len(captions), 3))


CLIPS = ("--clips", 64, "--replications", 1, "--sizes", "16:16")


def swaying(seed: int, num_frames: int, fps: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    time = np.arange(num_frames)[:, None, None] / fps
    sway = 0.1 * np.sin(2 * np.pi * rng.uniform(0.3, 2, (22, 3)) * time + rng.uniform(0, 6, (22, 3)))
    return (rest_positions(mk.SMPL22) + sway + [0, 0.95, 0]).astype(np.float32)


@pytest.fixture(scope="module")
def swaying_store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("guo") / "store"
    with mk.StoreWriter.create(path) as writer:
        for index in range(8):
            grid = mk.TimeGrid(Fraction(40), 160)
            positions, split = swaying(index, 160, 40), ("train", "test")[index % 2]
            writer.add(
                mk.Motion(
                    joint_positions=positions, skeleton=mk.SMPL22, timegrid=grid, split=split, sequence_id=f"m{index}"
                )
            )
    return path


@pytest.fixture(scope="module")
def t2m_weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_archive(tmp_path_factory.mktemp("published") / "t2m", SMALL)


def block(outcome: Any, title: str = "") -> dict[str, Any]:
    blocks = [each for each in json.loads(outcome.stdout)["blocks"] if "differences" not in each["title"]]
    found = [each for each in blocks if "guo" in each["title"] and title in each["title"]]
    assert len(found) == 1
    return dict(found[0])


def test_a_column_at_20_fps_and_none_elsewhere(motionkit, swaying_store, t2m_weights, tmp_path):
    table = (
        "eval",
        "--table",
        2,
        "--store",
        swaying_store,
        "--results",
        tmp_path,
        "--evaluator",
        "guo",
        "--weights",
        t2m_weights,
    )
    outcome = motionkit(*table, *CLIPS, "--fps", "20,40", "--json")
    assert outcome.code == 0, outcome.stderr
    found = block(outcome)
    assert found["title"] == "clip-FID on the guo evaluator of HumanML3D"
    for row in found["rows"]:
        assert list(row["cells"]) == ["20 fps"] and row["cells"]["20 fps"]["value"] >= 0
    assert {"real, independent draws (P1)", "real kept at 20 fps, SLERP"} <= {row["name"] for row in found["rows"]}
    missing = json.loads(outcome.stdout)["missing"]
    assert any("40 fps, guo" in line and "was trained at 20 fps" in line for line in missing)
