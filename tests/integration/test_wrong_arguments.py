"""What people pass to the front door by mistake is answered in one line that says what was expected."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import motionkit as mk
from tests.helpers.drift_model import DriftModel
from tests.helpers.format_samples import bvh_text

ANSWERED = {
    "mk.plant(array)": "not ndarray",
    "mk.complete(array, fps=60)": "not ndarray",
    "mk.view(array)": "not ndarray",
    "mk.read(array)": "not ndarray",
    "list(mk.read_all(motion))": "not Motion",
    "mk.read('nowhere.bvh')": "nowhere.bvh does not exist",
    "store[0:3]": "not by a slice",
    "store[1.0]": "not by a float",
    "model.generate(3)": "not 3",
    "model.generate(['a walk', 3])": "a list of texts",
    "mk.complete(motion)": "fps",
    "mk.complete(motion, keep='0:900')": "keep 0:900",
    "mk.complete(motion, extend='-1')": "extend -1",
    "mk.complete(motion, extend=90)": "extended by at most 60 s",
    "mk.complete(motion, fps=60, model='slerp', run='mine')": "slerp is an interpolator",
}


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("project")
    (folder / "walk.bvh").write_text(bvh_text())
    motion = mk.read(folder / "walk.bvh")
    with mk.StoreWriter.create(folder / "store") as writer:
        writer.add(motion)
    model = mk.MotionModel(DriftModel(), Path("runs/drift"))
    array = np.zeros((9, 22, 3), np.float32)
    return {"mk": mk, "array": array, "motion": motion, "store": mk.Store.open(folder / "store"), "model": model}


@pytest.mark.parametrize("code", ANSWERED)
def test_a_wrong_argument_is_answered_in_one_line(code, names, unchecked_annotations):
    with pytest.raises(mk.MotionkitError) as caught:
        eval(code, names)
    message = str(caught.value)
    assert ANSWERED[code] in message
    assert "--" not in message and "\n" not in message  # no options of the command line
