"""What is said of threads, disks and extras, for machines of every kind."""

from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

from motionkit.doctor import machine


@pytest.mark.parametrize(("content", "expected"), [("150000 100000", 1.5), ("50000 100000", 0.5)])
def test_a_containers_quota_counts(tmp_path: Path, content: str, expected: float) -> None:
    quota = tmp_path / "cpu.max"
    quota.write_text(content + "\n")
    assert machine.usable_processors(quota) == min(machine.usable_processors(tmp_path / "none"), expected)


@pytest.mark.parametrize("content", ["max 100000", "", "1 0", "caf\xe9"])
def test_no_quota_is_all_processors(tmp_path: Path, content: str) -> None:
    quota = tmp_path / "cpu.max"
    quota.write_text(content, encoding="latin-1")
    assert machine.usable_processors(quota) == machine.usable_processors(tmp_path / "none") >= 1


def test_more_threads_than_processors_is_a_problem_with_its_remedy() -> None:
    (found,) = machine.thread_findings({}, 8, 2.5)
    assert found.state == "problem" and found.remedy.startswith("export OMP_NUM_THREADS=2:")
    assert [each.state for each in machine.thread_findings({"OMP_NUM_THREADS": "1"}, 1, 0.5)] == ["good"]
    assert [each.state for each in machine.thread_findings({}, 2, 2.0)] == ["good"]


def test_full_and_closed_disks_are_problems(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MOTIONKIT_CACHE", str(tmp_path / "cache"))
    places = (tmp_path / "not" / "yet" / "there", tmp_path)
    assert {each.state for each in machine.disk_findings(*places)} == {"good"}
    monkeypatch.setattr(machine, "LEAST_FREE_BYTES", 2**80)
    full = list(machine.disk_findings(*places))
    assert [each.remedy.rpartition(" ")[2] for each in full] == ["--store", "--runs", "MOTIONKIT_CACHE"]
    monkeypatch.setattr(machine.os, "access", lambda path, mode: False)
    closed = list(machine.disk_findings(*places))
    assert all(each.state == "problem" and f"{tmp_path} may not be written to" in each.fact for each in closed)
    assert "MOTIONKIT_CACHE" in closed[0].remedy, "a store that is only read needs a place for its caches"


def test_an_extra_that_lacks_a_package_is_named_with_its_installation(monkeypatch: pytest.MonkeyPatch) -> None:
    def version(name: str) -> str:
        if name == "absent-one":
            raise PackageNotFoundError
        return "2.0"

    declared = ["numpy>=2", 'here[more]>=1; extra == "good"', "absent-one>=1 ; extra == 'bad'", 'x; extra == "dev"']
    monkeypatch.setattr(machine, "requires", lambda name: declared)
    monkeypatch.setattr(machine, "version", version)
    good, bad = machine.extra_findings()
    assert (good.state, good.fact) == ("good", "good: here 2.0")
    assert bad.state == "note" and "absent-one" in bad.fact and "'.[bad]'" in bad.remedy
