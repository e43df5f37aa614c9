"""Protocols of action-to-motion: how many motions, which pairs, what stands after "±"."""

from dataclasses import dataclass
from typing import Literal

from motionkit.core.errors import UsageError


@dataclass(frozen=True)
class ActionProtocol:
    """One way to turn a recogniser's features and scores into a table's numbers.

    `num_motions`: how many generated motions count in a replication, None for all. `pairs` "different" draws Diversity
    without repetition (NeRM Eq. 7) and MultiModality from two different motions; "with replacement" draws both sides of
    either with replacement, as action-to-motion does. `spread`: what the source prints after "±"; ACTOR's is no
    interval.
    """

    name: str
    title: str
    source: str
    version: int = 1
    num_motions: int | None = None
    replications: int = 20
    diversity_pairs: int = 200
    class_pairs: int = 20
    pairs: Literal["different", "with replacement"] = "with replacement"
    spread: Literal["95 % interval", "1.96 · variance"] = "95 % interval"
    remarks: tuple[str, ...] = ()


VARIANCE = 'What the source prints after "±" is 1.96 · variance over seeds, which is not an interval; it is in details.'

NATIVE = ActionProtocol("native", "motionkit", "docs/metrics.md", pairs="different")
A2M = ActionProtocol("a2m", "Action2Motion", "Guo et al. 2020, eval_scripts/final_evaluation.py", num_motions=3000)
ACTOR = ActionProtocol(
    "actor",
    "ACTOR",
    "Petrovich et al. 2021, src/evaluate",
    spread="1.96 · variance",
    remarks=(VARIANCE,),
)
MDM = ActionProtocol("mdm", "MDM", "Tevet et al. 2023, eval/eval_humanact12_uestc.py", num_motions=1000)
ACTION_PROTOCOLS = (NATIVE, A2M, ACTOR, MDM)


def find_action_protocol(name: str) -> ActionProtocol:
    """A protocol by name. Raises `UsageError` with the names there are."""
    for protocol in ACTION_PROTOCOLS:
        if protocol.name == name:
            return protocol
    known = ", ".join(protocol.name for protocol in ACTION_PROTOCOLS)
    raise UsageError(f"there is no action protocol {name!r}: {known}")
