from dataclasses import replace

import numpy as np
import pytest
import torch

from motionkit.core.errors import UsageError
from motionkit.data.corpus import FrameValues
from motionkit.data.poses import WindowPoses
from motionkit.data.windows import cut_windows
from motionkit.training.config import apply_overrides
from motionkit.training.pose_vectors import PoseTensors, measure_scaling
from nerm.latents.knots import measured_heading, path_speed, placed, relative_to, turned
from nerm.latents.linear_fit import LinearModel, held
from nerm.latents.local import LocalLatents, local_latents
from nerm.recipes import paper
from nerm.settings import FieldConfig
from tests.helpers.nerm_corpus import MemorySource, analytic_positions, analytic_source

BANKED = apply_overrides(
    FieldConfig(),
    [
        "windows.max_duration_seconds=4.0",
        "latents.layout=local",
        f"latents.dimension={16 * 6 + 8 * 5 + 8 * 3}",
        "latents.knots=16,8",
        "latents.knot_numbers=6,5",
        "latents.path_knots=8",
        "latents.kernel=lanczos",
        "loss.scaling=group",
        "loss.root_weight=4.0",
        "latents.initialisation=ridge",
        "latents.ridge=0.001",
        "decoder.linear_path=true",
    ],
)


def _banks(config: FieldConfig = BANKED) -> LocalLatents:
    banks = local_latents(config)
    assert banks is not None
    return banks


def _scaling(poses, config):
    grouped, weight, path = config.loss.scaling == "group", config.loss.root_weight, config.latents.has_path
    return measure_scaling(poses, grouped=grouped, root_weight=weight, centred_path=path)


def _poses(source: MemorySource, seconds: float = 4.0) -> WindowPoses:
    return WindowPoses(cut_windows(source, max_duration_seconds=seconds), FrameValues.of_positions(source))


def _circling(seconds: float = 4.0, fps: int = 60) -> MemorySource:
    """The first analytic motion, once at 1.2 m/s around a circle that it closes 1.3 times, always facing ahead."""
    times = np.arange(int(seconds * fps) + 1) / fps
    heading = 2 * np.pi * 1.3 * times / seconds
    body = analytic_positions(times, 0).astype(np.float64)
    body[..., 2] -= 0.5 * times[:, None]
    x, z = body[..., 0].copy(), body[..., 2].copy()
    cosine, sine = np.cos(heading)[:, None], np.sin(heading)[:, None]
    radius = 1.2 * seconds / (2 * np.pi * 1.3)
    body[..., 0] = cosine * x + sine * z + radius * (1 - np.cos(heading))[:, None]
    body[..., 2] = cosine * z - sine * x + radius * np.sin(heading)[:, None]
    one = np.ones(1, dtype=np.int64)
    return MemorySource(body.astype(np.float32), 0 * one, 0 * one, len(times) * one, fps * one, one)


def test_poses_relative_to_a_path_come_back() -> None:
    generator = torch.Generator().manual_seed(4)
    vectors, path = torch.randn(3, 5, 66, generator=generator), 3 * torch.randn(3, 5, 3, generator=generator)
    torch.testing.assert_close(placed(relative_to(vectors, path), path), vectors, atol=1e-5, rtol=1e-5)


def test_turning_is_about_the_vertical_from_z_towards_x() -> None:
    vectors = torch.tensor([[0.0, 0.5, 1.0, 0.0, 0.7, 2.0]])
    quarter = turned(vectors, torch.tensor([np.pi / 2]))
    torch.testing.assert_close(quarter, torch.tensor([[1.0, 0.5, 0.0, 2.0, 0.7, 0.0]]), atol=1e-6, rtol=0)


def test_somebody_who_walks_ahead_feels_forward_speed() -> None:
    heading = torch.tensor([0.3, 2.0, -1.1])
    ahead = torch.stack((torch.sin(heading), torch.cos(heading), torch.zeros(3)), dim=-1)
    felt = path_speed(ahead, torch.stack((torch.ones(3), torch.ones(3), heading), dim=-1))
    torch.testing.assert_close(felt, torch.tensor([[0.0, 1.0, 0.0]]).expand(3, 3), atol=1e-6, rtol=0)


def test_heading_goes_on_beyond_a_full_turn() -> None:
    vectors = PoseTensors.of(_poses(_circling()).evenly(np.array([0]), 100)).vectors
    heading = measured_heading(vectors)[0]
    expected = torch.linspace(0, 2 * np.pi * 1.3, 100, dtype=torch.float64)
    # The analytic body sways, so that the line through hips and shoulders turns a little too.
    assert float((heading - expected).abs().max()) < 0.8
    assert float(heading[-1] - heading[0]) > 2 * np.pi


def test_banks_split_and_join() -> None:
    banks = _banks()
    latents = torch.randn(3, banks.dimension, generator=torch.Generator().manual_seed(1))
    parts = banks.split(latents)
    assert [tuple(part.shape) for part in parts] == [(3, 16, 6), (3, 8, 5), (3, 8, 3)]
    assert torch.equal(banks.join(parts), latents)


