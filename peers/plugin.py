"""Other people's systems: their stages, models and motion encoders (`motionkit.core.plugins`)."""

from functools import partial
from typing import Any

from motionkit.core.plugins import lazily
from motionkit.training.run import Loader, Task

# Title, and the declaration of each stage; the last stage loads the system.
GENERATING = {
    "mdm": ("MDM", {"mdm": "mdm:MDM"}),
    "mdm-50": ("MDM, 50 steps", {"mdm-50": "mdm:MDM_50"}),
    "mld": ("MLD", {"mld-vae": "mld:MLD_VAE", "mld": "mld:MLD"}),
    "inr-mlp": ("INR-MLP", {"inr-mlp": "inr_mlp:INR_MLP"}),
    "actor": ("ACTOR", {"actor": "actor:ACTOR"}),
    "t2m": ("T2M", {"t2m-autoencoder": "t2m:T2M_AUTOENCODER", "t2m": "t2m:T2M"}),
    "camdm": ("CAMDM", {"camdm": "camdm:CAMDM"}),
    "flow": ("ACMDM-S (flow)", {"flow": "flow:FLOW"}),
    "jl2p": ("JL2P", {"jl2p": "jl2p:JL2P"}),
    "hier": ("Hier", {"hier": "hier:HIER"}),
    "nemf": ("NeMF", {"nemf-path": "nemf:NEMF_PATH", "nemf": "nemf:NEMF"}),
}
INTERPOLATING = {
    "liif": ("LIIF", {"liif": "super_resolution:LIIF"}),
    "meta-sr": ("Meta-SR", {"meta-sr": "super_resolution:META_SR"}),
    "a-liif": ("A-LIIF", {"a-liif": "super_resolution:A_LIIF"}),
    "lmf": ("LMF", {"lmf": "super_resolution:LMF"}),
}
INBETWEENING = {
    "delta-interp": ("Δ-Interp", {"delta-interp": "delta_interp:DELTA_INTERP"}),
    "ts-former": ("TS-Former", {"ts-former": "ts_former:TS_FORMER"}),
}


def _loader(title: str, stages: dict[str, str], *tasks: Task) -> Loader[Any]:
    place = f"peers.{list(stages.values())[-1]}.load"
    return Loader(title, tuple(stages), partial(lazily(place), title=title), tasks=tasks)


STAGES = {
    stage: f"peers.{place}.stage"
    for systems in (INTERPOLATING, INBETWEENING, GENERATING)
    for _, stages in systems.values()
    for stage, place in stages.items()
}
MODELS = {name: _loader(*system) for name, system in GENERATING.items()}
ENCODERS = {
    **{name: _loader(*system, "interpolation") for name, system in INTERPOLATING.items()},
    **{name: _loader(*system, "inbetweening") for name, system in INBETWEENING.items()},
}
