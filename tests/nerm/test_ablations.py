"""Every row of the paper's ablation tables is a value of the configuration, and trains."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import torch

from eval.reported import reported_figures
from motionkit.clips import WindowPoses
from motionkit.errors import UsageError
from motionkit.skeleton import SMPL22
from motionkit.training.config import apply_overrides
from motionkit.training.randomness import step_generator
from nerm.ablations import ABLATIONS, Ablation
from nerm.field_training import FieldTraining
from nerm.field_windows import remarks, training_windows
from nerm.recipes import RECIPES, FieldConfig, NermConfig
from tests.nerm.corpus import MemorySource, analytic_source

CODES = torch.randn(20, 12, generator=torch.Generator().manual_seed(5))
SMALLER = (
    "field.max_duration_seconds=4",
    "field.stride_seconds=4",
    "field.hidden=24",
    "field.layers=3",
    "field.num_queries=8",
    "field.num_frequencies=8",
    "field.batch=8",
    "field.epochs=none",
    "field.steps=12",
    "field.rate=2e-3",
    "field.latent_rate=2e-2",
    "field.precision=float32",
)
LAYOUTS = ("global", "local")


def _settings(recipe: str, *changes: str) -> FieldConfig:
    config: NermConfig = RECIPES[recipe]()
    return apply_overrides(config, [*SMALLER, *changes]).field


def _training(config: FieldConfig, source: MemorySource | None = None) -> FieldTraining:
    source = source or analytic_source()
    windows = training_windows(source, config)
    poses = WindowPoses(source, windows, SMPL22.left_right_pairs, config.fixed_framerate)
    return FieldTraining(poses, config, codebook=CODES, seed=3, device=torch.device("cpu"))


def _losses(training: FieldTraining) -> list[float]:
    return [
        float(training.step(step, step_generator(3, "field", step))["reconstruction"].detach())
        for step in range(training.steps)
    ]


@pytest.mark.parametrize("recipe", ["paper", "nano"])
@pytest.mark.parametrize("ablation", ABLATIONS, ids=lambda each: f"{each.table} {each.row}")
def test_every_row_trains(ablation: Ablation, recipe: str) -> None:
    losses = _losses(_training(_settings(recipe, *ablation.settings)))
    assert np.isfinite(losses).all()
    assert np.mean(losses[-3:]) < np.mean(losses[:3])


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("encoding", ["none", "raw", "fourier", "codebook"])
def test_every_time_encoding_trains_with_either_layout(encoding: str, layout: str) -> None:
    losses = _losses(_training(_settings("paper", f"field.time_encoding={encoding}", f"field.latent_layout={layout}")))
    assert np.mean(losses[-3:]) < np.mean(losses[:3])


@pytest.mark.parametrize("table", ["5", "6", "7", "8"])
def test_the_rows_are_those_of_the_paper_s_tables(table: str) -> None:
    figures = reported_figures("nerm", table)
    printed = {each.setting.partition(";")[2] or each.method for each in figures}
    assert {each.row for each in ABLATIONS if each.table == table} == printed


def test_frame_numbers_and_knots_exclude_each_other() -> None:
    with pytest.raises(UsageError, match="need latent_layout=global"):
        _settings("nano", "field.coordinates=frames")


class TestFixedFramerate:
    """Table 1's "NeRM-fixed"."""

    def test_every_pose_is_taken_at_that_framerate(self) -> None:
        training = _training(_settings("nano", "field.fixed_fps=20"))
        for step in (0, 5, 11):
            batch = training._draw(step, step_generator(3, "field", step))
            ticks = (batch.coordinates + 1.0) * 2.0 * 20.0
            torch.testing.assert_close(ticks, ticks.round(), atol=1e-9, rtol=0)
            assert batch.fps.unique().tolist() == [20.0]

    def test_scales_and_starting_latents_see_that_framerate_only(self) -> None:
        config = _settings("nano", "field.fixed_fps=20")
        whole = _training(config)
        source = analytic_source()
        between = source.positions.copy()
        for start, count, fps in zip(source.start_row, source.num_frames, source.fps_numerator, strict=True):
            frames = np.arange(count)
            # Every native frame that no tick of 20 fps touches, before or after it, is spoilt.
            ticks = frames * 20 / fps
            touched = np.isin(frames, np.floor(np.arange(81) * fps / 20)) | np.isin(
                frames, np.ceil(np.arange(81) * fps / 20)
            )
            assert (~touched).any() == (fps > 40), ticks
            between[start : start + count][~touched] += 5.0
        spoilt = _training(config, replace(source, positions=between))
        torch.testing.assert_close(spoilt.scaling.mean, whole.scaling.mean)
        torch.testing.assert_close(spoilt.mean.table, whole.mean.table)

    def test_slower_sequences_are_left_out_and_told(self) -> None:
        config = _settings("nano", "field.fixed_fps=60")
        source = analytic_source()
        windows = training_windows(source, config)
        assert sorted(windows.fps) == [60.0, 120.0, 120.0]
        assert remarks(source, windows, config) == ["1 of 4 sequences are slower than field.fixed_fps and are left out"]
        with pytest.raises(UsageError, match=r"no training sequence has 250 fps .* the fastest has 120"):
            training_windows(source, _settings("nano", "field.fixed_fps=250"))

    def test_the_framerate_is_exact(self) -> None:
        assert _settings("nano", "field.fixed_fps=30000/1001").fixed_framerate == Fraction(30000, 1001)
        assert _settings("nano", "field.fixed_fps=12.5").fixed_framerate == Fraction(25, 2)
        assert _settings("nano").fixed_framerate is None

    @pytest.mark.parametrize("fps", ["0", "-20", "1000000", "fast", "20/0"])
    def test_what_is_no_framerate_is_refused(self, fps: str) -> None:
        with pytest.raises(UsageError, match=f"field.fixed_fps={fps}.*framerate"):
            _settings("nano", f"field.fixed_fps={fps}")


def test_one_framerate_and_short_windows_are_told() -> None:
    source = analytic_source(rates=(30, 30), seconds=1.0)
    config = _settings("paper")
    windows = training_windows(source, config)
    one, short = remarks(source, windows, config)
    assert "every training sequence has 30 fps" in one
    assert "2 of 2 windows are shorter than a clip of field.num_poses=32" in short
    assert remarks(analytic_source(), training_windows(analytic_source(), config), config) == []
