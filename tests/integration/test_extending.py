"""The package of docs/extending.md, installed and run as it is printed there."""

import json
import re
import tomllib
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.io import registry
from tests.helpers.outcome import Outcome
from tests.helpers.repository import REPOSITORY

Run = Callable[..., Outcome]
PAGE = (REPOSITORY / "docs" / "extending.md").read_text(encoding="utf-8")
NAMED_BLOCK = re.compile(r"^```\w+\n# (?P<path>[\w/]+\.(?:py|toml))\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder on sys.path that holds the package and the metadata that an installer would write."""
    folder = tmp_path_factory.mktemp("site")
    files = {found["path"]: found["text"] for found in NAMED_BLOCK.finditer(PAGE)}
    project = tomllib.loads(files.pop("pyproject.toml"))["project"]
    metadata = f"{project['name']}-{project['version']}.dist-info"
    files[f"{metadata}/METADATA"] = f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    files[f"{metadata}/entry_points.txt"] = "\n".join(
        "\n".join((f"[{group}]", *(f"{name} = {value}" for name, value in entries.items())))
        for group, entries in project["entry-points"].items()
    )
    for path, text in files.items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")
    (folder / "standstill" / "__init__.py").touch()
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        registry.formats.cache_clear()
        yield folder
    registry.formats.cache_clear()


@pytest.fixture(autouse=True)
def here(site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def write_store(path: str, rates: tuple[int, ...], num_frames: int, swing_metres: float) -> None:
    """A body of 1.7 m that stands and sways."""
    rng = np.random.default_rng(0)
    body = np.concatenate((rng.normal(0, 0.3, (22, 1)), np.linspace(0, 1.7, 22)[:, None], np.zeros((22, 1))), axis=1)
    with mk.StoreWriter.create(path) as writer:
        for index, fps in enumerate(rates):
            grid = mk.TimeGrid(Fraction(fps), num_frames)
            rate, phase = rng.uniform(0.5, 2, (22, 3)), rng.uniform(0, 6, (22, 3))
            swing = swing_metres * np.sin(2 * np.pi * rate * grid.seconds()[:, None, None] + phase)
            split, name = ("train", "test")[index % 2], f"take-{index}"
            writer.add(mk.Motion((body + swing).astype(np.float32), mk.SMPL22, grid, split=split, sequence_id=name))


def test_its_model_is_trained_loaded_and_has_its_row_in_table_2(motionkit: Run) -> None:
    assert "standing-height" in motionkit("--help").stdout
    write_store("store", (30, 120), 40, 0.0)
    train = ("train", "--stage", "standstill", "--run", "idle", "--set", "stride=4", "--json")
    trained = motionkit(*train)
    assert trained.code == 0, trained.stderr
    assert json.loads(trained.stdout)["stages"] == [{"stage": "standstill", "poses": 10}]
    said = json.loads(motionkit("standing-height", "runs/idle", "--json").stdout)
    assert said["height_metres"] == pytest.approx(1.7, abs=1e-5)
    (example,) = re.findall(r"```python\n(import motionkit as mk\n.*?)```", PAGE, re.DOTALL)
    names: dict[str, object] = {}
    exec(example, names)
    assert "MotionModel('standing still', 'runs/idle', 22 joints" in repr(names["model"])
    assert "120 frames at 60 fps = 2.00 s" in repr(names["motion"])
    write_store("moving", (60,) * 12, 300, 0.05)
    built = motionkit(
        *("eval", "--table", "2", "--store", "moving", "--run", "idle", "--fps", "20,60", "--json"),
        *("--clips", "128", "--replications", "2", "--evaluator", "kinematic"),
    )
    assert built.code == 0, built.stderr
    result = json.loads(built.stdout)
    rows = {row["name"]: row["cells"] for row in result["blocks"][0]["rows"]}
    assert set(rows["standing still"]) == {"20 fps", "60 fps"}
    assert "standing still generated at 20 fps, SLERP" in rows and not any("NeRM" in name for name in rows)
    # Who stands still is far from who moves.
    floor = rows["real, independent draws (P1)"]["60 fps"]["value"]
    assert rows["standing still"]["60 fps"]["value"] > 10 * floor
    assert rows["standing still"]["60 fps"]["details"]["motions"] == 6
    assert any("NeRM" in line and "motionkit train" in line for line in result["missing"])


def test_a_format_of_one_file_is_read_ingested_and_exported(motionkit: Run) -> None:
    """And completed, viewed, written by suffix, with no other change than the package that is installed."""
    rng = np.random.default_rng(2)
    body = np.linspace(0.1, 1.7, 66) + rng.normal(0, 0.02, (10, 66)).cumsum(axis=0)
    take = Path("in/take.xyz")
    take.parent.mkdir()
    take.write_text("fps 30\n" + "".join(" ".join(f"{value:.6f}" for value in row) + "\n" for row in body))
    motion = mk.read(take)
    assert (motion.fps, motion.num_frames) == (30, 10)
    motion.save("again.xyz")
    assert Path("again.xyz").read_text() == take.read_text()
    made = mk.complete(take, fps=60, model="spline")
    assert made.num_frames == 19
    made.resample(30).save("in/second.xyz")
    assert mk.view("in", path="page.html").name == "page.html"
    assert motionkit("ingest", "in").code == 0
    exported = motionkit("export", "out", "--format", "xyz", "--json")
    assert exported.code == 0, exported.stderr
    assert json.loads(exported.stdout)["num_sequences"] == 2
    rows = [np.loadtxt(each, skiprows=1) for each in (take, "out/in/take.xyz")]
    np.testing.assert_allclose(rows[0], rows[1], atol=2e-6)
    Path("in/broken.xyz").write_text("fps 30\n1 2 3\n")
    broken = motionkit("ingest", "in", "--store", "another")
    assert "broken.xyz" in broken.stderr and "expected 'fps'" in broken.stderr
