"""Other people's systems: their stages, models and motion encoders (`motionkit.core.plugins`)."""

from functools import partial
from typing import Any

from motionkit.core.plugins import lazily
from motionkit.training.run import Loader, Task

# Title, task (None: generation), module and stages. A stage's declaration has its name in capitals; the last one loads.
SYSTEMS: dict[str, tuple[str, Task | None, str, tuple[str, ...]]] = {
    "liif": ("LIIF", "interpolation", "super_resolution", ("liif",)),
    "meta-sr": ("Meta-SR", "interpolation", "super_resolution", ("meta-sr",)),
    "a-liif": ("A-LIIF", "interpolation", "super_resolution", ("a-liif",)),
    "lmf": ("LMF", "interpolation", "super_resolution", ("lmf",)),
    "delta-interp": ("Δ-Interp", "inbetweening", "inbetweening", ("delta-interp",)),
    "ts-former": ("TS-Former", "inbetweening", "inbetweening", ("ts-former",)),
    "mdm": ("MDM", None, "diffusion", ("mdm",)),
    "mdm-50": ("MDM, 50 steps", None, "diffusion", ("mdm-50",)),
    "mld": ("MLD", None, "diffusion", ("mld-vae", "mld")),
    "inr-mlp": ("INR-MLP", None, "latents", ("inr-mlp",)),
    "actor": ("ACTOR", None, "latents", ("actor",)),
    "t2m": ("T2M", None, "recurrent", ("t2m-autoencoder", "t2m")),
    "camdm": ("CAMDM", None, "diffusion", ("camdm",)),
    "flow": ("ACMDM-S (flow)", None, "diffusion", ("flow",)),
    "jl2p": ("JL2P", None, "recurrent", ("jl2p",)),
    "hier": ("Hier", None, "recurrent", ("hier",)),
    "nemf": ("NeMF", None, "latents", ("nemf-path", "nemf")),
}
STAGES: dict[str, str] = {}
MODELS: dict[str, Loader[Any]] = {}
ENCODERS: dict[str, Loader[Any]] = {}
for name, (title, task, module, stages) in SYSTEMS.items():
    places = {stage: f"peers.{module}:{stage.upper().replace('-', '_')}" for stage in stages}
    STAGES |= {stage: f"{place}.stage" for stage, place in places.items()}
    load = partial(lazily(f"{places[stages[-1]]}.load"), title=title)
    if task is None:
        MODELS[name] = Loader(title, stages, load)
    else:
        ENCODERS[name] = Loader(title, stages, load, tasks=(task,))
