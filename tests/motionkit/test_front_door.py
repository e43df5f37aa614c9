"""Names that packages give without having imported them: quick to import known to type checkers, never a module."""

import pickle
import subprocess
import sys
from types import ModuleType

import pytest

import eval
import motionkit

HEAVY = ("torch", "pyarrow", "pandas", "numpy", "scipy", "duckdb", "matplotlib")


def run(script: str) -> str:
    """What a fresh interpreter prints."""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.parametrize("package", ["motionkit", "eval"])
def test_importing_loads_nothing_heavy(package: str) -> None:
    seen = f"print(*sorted(set(sys.modules) & set({HEAVY!r})))"
    assert run(f"import sys, {package}; dir({package}); {seen}") == ""
    assert "numpy" in run(f"import sys, {package}; {package}.{motionkit_or_eval(package)}; {seen}")


def motionkit_or_eval(package: str) -> str:
    return {"motionkit": "Motion", "eval": "clip_fid"}[package]


@pytest.mark.parametrize("package", [motionkit, eval], ids=lambda package: package.__name__)
def test_every_name_is_there_and_documented(package: ModuleType) -> None:
    for name in set(package.__all__) - {"__version__", "SMPL22", "KIT21"}:
        assert not isinstance(getattr(package, name), ModuleType), name
        assert getattr(package, name).__doc__, name


@pytest.mark.parametrize(
    "first", ["import motionkit.generate.output", "from motionkit.generate import output", "import motionkit as mk"]
)
def test_a_function_is_never_the_subpackage_of_its_name(first: str) -> None:
    script = "import motionkit as mk; print(callable(mk.generate), callable(mk.resample))"
    again = "; from motionkit.generate import output; from motionkit.fields.resample import resample; "
    assert run(f"{first}; {script}{again}{script}").split() == ["True"] * 4


def test_clip_fid_is_a_function_beside_its_package() -> None:
    script = "import eval.clip_fid.score; from eval import clip_fid; from eval.clip_fid import descriptor; "
    assert run(f"{script}print(callable(clip_fid), descriptor.__name__)") == "True eval.clip_fid.descriptor"


def test_everything_can_be_imported_at_once() -> None:
    assert run("from motionkit import *; print(Motion.__name__, callable(read), __version__)") == (
        f"Motion True {motionkit.__version__}"
    )


def test_a_function_that_uses_the_package_can_be_sent_to_a_worker() -> None:
    assert pickle.loads(pickle.dumps(motionkit)) is motionkit  # noqa: S301
