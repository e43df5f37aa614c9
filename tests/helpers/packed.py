"""What a page holds, unpacked as its script does; what its own scripts answer."""

import base64
import json
import re
import shutil
import subprocess
from importlib import resources
from typing import Any

import numpy as np
import pytest

from motionkit.viz.player import Packed

HALF_STEP = 5.1e-5
"""Metres by which positions that come back may be off."""


def unpack(packed: Packed) -> np.ndarray:
    """The positions that a page shows, in metres: those that were packed, to half a step. The page does the same."""
    root = np.frombuffer(base64.b64decode(packed["root"]), "<f4").reshape(-1, 1, 3)
    steps = np.frombuffer(base64.b64decode(packed["steps"]), "<i2").reshape(len(root), -1, 3)
    return (root + steps * packed["stepMetres"]).astype(np.float32)


def page_data(page: str) -> dict[str, Any]:
    """The title, the note and the takes of a page."""
    (found,) = re.findall(r'<script id="data" type="application/json">(.*?)</script>', page, re.DOTALL)
    data: dict[str, Any] = json.loads(found)
    return data


def in_script(scripts: list[str], expression: str, data: object) -> Any:
    """What an expression of `data` is to the page's own scripts."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs node, to run the page's script")
    parts = resources.files("motionkit.viz") / "player_page"
    code = "\n".join(parts.joinpath(name).read_text(encoding="utf-8") for name in scripts)
    code += f'\nconst data = JSON.parse(require("fs").readFileSync(0));\nconsole.log(JSON.stringify({expression}));'
    ran = subprocess.run([node, "-e", code], input=json.dumps(data), capture_output=True, text=True, check=True)
    return json.loads(ran.stdout)