def test_z_goes_by_stretches_of_time() -> None:
    banks = _banks()
    numbers = banks.describe()
    assert (banks.num_stretches, banks.dimension) == (8, 160)
    stretch = torch.floor((numbers.centre + 1.0) / 2.0 * 8).long().view(8, -1)
    assert torch.equal(stretch, torch.arange(8)[:, None].expand(8, 20))
    assert numbers.bank.view(8, -1)[3].tolist() == [0] * 12 + [1] * 5 + [2] * 3
    assert numbers.knot.view(8, -1)[3].tolist() == [6] * 6 + [7] * 6 + [3] * 8
    assert numbers.component.view(8, -1)[3].tolist() == [*range(6), *range(6), *range(6, 11), 0, 1, 2]


def test_what_is_described_is_what_is_read() -> None:
    banks = _banks()
    numbers = banks.describe()
    for index in (0, 17, 47, 141, 159):
        latents = torch.zeros(1, banks.dimension)
        latents[0, index] = 1.0
        reading = banks.read(latents, banks.weights(numbers.centre[[index]]), torch.zeros(1, 1, dtype=torch.int64))
        is_path = int(numbers.bank[index]) == 2
        assert reading.path is not None
        read = reading.path if is_path else reading.seen[..., : banks.num_components]
        expected = torch.zeros_like(read)
        expected[0, 0, numbers.component[index]] = banks.path_units()[numbers.component[index]] if is_path else 1.0
        torch.testing.assert_close(read, expected, atol=0.2, rtol=0)


def _reconstructed(model: LinearModel, poses: WindowPoses, latents: torch.Tensor) -> torch.Tensor:
    batch = PoseTensors.of(poses.evenly(np.arange(len(latents)), 90))
    weights = model.banks.weights(batch.coordinates.reshape(-1))
    reading = model.banks.read(latents, weights, torch.arange(batch.coordinates.numel()).view(len(latents), -1))
    components = reading.seen[..., : model.banks.num_components]
    vectors = components @ model.components.inverse() + model.components.mean
    if reading.path is not None:
        vectors = placed(vectors, reading.path)
    return (model.scaling.invert(vectors) - batch.vectors).norm(dim=-1).mean()


def test_the_linear_model_with_a_path_describes_somebody_who_walks_in_circles() -> None:
    from nerm.field.training import linear_model

    poses = _poses(_circling())
    errors = []
    for config in (BANKED, apply_overrides(BANKED, ["latents.path_knots=0", f"latents.dimension={16 * 6 + 8 * 5}"])):
        model = linear_model(poses, _scaling(poses, config), config)
        assert model is not None
        errors.append(float(_reconstructed(model, poses, model.fit(PoseTensors.of(poses.evenly(np.array([0]), 128))))))
    with_path, without = errors
    # Lengths of 66 numbers, in metres: 4 cm over 22 joints.
    assert with_path < 0.4
    assert with_path < 0.5 * without


def test_what_a_short_window_does_not_reach_holds_its_last_pose() -> None:
    from nerm.field.training import linear_model

    source = analytic_source(seconds=2.0)
    poses = _poses(source)
    model = linear_model(poses, _scaling(poses, BANKED), BANKED)
    assert model is not None
    batch = PoseTensors.of(poses.evenly(np.arange(4), 60))
    extended, counts = held(batch)
    assert counts[:, :60].eq(1).all()
    assert counts[:, 60:].sum(dim=1).tolist() == [64.0] * 4
    torch.testing.assert_close(extended.vectors[:, -1], batch.vectors[:, -1])
    for knots in model.banks.split(model.fit(batch)):
        # The first three numbers: the analytic body has hardly any further components.
        late = knots[:, -knots.shape[1] // 4 :, :3]
        assert float((late - late[:, -1:]).abs().max()) < 0.2
        assert float(late.abs().max()) > 0.4


def test_banks_that_do_not_add_up_are_refused() -> None:
    with pytest.raises(UsageError, match=r"make dimension=160, not 100"):
        apply_overrides(BANKED, ["latents.dimension=100"])
    with pytest.raises(UsageError, match="one value per bank"):
        apply_overrides(BANKED, ["latents.knots=16"])
    with pytest.raises(UsageError, match="scaling=group"):
        apply_overrides(BANKED, ["loss.scaling=number"])
    with pytest.raises(UsageError, match=r"decoder.linear_path needs latents.layout=local"):
        apply_overrides(paper().field, ["decoder.linear_path=true"])


def test_banks_are_settings_of_the_command_line() -> None:
    changed = apply_overrides(
        replace(paper(), field=BANKED),
        ["field.latents.knots=8", "field.latents.knot_numbers=10", "field.latents.dimension=104"],
    )
    assert _banks(changed.field).dimension == 104
