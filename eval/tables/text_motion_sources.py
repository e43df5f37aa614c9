"""The evaluators of text and motion that can be had: a run's own, or a published one where its files are named."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from eval.evaluators.guo.files import Padding
from eval.evaluators.text_motion import TextMotionEvaluator
from eval.protocols.compat import PADDING_LEAK, chosen_bugs
from eval.protocols.text_motion import TextMotionProtocol
from eval.tables.registry import TableRequest
from motionkit.errors import MotionkitError, UsageError

DEFAULT = ("native",)


def text_motion_evaluators(
    request: TableRequest, protocol: TextMotionProtocol, missing: list[str]
) -> list[TextMotionEvaluator]:
    """The evaluators that were asked for, `native` where none was; one that cannot be had is named in `missing`.

    Raises `UsageError` for a name that is no evaluator of text and motion, for a known bug that the protocol or the
    evaluator does not have, and where not one can be had.
    """
    chosen_bugs(protocol.name, protocol.known_bugs, request.compat)
    known: dict[str, Callable[[TableRequest], TextMotionEvaluator]] = {
        "native": _native,
        "guo": partial(_guo, leak=protocol.leak),
    }
    evaluators, reasons = [], []
    for name in request.features or DEFAULT:
        if name not in known:
            raise UsageError(f"--evaluator {name}: not an evaluator of text and motion; give {', '.join(known)}")
        try:
            evaluators.append(known[name](request))
        except MotionkitError as error:
            reasons.append(f"evaluator {name!r}: {error}")
    if not evaluators:
        raise UsageError("; ".join(reasons))
    missing.extend(reasons)
    return evaluators


def _native(request: TableRequest) -> TextMotionEvaluator:
    from eval.evaluators.native.evaluator import load_native
    from eval.evaluators.native.text_motion import NativeTextMotion

    if PADDING_LEAK.name in request.compat:
        raise UsageError(f"--compat {PADDING_LEAK.name} is a bug of Guo's evaluator: --evaluator guo --weights FILE")
    if request.run is None:
        raise MotionkitError("it belongs to a run, and none was given (motionkit train --stage evaluator)")
    return NativeTextMotion(load_native(request.run))


def _guo(request: TableRequest, leak: Padding) -> TextMotionEvaluator:
    from eval.evaluators.guo.evaluator import load_guo

    if request.guo is None:
        raise UsageError("--evaluator guo needs its weights: --weights finest.tar (docs/evaluators.md)")
    if request.guo.glove is None:
        raise UsageError("--evaluator guo reads captions with GloVe's word vectors: --glove DIR (docs/evaluators.md)")
    if PADDING_LEAK.name in request.compat and request.guo.padding == "masked":
        return load_guo(replace(request.guo, padding=leak))
    return load_guo(request.guo)
