"""Memory that a training step of each generative peer keeps for its gradients, by training framerate (E.4).

    python -m benchmarks.eval.peer_memory

Synthetic motions stand in one store at 250 fps. Every stage's recipe `nano`, untrained, has motions of its own longest
duration at 20, 60, 120 and 250 fps, and the framerate it is published at is changed alone. Counted are the bytes of
all tensors that autograd keeps from a step's losses, each storage once, a motion of the batch; weights are left out.
NeRM's stage is measured by `benchmarks/nerm/memory.py`. A table goes to stderr, JSON to stdout.
"""

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from math import ceil
from pathlib import Path
from typing import Any

import torch
from rich.table import Table

from benchmarks.command import arguments_parser, print_table_and_json
from benchmarks.nerm.memory import MEGABYTE, write_corpus
from motionkit.store import Store
from peers.generative.batches import PoseSpace
from peers.generative.corpus import open_corpus
from peers.generative.peer import PeerStage
from peers.generative.recipes import PEERS
from peers.generative.training import PeerNetwork, StepAware

RATES = (20, 60, 120, 250)
MOTIONS = 2
MINUTES = 2.0


def at_framerate(config: Any, fps: int) -> Any:
    """A stage's configuration with motions and stretches of the same seconds at another framerate."""
    motions = config.motions
    ratio = Fraction(fps) / motions.framerate
    seen = motions.seen_frames if motions.seen == "scattered" else round(motions.seen_frames * ratio)
    changed = replace(motions, fps=float(fps), max_frames=round(motions.max_frames * ratio), seen_frames=seen)
    config = replace(config, motions=changed, conditions=replace(config.conditions, kind="none"))
    # The most frames that a network takes: learned vectors of MLD (500: 8 s at 60 fps), convolutions of NeMF.
    limits = {
        name: ceil(changed.max_frames / 16) * 16 for name in ("longest", "frames") if hasattr(config.network, name)
    }
    return replace(config, network=replace(config.network, **limits))


def kept_bytes(network: torch.nn.Module, losses: Any) -> int:
    """Bytes of the storages that autograd keeps while `losses` is computed, but those of the network's weights."""
    weights = {tensor.untyped_storage().data_ptr() for tensor in (*network.parameters(), *network.buffers())}
    kept: dict[int, int] = {}

    def pack(tensor: torch.Tensor) -> torch.Tensor:
        storage = tensor.untyped_storage()
        if storage.data_ptr() not in weights:
            kept[storage.data_ptr()] = storage.nbytes()
        return tensor

    with torch.autograd.graph.saved_tensors_hooks(pack, lambda tensor: tensor):
        losses()
    return sum(kept.values())


def kept_a_motion(stage: PeerStage, store: Store, fps: int, earlier: Mapping[str, torch.nn.Module]) -> Any:
    """A stage's network, and the megabytes that a motion's step keeps at a framerate."""
    config = at_framerate(stage.configs["nano"](), fps)
    corpus = open_corpus(store, config, None)
    torch.manual_seed(0)
    space = PoseSpace(corpus.vectors, corpus.scaling, config.motions.framerate)
    network = stage.make_network(config, space, corpus.sizes, earlier)
    assert isinstance(network, PeerNetwork)
    generator = torch.Generator().manual_seed(0)
    longest = torch.from_numpy(corpus.last_tick).argsort(descending=True)[:MOTIONS]
    batch = corpus.batch(longest, generator, drop=0.0)
    if isinstance(network, StepAware):
        network.begin_step(99, 100)
    return network, kept_bytes(network, lambda: network.losses(batch, generator)) / MOTIONS / MEGABYTE


def main() -> None:
    """Measure every stage at every framerate."""
    arguments_parser(__doc__).parse_args()
    torch.set_num_threads(1)
    found: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as scratch:
        write_corpus(Path(scratch) / "store", max(RATES), MINUTES)
        store = Store.open(Path(scratch) / "store")
        for peer in PEERS:
            for fps in RATES:
                networks: dict[str, torch.nn.Module] = {}
                for stage in peer.stages:
                    networks[stage.name], megabytes = kept_a_motion(stage, store, fps, networks)
                    found.setdefault(stage.name, {})[str(fps)] = megabytes
    table = Table("stage", *(f"{fps} fps, MB" for fps in RATES), "250 / 20")
    for name, each in found.items():
        ratio = each[str(RATES[-1])] / each[str(RATES[0])]
        table.add_row(name, *(f"{each[str(fps)]:.2f}" for fps in RATES), f"{ratio:.1f}")
    print_table_and_json(table, {"megabytes_a_motion": found})


if __name__ == "__main__":
    main()
