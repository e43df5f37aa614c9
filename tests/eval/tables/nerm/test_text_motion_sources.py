"""Which evaluator of text and motion a request gets, and what it is told otherwise."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from eval.sets.sets import SampleSet
from eval.tables.nerm.table1 import text_motion_evaluators
from eval.text_motion.guo import evaluator
from eval.text_motion.guo.kind import GuoFiles
from motionkit.core.errors import UsageError
from motionkit.core.motion import Caption
from tests.helpers.table_request import table_request


class Loaded:
    """What `load_guo` would have loaded."""

    name, fingerprint, fps, layout, pair_score = "guo", "1", None, "smpl22", ""

    def __init__(self, files: GuoFiles) -> None:
        self.files = files

    def remark_at(self, fps: Fraction) -> str:
        return ""

    def embed_motions(self, samples: SampleSet) -> np.ndarray:
        raise NotImplementedError

    def embed_texts(self, captions: list[Caption]) -> np.ndarray:
        raise NotImplementedError


PUBLISHED = GuoFiles(Path("finest.tar"), glove=Path("glove"))


def evaluators(**changes: object) -> tuple[list[object], list[str]]:
    request = table_request(Path("store"), Path("results"), **changes)
    found = text_motion_evaluators(request)
    return list(found), list(request.missing.lines)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"features": ("guo",)}, "needs its weights: --weights finest.tar"),
        ({"features": ("guo",), "guo": GuoFiles(Path("finest.tar"))}, "--glove DIR"),
        ({"features": ("motion-clip",)}, "needs its folder: --motion-clip DIR"),
        ({"features": ("temos",)}, "--evaluator temos: not an evaluator of text and motion; give native, guo"),
    ],
)
def test_what_cannot_be_had_is_reported(changes: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        evaluators(**changes)


def test_one_that_is_missing_leaves_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluator, "load_guo", Loaded)
    found, missing = evaluators(features=("guo", "native"), guo=PUBLISHED)
    assert [each.files for each in found] == [PUBLISHED]  # type: ignore[attr-defined]
    assert missing == [
        "evaluator 'native': it belongs to a run, and none was given (motionkit train --stage evaluator)"
    ]
