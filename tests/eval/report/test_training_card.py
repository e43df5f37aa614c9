"""A run in the report: its stages with what they were made from, and what was logged over the steps."""

from pathlib import Path

import pytest

from eval.report.render import origin_line
from eval.report.results import Result, environment
from eval.report.training import run_card, stages_of, training_figure
from motionkit.core.files import write_json
from motionkit.training.run import RunError, RunFolder


def write_stage(run: Path, name: str, losses: list[float]) -> None:
    stage = RunFolder(run).stage(name)
    stage.path.mkdir(parents=True)
    write_json(
        stage.config_path, {"stage": name, "recipe": "nano", "store_fingerprint": "ab" * 32, "commit": "cd" * 20}
    )
    for number, loss in enumerate(losses):
        stage.append_metrics({"step": 50.0 * (number + 1), "seconds": 1.0, "loss": loss, "kl": 0.0})
    if name == "field":
        stage.finish({"steps": 1234, "parameters": 56789, "cpu_seconds": 12.0})


def test_a_run_shows_its_stages_and_losses(tmp_path: Path) -> None:
    write_stage(tmp_path / "nano", "field", [0.5, 0.25])
    write_stage(tmp_path / "nano", "denoiser", [])
    denoiser, field = stages_of(tmp_path / "nano")
    assert denoiser.facts["steps"] == "not finished"
    assert [field.facts[each] for each in ("steps", "parameters", "store", "commit")] == [
        *("1,234", "56,789"),
        *("ab" * 6, "cd" * 6),
    ]
    figure = training_figure([denoiser, field])
    assert figure is not None
    (axes,) = figure.axes
    loss = axes.lines[0]
    assert loss.get_label() == "loss"
    assert (list(loss.get_xdata()), list(loss.get_ydata())) == ([50.0, 100.0], [0.5, 0.25])
    page = run_card(tmp_path / "nano", [("a <person>", '<p title="x">')])
    assert "data:image/png;base64," in page and "a &lt;person&gt;" in page and 'srcdoc="&lt;p title=&#34;x&#34;' in page
    with pytest.raises(RunError, match="holds no trained stage"):
        run_card(tmp_path / "none")


def test_a_result_says_its_command_without_folders_of_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    words = ["/usr/bin/motionkit", "eval", "--store", "/home/someone/store", "--samples", "My model=/data/mine"]
    monkeypatch.setattr("sys.argv", words)
    found = environment()
    assert found["command"] == "motionkit eval --store store --samples 'My model=mine'"
    result = Result("t", "1", "T", "", (), provenance={"environment": {**found, "commit": None}})
    assert origin_line(result).startswith("by motionkit eval --store store --samples 'My model=mine', on 20")
    assert origin_line(Result("t", "1", "T", "", ())) == ""
