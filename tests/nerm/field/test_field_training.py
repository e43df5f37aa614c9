from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch

from motionkit.core.skeleton import SMPL22
from motionkit.data.corpus import FrameValues
from motionkit.data.poses import WindowPoses
from motionkit.data.windows import cut_windows
from motionkit.features import field as field_vectors
from motionkit.training.config import apply_overrides
from motionkit.training.loop import step_generator
from motionkit.training.pose_vectors import PoseTensors
from motionkit.training.run import StageFolder
from motionkit.training.tensors import CheckpointError, save_tensors
from nerm.field.encoding import effect_of_numbers, encode_by_optimisation, minimise_each, starting_latents
from nerm.field.trained import TrainedField, load_field, save_field
from nerm.field.training import FieldTraining
from nerm.settings import FieldConfig
from tests.helpers.nerm_corpus import FPS, analytic_positions, analytic_source

SMALL = apply_overrides(
    FieldConfig(),
    [
        "windows.max_duration_seconds=4.0",
        "latents.layout=local",
        "latents.initialisation=ridge",
        "latents.dimension=128",
        "decoder.linear_path=true",
        "latents.initial_log_variance=-9.0",
        "encoder.framerate_scale=0.05",
        "latents.knots=16",
        "latents.knot_numbers=8",
        "encoder.kind=fourier",
        "encoder.num_frequencies=8",
        "decoder.width=64",
        "decoder.num_layers=4",
        "decoder.activation=silu",
        "loss.scaling=group",
        "loss.root_weight=8.0",
        "schedule.epochs=none",
        "schedule.steps=300",
        "schedule.batch_size=4",
        "clips.num_poses=32",
        "clips.contiguous=false",
        "clips.warmup_fraction=0.1",
        "clips.lowest_fps=20.0",
        "schedule.learning_rate=0.005",
        "optimizer.latent_learning_rate=0.02",
        "schedule.kind=cosine",
        "optimizer.weight_decay=0.0",
    ],
)


def _poses(config: FieldConfig = SMALL) -> WindowPoses:
    source = analytic_source()
    windows = cut_windows(source, max_duration_seconds=config.windows.max_duration_seconds)
    return WindowPoses(windows, FrameValues.of_positions(source))


def _training(config: FieldConfig = SMALL) -> FieldTraining:
    return FieldTraining(_poses(config), config, codebook=None, seed=3, device=torch.device("cpu"))


def _losses(training: FieldTraining, steps: int) -> list[float]:
    return [float(training.step(step, step_generator(3, "field", step))["loss"].detach()) for step in range(steps)]


BANKED = apply_overrides(
    SMALL,
    [
        f"latents.dimension={16 * 6 + 8 * 4 + 8 * 3}",
        "latents.knots=16,8",
        "latents.knot_numbers=6,4",
        "latents.path_knots=8",
        "latents.kernel=lanczos",
        "optimizer.latent_learning_rate=0.01",
    ],
)


@pytest.fixture(scope="module", params=[SMALL, BANKED], ids=["one bank", "banks and path"])
def trained(request: pytest.FixtureRequest) -> TrainedField:
    training = _training(request.param)
    _losses(training, training.steps)
    return _finished(training)


def _finished(training: FieldTraining) -> TrainedField:
    return TrainedField(
        network=training.network.eval().requires_grad_(False),
        scaling=training.scaling,
        components=training.components,
        posterior_mean=training.mean.table,
        posterior_log_variance=training.log_variance.table,
        windows=training.poses.windows,
        store_fingerprint="analytic",
    )


def _error_mm(trained: TrainedField, latents: torch.Tensor, window: int, fps: int) -> float:
    times = np.arange(4 * fps + 1) / fps
    truth = analytic_positions(times, window)[None]
    row = slice(window, window + 1)
    vectors = field_vectors.encode(truth, trained.windows.yaw[row], trained.windows.origin[row])
    expected = field_vectors.decode(vectors)[0]
    found = trained.decode(latents[None], times, Fraction(fps))[0]
    return float(np.linalg.norm(found - expected, axis=-1).mean() * 1000)


