"""The stage `tmr` of `motionkit train`: a small evaluator of text–motion retrieval from a store's training split."""

from functools import partial

from eval.tmr.settings import TmrConfig, base, demo, nano
from motionkit.training.stage import Stage, StageContext


def train_tmr(context: StageContext, config: TmrConfig) -> None:
    """Train the evaluator; writes RUN/tmr/model.safetensors, which `load_tmr` reads.

    Raises `UsageError` for a store without captions.
    """
    from eval.native_evaluator.bank import build_banks
    from eval.native_evaluator.evaluator import describe_training
    from eval.native_evaluator.network import MIN_POSES
    from eval.native_evaluator.stage import LAYOUT, takes_of_cache
    from eval.native_evaluator.training import collect_sentences
    from eval.tmr.evaluator import STAGE_NAME, VERSION
    from eval.tmr.training import TmrTraining
    from motionkit.core.errors import UsageError
    from motionkit.core.timegrid import parse_fps
    from motionkit.store.cache import cache_root, open_cache
    from motionkit.training.config import to_plain
    from motionkit.training.devices import resolve_device
    from motionkit.training.loop import train_loop
    from motionkit.training.tensors import save_tensors
    from motionkit.training.text import embed_texts, load_text_encoder

    store, training = context.open_store(), config.training
    takes = takes_of_cache(store, open_cache(store, layout=LAYOUT, where=training.where or None))
    if not any(caption.text.strip() for some in takes.captions for caption in some):
        raise UsageError("the stage tmr learns from captions, and the store's training split has none")
    folder = context.begin(STAGE_NAME, config, store_fingerprint=store.fingerprint)
    framerates = [parse_fps(fps) for fps in training.framerates]
    banks = build_banks(takes, framerates, training.bank_seconds, MIN_POSES, context.seed)
    encoder = load_text_encoder(training.text_encoder)
    cache = cache_root(store.path, store.fingerprint)
    sentences = collect_sentences(takes.captions, partial(embed_texts, encoder, folder=cache))
    trainable = TmrTraining(config, banks, sentences, context.seed, resolve_device(context.device))
    latest = train_loop(trainable, folder, steps=training.steps, seed=context.seed, on_progress=context.on_progress)
    header = describe_training(to_plain(config), store.fingerprint, [bank.fps for bank in banks], encoder)
    save_tensors(folder.model_path, trainable.model_tensors(), header | {"version": VERSION, "targets": []})
    folder.finish({**latest, "sequences": len(takes.fps), "sentences": len(sentences.embeddings)})


STAGE = Stage(
    name="tmr",
    description="a small evaluator of text-motion retrieval, after TMR",
    recipes={"nano": nano, "small": nano, "demo": demo, "base": base},
    train=train_tmr,
    in_all=False,
)
