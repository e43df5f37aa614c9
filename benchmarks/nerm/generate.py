"""P7: generating 9.8 s at 20 and at 120 fps, and the decoder's rate beside the machine's matrix products.

    python -m benchmarks.nerm.generate [--recipe nano] [--run runs/nano] [--motions 1] [--json]

Generation is what `NermModel` does for unconditional motions: diffusion, coordinate branch, decoding to joint positions
(files are left out). Weights are those of a run, or random ones of a recipe's sizes (what it costs does not depend on
their values). The field's cached grids are cleared before each repeat, so that the coordinate branch is timed as well.

The peak is measured: the quicker of torch.mm (MKL) and `nerm.network.Linear` (oneDNN where the processor has it) at the
decoder's own shapes, [poses × hidden] · [hidden × hidden], one after another. The decoder's rate counts the
multiplications and additions of its matrix products alone, over all the time it takes.

CPU seconds, one thread; the best of the repeats.
"""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch
from torch.utils.flop_counter import FlopCounterMode

from benchmarks.command import arguments_parser, best_cpu_seconds, print_json
from motionkit.data.windows import Windows
from motionkit.generate.models import GenerationRequest
from motionkit.training.networks import ConditionSizes, VectorScaling
from nerm.latents import LatentSpace, first_read, local_latents
from nerm.model import NermModel, TrainedDenoiser, TrainedField, load
from nerm.network import Denoiser, FieldNetwork, Linear
from nerm.recipes import RECIPES

SECONDS = 9.8
RATES = (Fraction(20), Fraction(120))
NUM_NUMBERS = 66


def random_model(recipe: str) -> NermModel:
    """A model of a recipe's sizes with random weights."""
    config = RECIPES[recipe]()
    torch.manual_seed(0)
    codes = torch.randn(config.codebook.network.num_codes, config.codebook.network.width)
    network = FieldNetwork(config.field, NUM_NUMBERS, codes).eval().requires_grad_(False)
    one = np.ones(1, dtype=np.int64)
    windows = Windows(
        config.field.windows.max_duration_seconds,
        sequence_index=0 * one,
        start_row=0 * one,
        start_frame=0 * one,
        num_frames=1176 * one,
        fps_numerator=one * 120,
        fps_denominator=one,
        yaw=np.zeros(1, np.float32),
        origin=np.zeros((1, 2), np.float32),
        mirrored=np.zeros(1, bool),
    )
    banks = local_latents(config.field)
    size = config.field.latents.dimension if banks is None else banks.dimension
    field = TrainedField(
        network=network,
        scaling=VectorScaling(torch.zeros(NUM_NUMBERS), torch.ones(NUM_NUMBERS)),
        linear_model=None,
        posterior_mean=torch.randn(1, size),
        posterior_log_variance=torch.zeros(1, size),
        windows=windows,
        store_fingerprint="",
    )
    layout = ConditionSizes(768, ())
    reach = first_read(size, banks)
    denoiser = TrainedDenoiser(
        config=config.denoiser,
        denoiser=Denoiser(config.denoiser.network, reach, layout).eval().requires_grad_(False),
        space=LatentSpace(banks, torch.zeros(size), torch.ones(size)),
        layout=layout,
        durations=torch.tensor([SECONDS / config.field.windows.max_duration_seconds]),
        text_encoder="",
        text_fingerprint="",
        field_sha256="",
    )
    return NermModel(field, denoiser)


def cpu_seconds(work: Callable[[], object], repeats: int) -> float:
    """The fastest of some repeats, after a warm-up."""
    work()
    return best_cpu_seconds(work, repeats)


def field_of(model: NermModel) -> TrainedField:
    """The trained field behind a model."""
    assert isinstance(model.field, TrainedField)
    return model.field


