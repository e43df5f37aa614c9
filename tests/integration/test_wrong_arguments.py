"""What people pass to the front door by mistake is answered in one line that says what was expected."""

import json
import subprocess
import sys
import textwrap

import pytest

from tests.helpers.repository import REPOSITORY
from tests.helpers.small_bvh import bvh_text

# In a process of its own, for this one checks the types of all arguments itself.
SCRIPT = textwrap.dedent(
    """
    import json, sys
    from pathlib import Path
    import numpy as np
    import motionkit as mk
    from motionkit.generate.motion import MotionModel
    from tests.helpers.drift_model import DriftModel

    array, motion = np.zeros((9, 22, 3), np.float32), mk.read("walk.bvh")
    with mk.StoreWriter.create("store") as writer:
        writer.add(motion)
    store, model = mk.Store.open("store"), MotionModel(DriftModel(), Path("runs/drift"))
    for code in json.loads(sys.argv[1]):
        try:
            eval(code)
        except Exception as error:
            print(json.dumps([type(error).__name__, str(error)]))
        else:
            print(json.dumps(["", ""]))
    """
)
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
def answers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[str, str]]:
    folder = tmp_path_factory.mktemp("project")
    (folder / "walk.bvh").write_text(bvh_text())
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, json.dumps(list(ANSWERED))],
        cwd=folder,
        env={"PYTHONPATH": str(REPOSITORY), "PATH": ""},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return dict(zip(ANSWERED, map(json.loads, done.stdout.splitlines()), strict=True))


@pytest.mark.parametrize("code", ANSWERED)
def test_a_wrong_argument_is_answered_in_one_line(code: str, answers: dict[str, tuple[str, str]]) -> None:
    kind, message = answers[code]
    assert kind in ("UsageError", "MotionkitError")
    assert ANSWERED[code] in message
    assert "--" not in message and "\n" not in message  # no options of the command line
