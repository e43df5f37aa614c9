"""P8: a step of stage field with the coordinate branch once per distinct coordinate, beside once per pose.

    python -m benchmarks.nerm.field_step [--clips 128] [--poses 32] [--hidden 256] [--repeats 3] [--json]

Per pose, the prototypes (which depend on θ alone) are computed once, and each pose of each clip attends to them. Both
compute the same loss (checked before timing); clips are contiguous, at 20, 30, 60 and 120 fps.
CPU seconds of a whole step (forward, backward), one thread; the best of the repeats.
"""

from collections.abc import Callable

import torch

from benchmarks.command import arguments_parser, best_cpu_seconds, print_json
from motionkit.training.config import apply_overrides
from nerm.network import EncodedCoordinates, FieldNetwork
from nerm.recipes import FieldConfig

RATES = (20.0, 30.0, 60.0, 120.0)


def draw_clips(clips: int, poses: int, seconds: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Coordinates and framerates of random contiguous clips in windows of `seconds`."""
    generator = torch.Generator().manual_seed(0)
    fps = torch.tensor(RATES, dtype=torch.float64)[torch.randint(len(RATES), (clips,), generator=generator)]
    room = torch.floor(fps * seconds) + 1 - poses
    first = torch.floor(torch.rand(clips, generator=generator, dtype=torch.float64) * room)
    frames = first[:, None] + torch.arange(poses)
    return -1.0 + 2.0 * frames / fps[:, None] / seconds, fps


def per_pose(network: FieldNetwork, coordinates: torch.Tensor) -> EncodedCoordinates:
    """Prototypes once, then every pose of every clip on its own."""
    assert network.fourier is not None
    assert network.attention is not None
    features = network.attention(network.fourier(coordinates.reshape(-1)))
    return EncodedCoordinates(features, (), torch.arange(coordinates.numel()).reshape(coordinates.shape))


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("--clips", type=int, default=128)
    parser.add_argument("--poses", type=int, default=32)
    parser.add_argument("--hidden", type=int, default=256)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    network = FieldNetwork(
        apply_overrides(FieldConfig(), [f"decoder.width={arguments.hidden}"]), 66, torch.randn(512, 512)
    )
    coordinates, fps = draw_clips(arguments.clips, arguments.poses, network.config.windows.max_duration_seconds)
    latents = torch.randn(
        arguments.clips, network.config.latents.dimension if network.local is None else network.local.dimension
    )

    def loss_of(encode: Callable[[], EncodedCoordinates]) -> torch.Tensor:
        network.zero_grad()
        loss = network.decode(latents, encode(), fps).square().mean()
        loss.backward()
        return loss.detach()

    sides: dict[str, Callable[[], EncodedCoordinates]] = {
        "per distinct coordinate": lambda: network.encode_coordinates(coordinates, fps),
        "per pose": lambda: per_pose(network, coordinates),
    }
    losses = [loss_of(encode) for encode in sides.values()]
    for loss in losses[1:]:
        torch.testing.assert_close(losses[0], loss)
    distinct = len(torch.unique(torch.round(coordinates * 2.0**40)))
    figures = {name: best_cpu_seconds(lambda e=encode: loss_of(e), arguments.repeats) for name, encode in sides.items()}
    if arguments.json:
        print_json({"poses": coordinates.numel(), "distinct": distinct, "cpu_seconds_a_step": figures})
        return
    print(f"{coordinates.numel()} poses, {distinct} distinct coordinates")
    for name, seconds in figures.items():
        ratio = seconds / figures["per distinct coordinate"]
        print(f"{name:28} {seconds:8.3f} CPU s a step  {ratio:6.1f}")


if __name__ == "__main__":
    main()
