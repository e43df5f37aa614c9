"""Which evaluator of text and motion a request gets, and what it is told otherwise."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from eval.sets.sets import SampleSet
from eval.tables.nerm.table1 import text_motion_evaluators
from eval.text_motion.guo import evaluator
from eval.text_motion.guo.kind import GuoFiles
from eval.text_motion.protocol import find_text_motion_protocol
from motionkit.core.errors import UsageError
from motionkit.core.motion import Caption
from tests.helpers.table_request import table_request


class Loaded:
    """What `load_guo` would have loaded."""

    name, fingerprint, fps, layout = "guo", "1", None, "smpl22"

    def __init__(self, files: GuoFiles) -> None:
        self.files = files

    def remark_at(self, fps: Fraction) -> str:
        return ""

    def embed_motions(self, samples: SampleSet) -> np.ndarray:
        raise NotImplementedError

    def embed_texts(self, captions: list[Caption]) -> np.ndarray:
        raise NotImplementedError


PUBLISHED = GuoFiles(Path("finest.tar"), glove=Path("glove"))


def evaluators(protocol: str, **changes: object) -> tuple[list[object], list[str]]:
    request = table_request(Path("store"), Path("results"), **changes)
    found = text_motion_evaluators(request, find_text_motion_protocol(protocol))
    return list(found), list(request.missing.lines)


@pytest.mark.parametrize(
    ("protocol", "compat", "stated", "padding"),
    [
        ("t2m", (), "masked", "masked"),
        ("mdm", (), "masked", "masked"),
        ("t2m", ("padding-leak",), "masked", "zeros"),
        ("mdm", ("padding-leak",), "masked", "frames"),
        ("t2m", ("padding-leak",), "frames", "frames"),
    ],
)
def test_the_padding_leak_is_switched_on_by_name(
    protocol: str, compat: tuple[str, ...], stated: str, padding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evaluator, "load_guo", Loaded)
    files = GuoFiles(PUBLISHED.weights, PUBLISHED.glove, padding=stated)  # type: ignore[arg-type]
    found, missing = evaluators(protocol, features=("guo",), guo=files, compat=compat)
    assert [each.files.padding for each in found] == [padding]  # type: ignore[attr-defined]
    assert not missing


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"features": ("guo",)}, "needs its weights: --weights finest.tar"),
        ({"features": ("guo",), "guo": GuoFiles(Path("finest.tar"))}, "--glove DIR"),
        ({"compat": ("padding-leak",)}, "a bug of Guo's evaluator"),
        ({"compat": ("no-such",)}, "protocol 't2m' has no such bug"),
        ({"features": ("motion-clip",)}, "needs its folder: --motion-clip DIR"),
        ({"features": ("temos",)}, "--evaluator temos: not an evaluator of text and motion; give native, guo"),
    ],
)
def test_what_cannot_be_had_is_reported(changes: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        evaluators("t2m", **changes)


def test_one_that_is_missing_leaves_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluator, "load_guo", Loaded)
    found, missing = evaluators("native", features=("guo", "native"), guo=PUBLISHED)
    assert [each.files for each in found] == [PUBLISHED]  # type: ignore[attr-defined]
    assert missing == [
        "evaluator 'native': it belongs to a run, and none was given (motionkit train --stage evaluator)"
    ]
