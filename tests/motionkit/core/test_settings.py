from pathlib import Path

import pytest

from motionkit.core.errors import UsageError
from motionkit.core.settings import default_path, optional_path


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for key in ("STORE", "RUNS", "RESULTS", "BODY_MODELS"):
        monkeypatch.delenv(f"MOTIONKIT_{key}", raising=False)
    return tmp_path


def test_the_environment_goes_before_the_file_and_the_file_before_the_name(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert default_path("store") == Path("store")
    (folder / "motionkit.toml").write_text('store = "/data/store"\n')
    assert default_path("store") == Path("/data/store")
    assert default_path("runs") == Path("runs")
    monkeypatch.setenv("MOTIONKIT_STORE", "/scratch/store")
    assert default_path("store") == Path("/scratch/store")


def test_body_models_have_no_default(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert optional_path("body_models") is None
    (folder / "motionkit.toml").write_text('body_models = "/data/models"\n')
    assert optional_path("body_models") == Path("/data/models")
    monkeypatch.setenv("MOTIONKIT_BODY_MODELS", "/scratch/models")
    assert optional_path("body_models") == Path("/scratch/models")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"store = /data", r"motionkit\.toml: Invalid value"),
        (b"store = 7", "store must be a path in quotes, not 7"),
        (b'store = "a\\u0000b"', "store must be a path in quotes, not 'a"),
        (b'store = "caf\xe9"', r"motionkit\.toml: 'utf-8' codec"),
    ],
)
def test_a_file_that_says_no_path_is_refused(folder: Path, content: bytes, says: str) -> None:
    (folder / "motionkit.toml").write_bytes(content)
    with pytest.raises(UsageError, match=says):
        default_path("store")
