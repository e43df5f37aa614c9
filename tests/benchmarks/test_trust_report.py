"""The drill's report: what it counts, prints and keeps, and its exit code."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks.trust import __main__ as drill
from benchmarks.trust.report import Case, Report, print_report, store_report

GOOD = Case("append", 3, figures={"longest": 1.25})
BAD = Case("compact", 2, ("killed before operation 7: [lost]",))
SKIPPED = Case("full disk", 0, skipped="needs root")


def report(*cases: Case, part: str = "crash") -> Report:
    return Report(part, 5, 1.5, cases, {"commit": None})


def test_counts_are_sums() -> None:
    whole = report(GOOD, BAD, SKIPPED)
    assert whole.tried == 5
    assert whole.failures == ("compact: killed before operation 7: [lost]",)
    assert whole.plain()["failed"] == 1


def test_everything_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    print_report(report(GOOD, BAD, SKIPPED))
    printed = capsys.readouterr().out
    for text in ("crash, seed 5", "longest 1.25", "skipped: needs root", "compact: killed before operation 7: [lost]"):
        assert text in printed


def test_parts_are_collected_in_one_file(tmp_path: Path) -> None:
    path = tmp_path / "results" / "reliability.json"
    store_report(report(GOOD, part="load"), path)
    store_report(report(BAD), path)
    store_report(report(GOOD), path)
    stored = json.loads(path.read_text())
    assert list(stored) == ["crash", "load"]
    assert stored["crash"]["tried"] == 3


@pytest.mark.parametrize(("case", "code"), [(GOOD, 0), (BAD, 1)])
def test_the_exit_code_says_whether_anything_failed(
    case: Case, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def run(seed: int, seconds: float, folder: Path) -> Report:
        assert (seed, seconds, folder.is_dir()) == (5, 60.0, True)
        return report(case)

    monkeypatch.setattr(
        drill, "importlib", SimpleNamespace(import_module=lambda name: SimpleNamespace(run=run, DEFAULT_SECONDS=60.0))
    )
    monkeypatch.setattr(sys, "argv", ["trust", "crash", "--seed", "5", "--json", "--out", str(tmp_path / "all.json")])
    with pytest.raises(SystemExit) as ended:
        drill.main()
    assert ended.value.code == code
    assert json.loads(capsys.readouterr().out)["tried"] == case.tried
    assert json.loads((tmp_path / "all.json").read_text())["crash"]["cases"][0]["name"] == case.name
