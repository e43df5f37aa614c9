import errno
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.core import files
from nerm.codebook import vectors
from nerm.codebook.vectors import open_vectors, prepare_vectors, remove_vectors, table_of
from nerm.settings import CodebookConfig
from tests.helpers.nerm_corpus import analytic_source

SMALL = CodebookConfig(window_frames=16)


def _prepare(path: Path) -> np.ndarray:
    prepare_vectors(analytic_source(), SMALL, path)
    return np.array(open_vectors(SMALL, path).vectors)


def test_vectors_that_are_whole_are_used_again(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    path = tmp_path / "vectors.f32"
    expected = _prepare(path)
    before = path.stat().st_ino
    np.testing.assert_array_equal(_prepare(path), expected)
    assert path.stat().st_ino == before
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["vectors.f32", "vectors.json"]
    assert not recwarn.list


@pytest.mark.parametrize("damage", ["zeros", "cut", "gone", "table", "table cut", "old table"])
def test_damaged_vectors_are_made_again_and_that_is_said(
    damage: str, tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    path = tmp_path / "vectors.f32"
    expected = _prepare(path)
    content, table = path.read_bytes(), table_of(path).read_text()
    if damage == "zeros":
        path.write_bytes(content[:4096] + bytes(4096) + content[8192:])
    elif damage == "cut":
        path.write_bytes(content[:-4])
    elif damage == "gone":
        path.unlink()
    elif damage == "table":
        table_of(path).write_text(table.replace("80", "70", 1))
    elif damage == "table cut":
        table_of(path).write_text(table[: len(table) // 2])
    else:
        table_of(path).write_text("[80, 80, 80, 80]")
    np.testing.assert_array_equal(_prepare(path), expected)
    assert path.read_bytes() == content
    assert any("vectors.f32 is made again" in str(each.message) for each in recwarn)


def test_stopped_before_any_step_of_its_end_a_stage_finds_its_vectors_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "vectors.f32"
    expected = _prepare(path)
    unlink = Path.unlink
    for stopped_at in range(2):
        left = [stopped_at]

        def unlinking(self: Path, missing_ok: bool = False, left: list[int] = left) -> None:
            if not left[0]:
                raise KeyboardInterrupt
            left[0] -= 1
            unlink(self, missing_ok)

        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            patch.setattr(Path, "unlink", unlinking)
            remove_vectors(path)
        np.testing.assert_array_equal(_prepare(path), expected)
    remove_vectors(path)
    assert not list(tmp_path.iterdir())


def test_a_disk_that_fills_while_the_table_is_written_leaves_nothing_that_stops_the_next_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "vectors.f32"

    def full(target: Path, document: object) -> None:
        with files.whole_file(target) as temporary:
            temporary.write_text("{")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch, pytest.raises(OSError, match=r"No space left.*vectors\.json"):
        patch.setattr(vectors, "write_json", full)
        _prepare(path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["vectors.f32"]
    _prepare(path)


def test_other_settings_than_the_table_s_find_their_own_starts(tmp_path: Path) -> None:
    path = tmp_path / "vectors.f32"
    _prepare(path)
    shorter = open_vectors(replace(SMALL, window_frames=8), path)
    assert len(shorter.first_rows) == 4 * (80 - 8 + 1)