@pytest.mark.parametrize("fps", [20, 40, 60, 100, 120])
def test_a_small_field_learns_analytic_motions_to_millimetres_at_every_framerate(
    trained: TrainedField, fps: int
) -> None:
    errors = [_error_mm(trained, trained.posterior_mean[window], window, fps) for window in range(4)]
    assert max(errors) < 5.0, errors


def test_encoding_by_optimisation_finds_a_training_window_again(trained: TrainedField) -> None:
    batch = PoseTensors.of(_poses().evenly(np.arange(4), 61))
    latents = encode_by_optimisation(trained, batch)
    assert max(_error_mm(trained, latents[window], window, 120) for window in range(4)) < 5.0


def test_a_latent_does_not_depend_on_the_windows_beside_it(trained: TrainedField) -> None:
    batch = PoseTensors.of(_poses().evenly(np.arange(4), 61))
    # One is far from anything that was trained.
    batch = replace(batch, vectors=batch.vectors * torch.tensor([1.0, 1.0, 1.5, 1.0])[:, None, None])
    among, times = encode_by_optimisation(trained, batch), np.linspace(0.0, 4.0, 61)
    for row in (0, 1, 3):
        alone = encode_by_optimisation(trained, PoseTensors(*(each[row : row + 1] for each in vars(batch).values())))
        # A search amplifies rounding, which differs between sizes of a batch.
        torch.testing.assert_close(alone[0], among[row], atol=0.05, rtol=0.0)
        poses = (trained.decode(latents, times, FPS[4])[0] for latents in (alone, among[row : row + 1]))
        np.testing.assert_allclose(*poses, atol=1e-4)


