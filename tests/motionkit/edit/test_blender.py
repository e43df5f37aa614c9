"""Exported files in Blender, where there is one: its joints stand where the motion's do."""

import json
import os
import subprocess
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from motionkit.fields.motion_field import to_motion
from tests.helpers.analytic import analytic_motion

LOOK = """
import bpy, json, sys
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = 120
if sys.argv[1].endswith(".glb"):
    bpy.ops.import_scene.gltf(filepath=sys.argv[1])
else:
    bpy.ops.import_anim.bvh(filepath=sys.argv[1], global_scale=0.01, update_scene_fps=True)
(body,) = (each for each in bpy.data.objects if each.type == "ARMATURE")
first = int(body.animation_data.action.frame_range[0])
bpy.context.scene.frame_set(first + 37)
posed = body.evaluated_get(bpy.context.evaluated_depsgraph_get())
print("FOUND", json.dumps({bone.name: list(posed.matrix_world @ bone.head) for bone in posed.pose.bones}))
"""


@pytest.mark.parametrize(("kind", "millimetres"), [("glb", 0.01), ("bvh", 0.05)])
def test_joints_stand_where_they_did(kind: str, millimetres: float, tmp_path: Path) -> None:
    python = os.environ.get("MOTIONKIT_BLENDER")
    if not python:
        pytest.skip("needs Blender: set MOTIONKIT_BLENDER to a Python that has bpy")
    motion = to_motion(analytic_motion("walk", 2.0), Fraction(120))
    motion.save(tmp_path / f"walk.{kind}")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [python, "-c", LOOK, str(tmp_path / f"walk.{kind}")],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    (line,) = (line for line in done.stdout.splitlines() if line.startswith("FOUND"))
    found = json.loads(line.removeprefix("FOUND"))
    assert set(found) == set(motion.skeleton.joint_names)
    # Blender's z is up, and its y points backwards.
    joints = np.array([found[name] for name in motion.skeleton.joint_names])[:, [0, 2, 1]] * (1, 1, -1)
    assert 1000 * np.abs(joints - motion.joint_positions[37]).max() < millimetres
