"""Stage `codebook`: from a store to trained codes."""

import dataclasses
import time
from functools import partial
from pathlib import Path
from typing import Any

import torch

from motionkit.store.cache import PositionCache, open_cache
from motionkit.store.reader import Store
from motionkit.training.devices import float32_products, resolve_device, with_precision_of
from motionkit.training.loop import train_loop
from motionkit.training.stage import StageContext
from motionkit.training.tensors import prefixed, save_tensors
from nerm.codebook.network import FORMAT, FORMAT_VERSION
from nerm.codebook.published import PublishedCodebook, load_published
from nerm.codebook.training import CodebookTraining
from nerm.codebook.vectors import check_lengths, open_vectors, prepare_vectors, remove_vectors
from nerm.recipes import NermConfig
from nerm.settings import CodebookConfig


def train_codebook(context: StageContext, config: NermConfig) -> None:
    """Train the VQ-VAE, or use T2M-GPT's own; write codes [N, d], network and statistics to model.safetensors."""
    store, device, ranks = context.open_store(), resolve_device(context.device), context.ranks
    settings = with_precision_of(config.codebook, device)
    config = dataclasses.replace(config, codebook=settings)
    description = {"format": FORMAT, "version": FORMAT_VERSION, "fps": settings.fps, "convention": FORMAT}
    published = _published(settings)
    if published is not None:
        facts = _facts(published)
        folder = context.begin("codebook", config, store_fingerprint=store.fingerprint)
        if ranks.is_first:
            save_tensors(folder.model_path, _tensors(published), {**description, **facts})
            folder.finish({"codes": len(published.codes), "from": settings.published.weights, **facts})
        return
    started = time.perf_counter()
    source = _source(store, settings)
    folder = context.begin("codebook", config, store_fingerprint=store.fingerprint)
    vectors = folder.path / "vectors.f32"
    ranks.on_first(partial(prepare_vectors, source, settings, vectors))
    corpus = open_vectors(settings, vectors)
    training = CodebookTraining(corpus, settings, seed=context.seed, device=device, ranks=ranks)
    with float32_products(settings.precision):
        context.fit_budget(training, folder)
        figures = train_loop(
            training,
            folder,
            steps=training.steps,
            seed=context.seed,
            ranks=ranks,
            on_progress=context.on_progress,
        )
    if not ranks.is_first:
        return
    tensors = {"codes": training.network.quantiser.codes, "mean": corpus.mean, "scale": corpus.scale}
    network = {f"network.{name}": tensor for name, tensor in training.network.state_dict().items()}
    save_tensors(folder.model_path, tensors | network, description)
    remove_vectors(vectors)
    facts = {"poses": len(corpus.vectors), "wall_seconds": round(time.perf_counter() - started, 1)}
    folder.finish({**figures, **facts})


def _published(settings: CodebookConfig) -> PublishedCodebook | None:
    """T2M-GPT's own VQ-VAE if configured; loaded before anything is written."""
    if not settings.published.weights:
        return None
    statistics = Path(settings.published.statistics) if settings.published.statistics else None
    return load_published(Path(settings.published.weights), statistics)


def _tensors(published: PublishedCodebook) -> dict[str, torch.Tensor]:
    tensors = {"codes": published.codes} | prefixed("network", published.network.state_dict())
    if published.statistics is not None:
        tensors["mean"] = torch.from_numpy(published.statistics.mean).float()
        tensors["scale"] = torch.from_numpy(published.statistics.std).float()
    return tensors


def _facts(published: PublishedCodebook) -> dict[str, Any]:
    statistics = "not given" if published.statistics is None else "evaluator"
    return {"convention": "T2M-GPT", "numbers": published.num_features, "statistics": statistics}


def check_codebook(context: StageContext, config: NermConfig) -> None:
    """Raise early what would stop this stage: no sequence that is long enough, missing published weights."""
    if _published(config.codebook) is None:
        _source(context.open_store(), config.codebook)


def _source(store: Store, settings: CodebookConfig) -> PositionCache:
    source = open_cache(store, layout="smpl22", where=settings.where or None)
    check_lengths(source, settings)
    return source
