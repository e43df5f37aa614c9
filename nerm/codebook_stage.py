"""Stage `codebook`: from a store to trained codes."""

import time
from pathlib import Path

from motionkit.store.cache import open_cache
from motionkit.store.reader import Store
from motionkit.training.device import resolve_device
from motionkit.training.loop import train_loop
from motionkit.training.stage import StageContext
from motionkit.training.tensors import save_tensors
from nerm.codebook import published_codes
from nerm.codebook_training import CodebookTraining, build_vector_corpus
from nerm.recipes import NermConfig


def train_codebook(context: StageContext, config: NermConfig) -> None:
    """Train the VQ-VAE, or take the codes of T2M-GPT's own checkpoint; writes codes [N, d] to model.safetensors."""
    settings, store = config.codebook, Store.open(context.store)
    folder = context.begin("codebook", config, store_fingerprint=store.fingerprint)
    description = {"format": "nerm-codebook", "version": 1, "fps": settings.fps, "convention": "nerm-codebook"}
    if settings.published_weights:
        codes = published_codes(Path(settings.published_weights))
        save_tensors(folder.model_path, {"codes": codes}, {**description, "convention": "T2M-GPT"})
        folder.finish({"codes": len(codes), "from": settings.published_weights})
        return
    started = time.perf_counter()
    source = open_cache(store, layout="smpl22", where=settings.where or None)
    corpus = build_vector_corpus(source, settings, folder.path / "vectors.f32")
    training = CodebookTraining(corpus, settings, seed=context.seed, device=resolve_device(context.device))
    figures = train_loop(training, folder, steps=settings.steps, seed=context.seed)
    tensors = {"codes": training.network.quantiser.codes, "mean": corpus.mean, "scale": corpus.scale}
    network = {f"network.{name}": tensor for name, tensor in training.network.state_dict().items()}
    save_tensors(folder.model_path, tensors | network, description)
    for leftover in (folder.path / "vectors.f32", folder.path / "vectors.json"):
        leftover.unlink(missing_ok=True)
    facts = {"poses": len(corpus.vectors), "wall_seconds": round(time.perf_counter() - started, 1)}
    folder.finish({**figures, **facts})