def generation_costs(model: NermModel, motions: int, repeats: int) -> dict[str, object]:
    """CPU seconds of `motions` motions at each framerate, the share of the diffusion, and the ratio of the two."""
    requests = [GenerationRequest(SECONDS)] * motions

    def generate(fps: Fraction) -> None:
        field_of(model)._kept_grids.cache_clear()
        times = np.arange(round(SECONDS * float(fps))) / float(fps)
        for field in model.generate(requests, seed=0):
            field.at_fps(fps).query(times)

    costs = {str(fps): cpu_seconds(lambda fps=fps: generate(fps), repeats) for fps in RATES}
    diffusion = cpu_seconds(lambda: model.generate(requests, seed=0), repeats)
    return {"cpu_seconds": costs, "of_which_diffusion": diffusion, "ratio": costs["120"] / costs["20"]}


def decoding_rate(model: NermModel, repeats: int) -> dict[str, object]:
    """The decoder's matrix products per second at 120 fps, relative to plain products at the same shapes."""
    field = field_of(model)
    config, fps = field.config, RATES[-1]
    times = np.arange(round(SECONDS * float(fps))) / float(fps)
    latent = field.posterior_mean[:1]
    encoded = field.encode_times(times[None], fps)
    hidden = torch.randn(len(times), config.decoder.width)
    weights = [torch.randn(config.decoder.width, config.decoder.width) for _ in range(config.decoder.num_layers - 1)]
    inner = 2 * len(times) * config.decoder.width**2 * (config.decoder.num_layers - 1)
    with FlopCounterMode(display=False) as counter:
        field.decode_vectors(latent, encoded, fps)
    flops = counter.get_total_flops()

    linears = [Linear(config.decoder.width, config.decoder.width, bias=False) for _ in weights]

    def products() -> None:
        for weight in weights:
            torch.mm(hidden, weight.T)

    def linear_products() -> None:
        for linear in linears:
            linear(hidden)

    with torch.inference_mode():
        peak = inner / min(cpu_seconds(products, repeats), cpu_seconds(linear_products, repeats))
        network = flops / cpu_seconds(lambda: field.decode_vectors(latent, encoded, fps), repeats)
        positions = flops / cpu_seconds(lambda: field.poses(latent[0], times, fps), repeats)
    return {
        "poses": len(times),
        "floor_gflops": peak / 1e9,
        "decoder_gflops": network / 1e9,
        "to_joint_positions_gflops": positions / 1e9,
        "share_of_floor": network / peak,
        "share_of_floor_to_joint_positions": positions / peak,
    }


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("--recipe", default="nano", choices=sorted(RECIPES))
    parser.add_argument("--run", default="", help="a trained run; without it random weights of the recipe")
    parser.add_argument("--motions", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    model = load(Path(arguments.run)) if arguments.run else random_model(arguments.recipe)
    costs = generation_costs(model, arguments.motions, arguments.repeats)
    rates = decoding_rate(model, arguments.repeats)
    report = {
        "weights": arguments.run or f"random, sizes of {arguments.recipe}",
        "motions": arguments.motions,
        **costs,
        "decoding": rates,
    }
    if arguments.json:
        print_json(report, runs=[Path(arguments.run)] if arguments.run else [])
        return
    _print(report)


def _print(report: dict) -> None:
    costs, rates = report["cpu_seconds"], report["decoding"]
    print(f"{report['weights']}; {report['motions']} motion(s) of {SECONDS} s, one thread")
    for fps, seconds in costs.items():
        print(f"  at {fps:>3} fps           {1000 * seconds:8.1f} ms CPU")
    print(f"  of which diffusion   {1000 * report['of_which_diffusion']:8.1f} ms")
    print(f"  120 fps over 20 fps  {report['ratio']:8.2f}")
    print(f"decoding {rates['poses']} poses; floor: plain products at the same shapes")
    print(f"  floor                {rates['floor_gflops']:8.1f} GFLOP/s")
    print(f"  decoder              {rates['decoder_gflops']:8.1f} GFLOP/s  {rates['share_of_floor']:6.1%}")
    share = rates["share_of_floor_to_joint_positions"]
    print(f"  to joint positions   {rates['to_joint_positions_gflops']:8.1f} GFLOP/s  {share:6.1%}")


if __name__ == "__main__":
    main()
