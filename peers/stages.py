"""The peers as trainable stages, registered under `motionkit.stages`; imports nothing heavy."""

from collections.abc import Callable, Mapping
from functools import partial

from motionkit.training.stage import Stage, StageContext
from peers.recipes import (
    A_LIIF_RECIPES,
    DELTA_INTERP_RECIPES,
    LIIF_RECIPES,
    LMF_RECIPES,
    META_SR_RECIPES,
    TS_FORMER_RECIPES,
    PeerConfig,
    PeerConfigT,
)


def _train(stage: str, context: StageContext, config: PeerConfig) -> None:
    from motionkit.clips.temporal.training import train_network
    from peers.networks import network_of

    train_network(context, stage, config, config.training, partial(network_of, config))


def _check(context: StageContext, config: PeerConfig) -> None:
    from motionkit.clips.temporal.training import check_corpus

    check_corpus(context, config.training)


def _stage(
    name: str, order: int, description: str, recipes: Mapping[str, Callable[[], PeerConfigT]]
) -> Stage[PeerConfigT]:
    return Stage(
        name=name,
        order=order,
        description=description,
        recipes=recipes,
        train=partial(_train, name),
        check=_check,
        in_all=False,
    )


LIIF = _stage("liif", 70, "LIIF over time: a local MLP around each frame (PA-HiRes' peer)", LIIF_RECIPES)
META_SR = _stage("meta-sr", 71, "Meta-SR over time: weights for every place between frames", META_SR_RECIPES)
A_LIIF = _stage("a-liif", 72, "A-LIIF over time: LIIF with an MLP mixed at every instant", A_LIIF_RECIPES)
LMF = _stage("lmf", 73, "LMF over time: frames modulate a small MLP", LMF_RECIPES)
DELTA_INTERP = _stage("delta-interp", 74, "Δ-Interp: in-betweening relative to an interpolation", DELTA_INTERP_RECIPES)
TS_FORMER = _stage("ts-former", 75, "TS-Former: in-betweening by a draft and its refinement", TS_FORMER_RECIPES)
