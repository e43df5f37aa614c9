"""Other people's systems: their stages, models and motion encoders (`motionkit.core.plugins`)."""

from functools import partial
from typing import Any

from motionkit.core.plugins import lazily
from motionkit.training.run import Loader, Task

STAGES = {
    "liif": "peers.liif:SYSTEM.stage",
    "meta-sr": "peers.meta_sr:SYSTEM.stage",
    "a-liif": "peers.a_liif:SYSTEM.stage",
    "lmf": "peers.lmf:SYSTEM.stage",
    "delta-interp": "peers.delta_interp:SYSTEM.stage",
    "ts-former": "peers.ts_former:SYSTEM.stage",
    "mdm": "peers.mdm:MDM.stage",
    "mdm-50": "peers.mdm:MDM_50.stage",
    "mld-vae": "peers.mld:MLD_VAE.stage",
    "mld": "peers.mld:MLD.stage",
    "inr-mlp": "peers.inr_mlp:INR_MLP.stage",
    "actor": "peers.actor:ACTOR.stage",
    "t2m-autoencoder": "peers.t2m:T2M_AUTOENCODER.stage",
    "t2m": "peers.t2m:T2M.stage",
    "camdm": "peers.camdm:CAMDM.stage",
    "flow": "peers.flow:FLOW.stage",
    "jl2p": "peers.jl2p:JL2P.stage",
    "hier": "peers.hier:HIER.stage",
    "nemf-path": "peers.nemf:NEMF_PATH.stage",
    "nemf": "peers.nemf:NEMF.stage",
}


def _loader(title: str, *stages: str, tasks: tuple[Task, ...] = ()) -> Loader[Any]:
    """The loader of a system from its last stage."""
    place = STAGES[stages[-1]].removesuffix(".stage")
    return Loader(title, stages, partial(lazily(f"{place}.load"), title=title), tasks=tasks)


MODELS = {
    "mdm": _loader("MDM", "mdm"),
    "mdm-50": _loader("MDM, 50 steps", "mdm-50"),
    "mld": _loader("MLD", "mld-vae", "mld"),
    "inr-mlp": _loader("INR-MLP", "inr-mlp"),
    "actor": _loader("ACTOR", "actor"),
    "t2m": _loader("T2M", "t2m-autoencoder", "t2m"),
    "camdm": _loader("CAMDM", "camdm"),
    "flow": _loader("ACMDM-S (flow)", "flow"),
    "jl2p": _loader("JL2P", "jl2p"),
    "hier": _loader("Hier", "hier"),
    "nemf": _loader("NeMF", "nemf-path", "nemf"),
}
ENCODERS = {
    "liif": _loader("LIIF", "liif", tasks=("interpolation",)),
    "meta-sr": _loader("Meta-SR", "meta-sr", tasks=("interpolation",)),
    "a-liif": _loader("A-LIIF", "a-liif", tasks=("interpolation",)),
    "lmf": _loader("LMF", "lmf", tasks=("interpolation",)),
    "delta-interp": _loader("Δ-Interp", "delta-interp", tasks=("inbetweening",)),
    "ts-former": _loader("TS-Former", "ts-former", tasks=("inbetweening",)),
}
