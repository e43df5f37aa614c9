"""The parametric activation by table, beside its ζ sines for every number, beside the layer's own matrix product.

    python benchmarks/pahires/activation.py [--rows 1024] [--width 256] [--sines 16] [--repeats 5] [--json]

A layer of `width` neurons on `rows` queries. Forward alone, and forward with gradients to the inputs and to Ψ, Ω, Φ;
CPU seconds, one thread, all sides in turn, the best of the repeats. How far the table is from the sines is measured in
the same run.
"""

import argparse
import json
import time
from collections.abc import Callable

import torch

from pahires.activation import FourierActivation, linear


def cpu_seconds(sides: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """The quickest of some repeats of each side, taken in turn."""
    found = dict.fromkeys(sides, float("inf"))
    for _ in range(repeats):
        for name, side in sides.items():
            started = time.process_time()
            side()
            found[name] = min(found[name], time.process_time() - started)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=1024)
    parser.add_argument("--width", type=int, default=256)
    parser.add_argument("--sines", type=int, default=16)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    activation = FourierActivation(options.sines, "calibrated")
    layer = linear(options.width, options.width, "calibrated")
    x = torch.randn(options.rows, options.width, requires_grad=True)
    incoming = torch.randn(options.rows, options.width)

    def forward(function: Callable[[torch.Tensor], torch.Tensor]) -> Callable[[], torch.Tensor]:
        return torch.no_grad()(lambda: function(x))

    def with_gradients(
        function: Callable[[torch.Tensor], torch.Tensor], module: torch.nn.Module
    ) -> Callable[[], tuple[torch.Tensor, ...]]:
        return lambda: torch.autograd.grad(function(x), [x, *module.parameters()], incoming)

    table, sines = with_gradients(activation, activation)(), with_gradients(activation.direct, activation)()
    apart = {
        "value": float((activation(x) - activation.direct(x)).detach().abs().max()),
        "gradient": max(float((a - b).norm() / b.norm()) for a, b in zip(table, sines, strict=True)),
    }
    forwards = cpu_seconds(
        {"table": forward(activation), "sines": forward(activation.direct), "matrix": forward(layer)}, options.repeats
    )
    whole = cpu_seconds(
        {
            "table": with_gradients(activation, activation),
            "sines": with_gradients(activation.direct, activation),
            "matrix": with_gradients(layer, layer),
        },
        options.repeats,
    )
    numbers = options.rows * options.width
    result = {
        "rows": options.rows,
        "width": options.width,
        "sines": options.sines,
        "apart": apart,
        **{
            f"{name}_nanoseconds": {side: 1e9 * seconds / numbers for side, seconds in found.items()}
            for name, found in (("forward", forwards), ("with_gradients", whole))
        },
        "sines_per_table": {
            "forward": forwards["sines"] / forwards["table"],
            "with_gradients": whole["sines"] / whole["table"],
        },
    }
    if options.json:
        print(json.dumps(result))
        return
    print(f"{'ns per number':16} {'forward':>10} {'with gradients':>16}")
    for side in ("table", "sines", "matrix"):
        print(f"{side:16} {1e9 * forwards[side] / numbers:10.1f} {1e9 * whole[side] / numbers:16.1f}")
    print(f"{'sines / table':16} {forwards['sines'] / forwards['table']:10.1f} {whole['sines'] / whole['table']:16.1f}")
    print(f"apart: {apart['value']:.1e} in value, {apart['gradient']:.1e} of a gradient")


if __name__ == "__main__":
    main()
