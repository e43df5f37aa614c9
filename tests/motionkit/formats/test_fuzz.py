"""Damaged files of every format end in an explained error or in a motion, never in anything else."""

import contextlib
import io
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from motionkit.errors import MotionkitError
from motionkit.formats.annotations import read_annotations
from motionkit.formats.asf import read_asf
from motionkit.formats.asfamc import read_asfamc
from motionkit.formats.bvh import read_bvh
from motionkit.formats.items import ReadOptions
from motionkit.formats.joints_csv import read_joints_csv
from motionkit.formats.joints_npy import read_joints_npy, read_manifest
from motionkit.formats.npz import read_npz
from motionkit.formats.texts import read_texts
from tests.motionkit.formats.samples import ASF, amc_text, bvh_text

OPTIONS = ReadOptions(fps=Fraction(120), unit_metres=0.01)
SNIPPETS = st.sampled_from(
    b'|\n| |{|}|\0|\xff|nan|1e999|-|0|99999999999999999999|#|,|"|OFFSET|CHANNELS|End Site|MOTION|Frames: 3|JOINT x|'
    b":root|begin|end|root 1".split(b"|")
)


def npy_bytes() -> bytes:
    file = io.BytesIO()
    np.save(file, np.zeros((3, 22, 3), np.float32))
    return file.getvalue()


def npz_bytes() -> bytes:
    file = io.BytesIO()
    np.savez(file, joint_positions=np.zeros((3, 22, 3), np.float32), fps=30.0, captions=np.array(["walks"]))
    return file.getvalue()


def _asf_beside(path: Path) -> None:
    (path.parent / "07.asf").write_text(ASF)
    read_asfamc(path, OPTIONS)


READERS: dict[str, tuple[bytes, Callable[[Path], object]]] = {
    "bvh": (bvh_text().encode(), lambda path: read_bvh(path, OPTIONS)),
    "amc": (amc_text().encode(), _asf_beside),
    "asf": (ASF.encode(), read_asf),
    "npy": (npy_bytes(), lambda path: read_joints_npy(path, OPTIONS)),
    "joints.csv": (b"time_seconds,a_x,a_y,a_z\n0.0,1,2,3\n0.5,1,2,3.5\n", read_joints_csv),
    "npz": (npz_bytes(), lambda path: read_npz(path, OPTIONS)),
    "txt": (b"a person walks#a/DET person/NOUN walk/VERB#0.0#1.5\nfast#fast/ADV#0.0#0.0\n", read_texts),
    "csv": (b'file,caption,fps\nwalk.bvh,"a person, walking",120\nrun.bvh,run,30000/1001\n', read_annotations),
    "json": (b'{"fps": "30000/1001", "layout": "smpl22", "unit_metres": 1.0}', read_manifest),
}


@st.composite
def damage(draw: st.DrawFn, content: bytes) -> bytes:
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(content)))
        stop = start + draw(st.sampled_from([0, 0, 1, 1, 2, 8, 64, len(content)]))
        content = content[:start] + draw(st.one_of(SNIPPETS, st.binary(max_size=8))) + content[stop:]
    return content


@pytest.mark.parametrize("kind", READERS)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_only_explained_errors_come_out(tmp_path: Path, kind: str, data: st.DataObject) -> None:
    content, reader = READERS[kind]
    path = tmp_path / f"07_01.{kind}"
    path.write_bytes(data.draw(damage(content)))
    with contextlib.suppress(MotionkitError):
        reader(path)
