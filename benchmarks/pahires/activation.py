"""The parametric activation by lookup table, against computing its ζ sines, and the layer's own matrix product.

    python benchmarks/pahires/activation.py [--rows 1024] [--width 256] [--sines 16] [--repeats 5] [--json]

A layer of `width` neurons on `rows` queries. Forward alone, and forward with gradients to the inputs and to Ψ, Ω, Φ;
CPU seconds, one thread, all sides in turn, the best of the repeats. How far the table is from the sines is measured in
the same run.
"""

import time
from collections.abc import Callable
from typing import Any

import torch

from benchmarks.command import arguments_parser, print_json
from pahires.activation import FourierActivation, linear


def cpu_seconds(sides: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """The fastest of some repeats of each side, taken in turn."""
    found = dict.fromkeys(sides, float("inf"))
    for _ in range(repeats):
        for name, side in sides.items():
            started = time.process_time()
            side()
            found[name] = min(found[name], time.process_time() - started)
    return found


def measure(rows: int, width: int, num_sines: int, repeats: int) -> dict[str, Any]:
    """Nanoseconds a number by table, by sines and by a matrix of the same width, and how far table and sines differ."""
    activation = FourierActivation(num_sines, "calibrated")
    layer = linear(width, width, "calibrated")
    x = torch.randn(rows, width, requires_grad=True)
    incoming = torch.randn(rows, width)

    def forward(function: Callable[[torch.Tensor], torch.Tensor]) -> Callable[[], torch.Tensor]:
        return torch.no_grad()(lambda: function(x))

    def with_gradients(
        function: Callable[[torch.Tensor], torch.Tensor], module: torch.nn.Module
    ) -> Callable[[], tuple[torch.Tensor, ...]]:
        return lambda: torch.autograd.grad(function(x), [x, *module.parameters()], incoming)

    sides = {"table": (activation, activation), "sines": (activation.direct, activation), "matrix": (layer, layer)}
    table, sines = with_gradients(*sides["table"])(), with_gradients(*sides["sines"])()
    forwards = cpu_seconds({name: forward(function) for name, (function, _) in sides.items()}, repeats)
    whole = cpu_seconds({name: with_gradients(*side) for name, side in sides.items()}, repeats)
    found = {"forward": forwards, "with_gradients": whole}
    return {
        "rows": rows,
        "width": width,
        "sines": num_sines,
        "apart": {
            "value": float((activation(x) - activation.direct(x)).detach().abs().max()),
            "gradient": max(float((a - b).norm() / b.norm()) for a, b in zip(table, sines, strict=True)),
        },
        **{
            f"{name}_nanoseconds": {side: 1e9 * seconds / (rows * width) for side, seconds in each.items()}
            for name, each in found.items()
        },
        "sines_per_table": {name: each["sines"] / each["table"] for name, each in found.items()},
    }


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("--rows", type=int, default=1024)
    parser.add_argument("--width", type=int, default=256)
    parser.add_argument("--sines", type=int, default=16)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    result = measure(options.rows, options.width, options.sines, options.repeats)
    if options.json:
        print_json(result)
        return
    forwards, whole = result["forward_nanoseconds"], result["with_gradients_nanoseconds"]
    ratios, apart = result["sines_per_table"], result["apart"]
    print(f"{'ns per number':16} {'forward':>10} {'with gradients':>16}")
    for side in ("table", "sines", "matrix"):
        print(f"{side:16} {forwards[side]:10.1f} {whole[side]:16.1f}")
    print(f"{'sines / table':16} {ratios['forward']:10.1f} {ratios['with_gradients']:16.1f}")
    print(f"apart: {apart['value']:.1e} in value, {apart['gradient']:.1e} of a gradient")


if __name__ == "__main__":
    main()
