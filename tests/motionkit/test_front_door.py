"""Names that packages give without having imported them: quick to import, never a module; and what commands load."""

import pickle
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import eval
import motionkit
from motionkit.store.ingest import ingest
from tests.helpers.format_samples import bvh_text


def run(script: str, folder: Path | None = None) -> str:
    """What a fresh interpreter prints."""
    done = subprocess.run([sys.executable, "-c", script], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


MOST = "torch pandas scipy matplotlib pyarrow duckdb sklearn transformers rich.progress"
APP = "from motionkit.cli.app import build_app; build_app()({!r}, standalone_mode=False)"
INGEST = "from pathlib import Path; from motionkit.store.ingest import ingest; "
INSTALLED = "from motionkit.core.plugins import names; from motionkit.generate.models import installed_models; "
# A script, a word that it prints, and modules that it does not load.
LIGHT = {
    "motionkit": ("import motionkit; print(dir(motionkit))", "read_all", f"numpy {MOST}"),
    "eval": ("import eval; print(dir(eval))", "clip_fid", f"numpy {MOST}"),
    "help": (APP.format(["--help"]), "Usage", f"numpy {MOST}"),
    "help of train": (APP.format(["train", "--help"]), "--overwrite", f"numpy {MOST}"),
    "what is installed": (f"{INSTALLED}print(*names('STAGES'), *names('TABLES'), *installed_models())", "nerm-2", MOST),
    "a summary": (APP.format(["info", "store", "--json"]), '"num_sequences": 1', "jaxtyping pandas torch scipy"),
    "an ingest by one worker": (
        f"{INGEST}print(ingest([Path('takes')], Path('new'), num_workers=1).num_in_store)",
        "1",
        "scipy duckdb torch multiprocessing motionkit.io.amass",
    ),
}


@pytest.mark.parametrize("name", LIGHT)
def test_what_is_asked_often_loads_nothing_heavy(name: str, tmp_path: Path) -> None:
    (tmp_path / "takes").mkdir()
    (tmp_path / "takes" / "walk.bvh").write_text(bvh_text())
    ingest([tmp_path / "takes"], tmp_path / "store", num_workers=1)
    script, printed, heavy = LIGHT[name]
    *lines, loaded = run(f"{script}\nimport sys; print('loaded:', *sys.modules)", tmp_path).splitlines()
    assert printed in "\n".join(lines)
    assert set(loaded.split()) & set(heavy.split()) == set()
    assert {"motionkit", "eval"} & set(loaded.split())


@pytest.mark.parametrize("package", [motionkit, eval], ids=lambda package: package.__name__)
def test_every_name_is_there_and_documented(package: ModuleType) -> None:
    for name in set(package.__all__) - {"__version__", "SMPL22", "KIT21"}:
        assert not isinstance(getattr(package, name), ModuleType), name
        assert getattr(package, name).__doc__, name


FUNCTIONS = "import motionkit as mk; print(callable(mk.generate), callable(mk.resample))"


@pytest.mark.parametrize(
    "script",
    [
        f"import motionkit.generate.output; {FUNCTIONS}",
        f"from motionkit.generate import output; from motionkit.fields.resample import resample; {FUNCTIONS}",
        "import eval.clip_fid.score; from eval import clip_fid; print(callable(clip_fid))",
        "from motionkit import *; print(Motion.__name__ == 'Motion', callable(read))",
    ],
)
def test_a_function_is_never_the_subpackage_of_its_name(script: str) -> None:
    assert set(run(script).split()) == {"True"}


def test_a_function_that_uses_the_package_can_be_sent_to_a_worker() -> None:
    assert pickle.loads(pickle.dumps(motionkit)) is motionkit  # noqa: S301
