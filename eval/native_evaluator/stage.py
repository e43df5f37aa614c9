"""The stage `evaluator` of `motionkit train`: the native-rate evaluator from a store's training split."""

from functools import partial
from typing import TYPE_CHECKING

from eval.native_evaluator.settings import NativeConfig, base, demo, nano, paper
from motionkit.training.stage import Stage, StageContext

if TYPE_CHECKING:
    from eval.native_evaluator.bank import Takes
    from motionkit.store.cache import PositionCache
    from motionkit.store.reader import Store

LAYOUT = "smpl22"


def train_evaluator(context: StageContext, config: NativeConfig) -> None:
    """Train the evaluator; writes RUN/evaluator/model.safetensors, which `load_native` reads."""
    import numpy as np
    import torch

    from eval.native_evaluator.bank import build_banks
    from eval.native_evaluator.evaluator import STAGE_NAME, describe_training
    from eval.native_evaluator.training import NativeTraining, collect_sentences
    from motionkit.core.timegrid import parse_fps
    from motionkit.store.cache import cache_root, open_cache
    from motionkit.training.config import to_plain
    from motionkit.training.devices import resolve_device
    from motionkit.training.loop import train_loop
    from motionkit.training.tensors import save_tensors
    from motionkit.training.text import embed_texts, load_text_encoder

    store = context.open_store()
    takes = takes_of_cache(store, open_cache(store, layout=LAYOUT, where=config.training.where or None))
    folder = context.begin(STAGE_NAME, config, store_fingerprint=store.fingerprint)
    training = config.training
    framerates = [parse_fps(fps) for fps in training.framerates]
    banks = build_banks(takes, framerates, training.bank_seconds, training.min_poses, context.seed)
    has_text = bool(training.text_encoder) and any(takes.captions)
    encoder = load_text_encoder(training.text_encoder) if has_text else None
    if encoder is None:
        sentences = collect_sentences((), lambda texts: np.zeros((len(texts), 0), dtype=np.float32))
    else:
        cache = cache_root(store.path, store.fingerprint)
        sentences = collect_sentences(takes.captions, partial(embed_texts, encoder, folder=cache))
    trainable = NativeTraining(config, banks, sentences, context.seed, resolve_device(context.device))
    latest = train_loop(trainable, folder, steps=training.steps, seed=context.seed, on_progress=context.on_progress)
    reached = [bank.fps for bank in banks]
    save_tensors(
        folder.model_path,
        trainable.model_tensors() | {"statistics.whitening": torch.from_numpy(trainable.whitening(context.seed))},
        describe_training(to_plain(config), store.fingerprint, reached, encoder),
    )
    folder.finish(
        {
            **latest,
            "sequences": len(takes.fps),
            "sentences": len(sentences.embeddings),
            "fps": [str(fps) for fps in reached],
        }
    )


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
    recipes={"nano": nano, "small": nano, "demo": demo, "base": base, "paper": paper},
    train=train_evaluator,
    share=0.2,
)
