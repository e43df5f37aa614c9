"""The stages `evaluator` and `tmr` of `motionkit train`: evaluators of text and motion from a training split."""

from functools import partial
from typing import TYPE_CHECKING

from eval.native_evaluator import settings
from eval.native_evaluator.settings import NativeConfig, TmrConfig
from motionkit.training.run import Stage, StageContext

if TYPE_CHECKING:
    from eval.native_evaluator.bank import Takes
    from motionkit.store.cache import PositionCache
    from motionkit.store.reader import Store

LAYOUT = "smpl22"


def train_evaluator(context: StageContext, config: NativeConfig) -> None:
    """Train the native-rate evaluator; writes RUN/evaluator/model.safetensors, which `load_native` reads."""
    _train(context, config, "evaluator", config.training.min_poses)


def train_tmr(context: StageContext, config: TmrConfig) -> None:
    """Train the evaluator of retrieval; writes RUN/tmr/model.safetensors, which `load_tmr` reads.

    Raises `UsageError` for a store without captions.
    """
    from eval.native_evaluator.network import MIN_POSES

    _train(context, config, "tmr", MIN_POSES)


def _train(context: StageContext, config: NativeConfig | TmrConfig, stage: str, min_poses: int) -> None:
    import numpy as np

    from eval.native_evaluator.bank import build_banks
    from eval.native_evaluator.evaluator import describe_training
    from eval.native_evaluator.training import EvaluatorTraining, collect_sentences
    from motionkit.core.errors import UsageError
    from motionkit.core.timegrid import parse_fps
    from motionkit.store.cache import cache_root, open_cache
    from motionkit.training.config import to_plain
    from motionkit.training.devices import resolve_device
    from motionkit.training.loop import save_tensors, train_loop
    from motionkit.training.text import embed_texts, load_text_encoder

    store, training = context.open_store(), config.training
    takes = takes_of_cache(store, open_cache(store, layout=LAYOUT, where=training.where or None))
    has_text = bool(training.text_encoder) and any(takes.captions)
    if stage == "tmr" and not any(caption.text.strip() for some in takes.captions for caption in some):
        raise UsageError("the stage tmr learns from captions, and the store's training split has none")
    folder = context.begin(stage, config, store_fingerprint=store.fingerprint)
    framerates = [parse_fps(fps) for fps in training.framerates]
    banks = build_banks(takes, framerates, training.bank_seconds, min_poses, context.seed)
    encoder = load_text_encoder(training.text_encoder) if has_text else None
    if encoder is None:
        sentences = collect_sentences((), lambda texts: np.zeros((len(texts), 0), dtype=np.float32))
    else:
        cache = cache_root(store.path, store.fingerprint)
        sentences = collect_sentences(takes.captions, partial(embed_texts, encoder, folder=cache))
    trainable = EvaluatorTraining(stage, config, banks, sentences, context.seed, resolve_device(context.device))
    latest = train_loop(trainable, folder, seed=context.seed, on_progress=context.on_progress)
    reached = [bank.fps for bank in banks]
    header = describe_training(stage, to_plain(config), store.fingerprint, reached, encoder)
    save_tensors(folder.model_path, trainable.model_tensors(), header)
    counts = {"sequences": len(takes.fps), "sentences": len(sentences.embeddings)}
    folder.finish({**latest, **counts, "fps": [str(fps) for fps in reached]})


def takes_of_cache(store: "Store", cache: "PositionCache") -> "Takes":
    """The sequences of a position cache with their framerates and captions."""
    from fractions import Fraction

    import numpy as np

    from eval.native_evaluator.bank import Takes
    from eval.sets.sets import Ragged
    from motionkit.core.motion import Caption

    captions = store.sequences_table["captions"].take(store.rows_of(cache.sequence_index)).to_pylist()
    rates = zip(cache.fps_numerator.tolist(), cache.fps_denominator.tolist(), strict=True)
    return Takes(
        sequences=Ragged(cache.positions, cache.start_row, cache.num_frames.astype(np.int64)),
        fps=tuple(Fraction(*rate) for rate in rates),
        captions=tuple(tuple(Caption(**caption) for caption in some) for some in captions),
    )


STAGE = Stage(
    name="evaluator",
    description="the native-rate evaluator: corruption strengths and captions of clips at every framerate",
    recipes={
        "nano": settings.nano,
        "small": settings.nano,
        "demo": settings.demo,
        "base": settings.base,
        "paper": settings.paper,
    },
    train=train_evaluator,
    share=0.2,
)
TMR = Stage(
    name="tmr",
    description="a small evaluator of text-motion retrieval, after TMR",
    recipes={
        "nano": settings.tmr_nano,
        "small": settings.tmr_nano,
        "demo": settings.tmr_demo,
        "base": settings.tmr_base,
    },
    train=train_tmr,
)