def test_each_row_is_minimised_by_itself() -> None:
    """Rosenbrock's valley, a stretched parabola, and one that is at its minimum from the start."""
    stretch = torch.tensor([1.0, 1e3], dtype=torch.float64)

    def objective(x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        valley = 100.0 * (x[:, 1] - x[:, 0] ** 2) ** 2 + (1.0 - x[:, 0]) ** 2
        slope = -400.0 * x[:, 0] * (x[:, 1] - x[:, 0] ** 2) - 2.0 * (1.0 - x[:, 0])
        parabola = (stretch * (x - 1.0) ** 2).sum(dim=1)
        is_valley = torch.arange(len(x)) == 0
        gradient = torch.stack((slope, 200.0 * (x[:, 1] - x[:, 0] ** 2)), dim=1)
        return (
            torch.where(is_valley, valley, parabola),
            torch.where(is_valley[:, None], gradient, 2.0 * stretch * (x - 1.0)),
        )

    start = torch.tensor([[-1.2, 1.0], [30.0, -7.0], [1.0, 1.0]], dtype=torch.float64)
    found = minimise_each(objective, start, 80)
    torch.testing.assert_close(found, torch.ones_like(start), atol=1e-6, rtol=0.0)
    assert torch.equal(minimise_each(objective, start[:1], 80), found[:1])


def test_the_search_improves_on_its_start(trained: TrainedField) -> None:
    batch = PoseTensors.of(_poses().evenly(np.arange(4), 61))
    found = [
        starting_latents(trained, batch),
        *(encode_by_optimisation(trained, batch, evaluations=n) for n in (4, 30)),
    ]
    errors = [np.mean([_error_mm(trained, latents[row], row, 120) for row in range(4)]) for latents in found]
    assert errors[2] < errors[1] < errors[0]


def test_numbers_are_searched_in_units_of_their_effect(trained: TrainedField) -> None:
    batch = PoseTensors.of(_poses().evenly(np.arange(4), 61))
    encoded = trained.network.encode_coordinates(batch.coordinates, batch.fps)
    start = starting_latents(trained, batch)
    effect = effect_of_numbers(trained, start, encoded, batch.fps)
    here = trained.network.decode(start, encoded, batch.fps)
    moved = [
        trained.network.decode(start + 1e-2 * number, encoded, batch.fps)
        for number in torch.eye(trained.latent_dimension)
    ]
    measured = torch.stack([(each - here).square().sum(dim=(1, 2)).sqrt() for each in moved], dim=1)
    assert float(measured.max() / measured.min()) > 30.0
    for estimate, true in zip(effect, measured, strict=True):
        # Estimated from a few random signs.
        assert float(torch.corrcoef(torch.stack((estimate.log(), true.log())))[0, 1]) > 0.8


def test_what_is_loaded_decodes_as_what_was_saved(trained: TrainedField, tmp_path: Path) -> None:
    save_field(StageFolder(tmp_path / "field"), trained)
    loaded = load_field(tmp_path)
    times = np.linspace(0.0, 4.0, 17)
    np.testing.assert_array_equal(
        loaded.decode(loaded.posterior_mean, times, FPS[2]), trained.decode(trained.posterior_mean, times, FPS[2])
    )
    assert loaded.config == trained.config
    assert loaded.max_training_fps == 120
    dimension = loaded.latent_dimension
    assert dimension in (128, 152)
    assert repr(loaded).startswith(f"TrainedField(local latents of {dimension} numbers, Windows(4 of at most 4 s")
    assert loaded.windows.duration_seconds.tolist() == [4.0] * 4
    assert loaded.posterior_log_variance.shape == (4, dimension)


def test_poses_do_not_depend_on_what_else_is_asked_for(trained: TrainedField) -> None:
    times = np.array([3.0, 0.1, 2.2, 0.7])
    together = trained.decode(trained.posterior_mean, times, FPS[4])
    rows = trained.decode(trained.posterior_mean, np.tile(times, (4, 1)), FPS[4])
    np.testing.assert_allclose(rows, together, atol=1e-6)
    alone = trained.decode(trained.posterior_mean[2:3], times[1:2], FPS[4])
    np.testing.assert_allclose(alone[0, 0], together[2, 1], atol=1e-5)


def test_only_so_many_poses_are_decoded_at_once(trained: TrainedField, monkeypatch: pytest.MonkeyPatch) -> None:
    times, latents = np.arange(4000) / 1000, trained.posterior_mean[:2]
    rows = np.stack((times, times[::-1]))
    whole, whole_rows = (trained.decode(latents, each, Fraction(1000)) for each in (times, rows))
    decoded: list[int] = []
    counted = trained.network.output.register_forward_hook(
        lambda module, inputs, output: decoded.append(output[..., 0].numel())
    )
    monkeypatch.setattr("nerm.field.trained.POSES_AT_ONCE", 700)
    parts, part_rows = (trained.decode(latents, each, Fraction(1000)) for each in (times, rows))
    counted.remove()
    assert max(decoded) == 700
    assert sum(decoded) == 4 * len(times)
    np.testing.assert_allclose(parts, whole, atol=1e-5)
    np.testing.assert_allclose(part_rows, whole_rows, atol=1e-5)


def test_a_latent_is_a_motion_field(trained: TrainedField) -> None:
    motion = trained.as_motion_field(trained.posterior_mean[1], 2.5)
    assert (motion.start_seconds, motion.end_seconds, motion.skeleton) == (0.0, 2.5, SMPL22)
    times = np.array([2.5, 0.0, 1.0])
    expected = trained.decode(trained.posterior_mean[1:2], times, FPS[4])[0]
    np.testing.assert_array_equal(motion.query(times).joint_positions, expected)
    with pytest.raises(ValueError, match="1 of 1 times lie outside"):
        motion.query(np.array([2.6]))


def test_a_transformer_decoders_motion_is_a_function_of_time(monkeypatch: pytest.MonkeyPatch) -> None:
    training = _training(
        apply_overrides(SMALL, ["decoder.kind=transformer", "optimizer.attention_learning_rate=0.001"])
    )
    _losses(training, 3)
    field = _finished(training)
    motion = field.as_motion_field(field.posterior_mean[1], 3.0)
    times = np.arange(181) / 60
    fast = motion.query(times).joint_positions
    # Other framerates, single instants and smaller portions are the same motion; decoded bare they were not.
    np.testing.assert_allclose(motion.query(times[::2]).joint_positions, fast[::2], atol=2e-5)
    for row in (0, 17, 180):
        np.testing.assert_allclose(motion.query(times[row : row + 1]).joint_positions[0], fast[row], atol=2e-5)
    monkeypatch.setattr("nerm.field.trained.POSES_IN_CONTEXT_AT_ONCE", 50)
    np.testing.assert_allclose(motion.query(times).joint_positions, fast, atol=2e-5)
    alone = field.decode(field.posterior_mean[1:2], times[17:18], motion.fps)[0, 0]
    assert np.abs(alone - fast[17]).max() > 1e-3


def test_the_coordinate_branch_is_kept_for_a_grid(trained: TrainedField) -> None:
    times = np.linspace(0, 4, 11)[None] ** 2 / 4
    assert trained.encode_times(times, FPS[0]) is trained.encode_times(times.copy(), FPS[0])


@pytest.mark.parametrize("rate", [30.0, 120.0])
def test_durations_share_the_coordinate_branch(trained: TrainedField, rate: float) -> None:
    fps = Fraction(30)
    assert trained.network.fourier is not None
    encoded: list[int] = []
    counted = trained.network.fourier.register_forward_hook(lambda *_: encoded.append(1))
    for seconds in (1.0, 4.0, 0.0, 3.5):
        times = np.arange(int(seconds * rate) + 1) / rate
        poses = trained.decode(trained.posterior_mean[:1], times, fps)[0]
        some = trained.decode(trained.posterior_mean[:1], times[:1], fps)[0]
        np.testing.assert_allclose(some[0], poses[0], atol=1e-5)
    counted.remove()
    # One for the grid, and for single instants, which lie on the grid at the framerate.
    assert len(encoded) <= 2
    vectors = trained.network(
        trained.posterior_mean[:1],
        torch.from_numpy(times[None] / 2 - 1),
        torch.tensor([float(fps)], dtype=torch.float64),
    )
    expected = trained.vectors.decode(trained.scaling.invert(vectors)[0].numpy(), times, times)
    np.testing.assert_allclose(poses, expected.joint_positions, atol=1e-5)


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    save_tensors(tmp_path / "field" / "model.safetensors", {}, {"format": "something", "version": 1})
    with pytest.raises(CheckpointError, match="'something' version 1, expected 'nerm-field'"):
        load_field(tmp_path)


def test_only_the_batch_s_latents_move() -> None:
    training = _training(apply_overrides(SMALL, ["schedule.batch_size=1", "clips.seconds_per_visit=10.0"]))
    before = training.mean.table.clone()
    _losses(training, 1)
    moved = (training.mean.table != before).any(dim=1)
    assert int(moved.sum()) == 1


def test_training_without_distributions_leaves_variances_alone() -> None:
    training = _training(apply_overrides(SMALL, ["latents.variational=false"]))
    before = training.log_variance.table.clone()
    figures = training.step(0, step_generator(3, "field", 0))
    assert torch.equal(training.log_variance.table, before)
    assert torch.equal(figures["loss"], figures["reconstruction"])


def test_without_distributions_stage_2_draws_what_stage_1_found() -> None:
    training = _training(apply_overrides(SMALL, ["latents.variational=false"]))
    assert float(torch.exp(0.5 * training.log_variance.table).max()) < 0.01


def test_a_transformer_decoder_has_the_rate_of_attention() -> None:
    training = _training(
        apply_overrides(
            SMALL,
            ["decoder.kind=transformer", "schedule.learning_rate=0.01", "optimizer.attention_learning_rate=0.001"],
        )
    )
    rates = {id(parameter): group["lr"] for group in training.optimizer.param_groups for parameter in group["params"]}
    assert {rates[id(parameter)] for parameter in training.network.layers.parameters()} == {1e-3}
    assert rates[id(training.network.output.weight)] == 1e-2
    assert len(rates) == len(list(training.network.parameters()))


def test_a_linear_path_begins_as_the_ridge_fit() -> None:
    training = _training(apply_overrides(SMALL, ["decoder.linear_path=true"]))
    batch = PoseTensors.of(training.poses.evenly(np.arange(4), 50))
    with torch.no_grad():
        vectors = training.network(training.mean.table, batch.coordinates, batch.fps)
    assert float((vectors - training.scaling.apply(batch.vectors)).square().mean()) < 0.1
