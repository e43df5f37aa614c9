"""Training per GPU day of each generative peer's recipe `paper`, estimated from the operations of one step.

    python -m benchmarks.eval.gpu_day --store STORE [--windows 23384]

Of every stage, losses and gradients of two motions are computed on the CPU, the longest of the store: floating point
operations grow with the batch, and are scaled to the recipe's; operations that launch a kernel do not. A step takes at
least the larger of FLOPs over what a GPU sustains and launches times what one costs. Reading, drawing and copying a
batch come on top. `--windows` is how many motions an epoch visits (HumanML3D's training split with its mirror images).
NeRM's stages are in docs/nerm.md. A table goes to stderr, JSON to stdout.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from rich.table import Table
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils.flop_counter import FlopCounterMode

from benchmarks.command import arguments_parser, print_table_and_json
from motionkit.store import Store
from motionkit.training.config import apply_overrides
from peers.generative.batches import PoseSpace
from peers.generative.corpus import open_corpus, text_encoder_of
from peers.generative.peer import PeerStage
from peers.generative.recipes import PEERS
from peers.generative.training import PeerNetwork, StepAware

MOTIONS = 2
SUSTAINED_FLOPS = 300e12
"""FLOP/s of bfloat16 products that trainings reach of an H100's 989e12 (dense; NVIDIA's data sheet)."""
LAUNCH_SECONDS = 5e-6
DAY_SECONDS = 86_400


class Launches(TorchDispatchMode):
    """Counts the operations that compute something: views of a tensor launch no kernel."""

    count = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Run the operation, and count it."""
        returns = func._schema.returns
        self.count += not (returns and all(each.alias_info and not each.alias_info.is_write for each in returns))
        return func(*args, **(kwargs or {}))


@dataclass(frozen=True)
class Estimate:
    """A stage's step, and its published schedule, on one GPU."""

    parameters: int
    batch: int
    teraflops_a_step: float
    launches_a_step: int
    milliseconds_a_step: float
    steps_a_day: int
    published_steps: int
    published_hours: float


def counted_stage(
    stage: PeerStage, store: Store, windows: int, earlier: Mapping[str, torch.nn.Module]
) -> tuple[torch.nn.Module, Estimate]:
    """A stage's untrained network by the recipe `paper`, and the estimate for its step."""
    overrides = ["precision=float32", "conditions.text_encoder=minilm"]
    config = apply_overrides(stage.configs["paper"](), overrides)
    if config.conditions.kind == "action" and not any(store.columns("action")["action"]):
        config = apply_overrides(config, ["conditions.kind=text"])
    corpus = open_corpus(store, config, text_encoder_of(config.conditions))
    torch.manual_seed(0)
    space = PoseSpace(corpus.vectors, corpus.scaling, config.motions.framerate)
    network = stage.make_network(config, space, corpus.sizes, earlier)
    assert isinstance(network, PeerNetwork)
    batch_size, steps = config.schedule.batch_size, config.schedule.num_steps(windows)
    generator = torch.Generator().manual_seed(0)
    longest = torch.from_numpy(corpus.last_tick).argsort(descending=True)[:MOTIONS]
    batch = corpus.batch(longest, generator, drop=config.conditions.drop)
    if isinstance(network, StepAware):
        network.begin_step(steps - 1, steps)
    with FlopCounterMode(display=False) as flops, Launches() as launches:
        torch.autograd.backward(network.losses(batch, generator)["loss"])
    work = flops.get_total_flops() * batch_size / MOTIONS
    seconds = max(work / SUSTAINED_FLOPS, launches.count * LAUNCH_SECONDS)
    return network, Estimate(
        parameters=sum(parameter.numel() for parameter in network.parameters()),
        batch=batch_size,
        teraflops_a_step=work / 1e12,
        launches_a_step=launches.count,
        milliseconds_a_step=1e3 * seconds,
        steps_a_day=int(DAY_SECONDS / seconds),
        published_steps=steps,
        published_hours=steps * seconds / 3600,
    )


def main() -> None:
    """Count each stage's step."""
    parser = arguments_parser(__doc__)
    parser.add_argument("--store", type=Path, required=True)
    parser.add_argument("--windows", type=int, default=23_384)
    arguments = parser.parse_args()
    store = Store.open(arguments.store)
    found: dict[str, Estimate] = {}
    for peer in PEERS:
        networks: dict[str, torch.nn.Module] = {}
        for stage in peer.stages:
            networks[stage.name], found[stage.name] = counted_stage(stage, store, arguments.windows, networks)
    table = Table("stage", "parameters", "batch", "TFLOP a step", "launches", "ms a step", "published steps", "hours")
    for name, each in found.items():
        table.add_row(
            name,
            f"{each.parameters:,}",
            str(each.batch),
            f"{each.teraflops_a_step:.3g}",
            f"{each.launches_a_step:,}",
            f"{each.milliseconds_a_step:.3g}",
            f"{each.published_steps:,}",
            f"{each.published_hours:.3g}",
        )
    figures = {
        "windows": arguments.windows,
        "sustained_flops": SUSTAINED_FLOPS,
        "launch_seconds": LAUNCH_SECONDS,
        "stages": {name: asdict(each) for name, each in found.items()},
    }
    print_table_and_json(table, figures, arguments.store)


if __name__ == "__main__":
    main()
