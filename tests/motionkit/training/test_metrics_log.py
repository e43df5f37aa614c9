import json
from pathlib import Path
from typing import Any

import pytest

from motionkit.core.errors import DamagedFileError
from motionkit.training.metrics_log import NOTHING_LOGGED, MetricsLog
from motionkit.training.run import StageFolder


def _logged(path: Path, steps: int) -> MetricsLog:
    log = MetricsLog(path)
    for step in range(1, steps + 1):
        log.append({"step": float(step), "loss": 1 / step})
    return log


def test_lines_come_back_without_one_that_was_cut_off(tmp_path: Path) -> None:
    log = MetricsLog(tmp_path / "metrics.jsonl")
    assert log.lines() == []
    _logged(log.path, 2)
    with log.path.open("a") as file:
        file.write('{"step": 3.0, "lo')
    assert [line["step"] for line in log.lines()] == [1, 2]


def test_what_was_logged_after_a_checkpoint_is_cut_off(tmp_path: Path) -> None:
    log = _logged(tmp_path / "metrics.jsonl", 2)
    extent, whole = log.extent(), log.path.read_bytes()
    _logged(log.path, 3)
    log.cut(extent)
    assert log.path.read_bytes() == whole
    log.cut(NOTHING_LOGGED)
    assert log.path.read_bytes() == b""


def test_a_log_with_another_byte_is_not_gone_on_with(tmp_path: Path) -> None:
    log = _logged(tmp_path / "metrics.jsonl", 2)
    extent, whole = log.extent(), log.path.read_bytes()
    for place in range(len(whole)):
        log.path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(DamagedFileError, match=r"metrics\.jsonl is damaged .*--overwrite"):
            log.cut(extent)
    log.path.write_bytes(whole[:-1])
    with pytest.raises(DamagedFileError, match=f"has {len(whole) - 1} bytes, expected {len(whole)}"):
        log.cut(extent)
    log.path.unlink()
    with pytest.raises(DamagedFileError, match="it is missing"):
        log.cut(extent)


def test_checkpoints_of_before_know_their_lines_by_the_step(tmp_path: Path) -> None:
    log = _logged(tmp_path / "metrics.jsonl", 2)
    whole = log.path.read_bytes()
    with log.path.open("a") as file:
        file.write(json.dumps({"step": 4.0}) + '\n{"step": 5.0, "lo')
    log.cut(log.extent_until(3))
    assert log.path.read_bytes() == whole


def test_readers_of_a_complete_stage_notice_another_byte_in_its_log(tmp_path: Path) -> None:
    folder = StageFolder(tmp_path / "field")
    folder.path.mkdir()
    _logged(folder.metrics_path, 2)
    folder.finish({"loss": 0.5})
    assert folder.read_summary() == {"loss": 0.5}
    assert len(folder.read_metrics()) == 2
    folder.metrics_path.write_bytes(folder.metrics_path.read_bytes().replace(b"0.5", b"0.7"))
    with pytest.raises(DamagedFileError, match=r"metrics\.jsonl"):
        folder.read_metrics()
    with pytest.raises(DamagedFileError, match=r"metrics\.jsonl"):
        folder.read_summary()


@pytest.mark.parametrize("extent", ["all", {}, {"bytes": "9" * 5000}, [1], {"bytes": -1, "sha256": ""}])
def test_a_record_that_is_none_is_damage(extent: Any, tmp_path: Path) -> None:
    log = _logged(tmp_path / "metrics.jsonl", 2)
    whole = log.path.read_bytes()
    with pytest.raises(DamagedFileError, match=r"metrics\.jsonl"):
        log.cut(extent)
    assert log.path.read_bytes() == whole


def test_lines_that_hold_no_numbers_are_left_out(tmp_path: Path) -> None:
    log = _logged(tmp_path / "metrics.jsonl", 1)
    with log.path.open("a") as file:
        for line in ("[" * 100_000, '{"step": "1"}', '{"step": 2, "loss": []}', f'{{"step": {"9" * 5000}}}', "7"):
            file.write(line + "\n")
    _logged(log.path, 2)
    assert [line["step"] for line in log.lines()] == [1, 1, 2]
