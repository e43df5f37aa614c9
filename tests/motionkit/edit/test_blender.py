"""Exported files in Blender, where there is one: its joints stand where the motion's do."""

import json
import os
import subprocess
from fractions import Fraction

import numpy as np
import pytest

from tests.helpers.analytic import capture

PYTHON = os.environ.get("MOTIONKIT_BLENDER")
LOOK = """
import bpy, json, sys
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = 120
if sys.argv[1].endswith(".glb"):
    bpy.ops.import_scene.gltf(filepath=sys.argv[1])
else:
    bpy.ops.import_anim.bvh(filepath=sys.argv[1], global_scale=0.01, update_scene_fps=True)
(body,) = (each for each in bpy.data.objects if each.type == "ARMATURE")
bpy.context.scene.frame_set(int(body.animation_data.action.frame_range[0]) + 37)
posed = body.evaluated_get(bpy.context.evaluated_depsgraph_get())
print("FOUND", json.dumps({bone.name: list(posed.matrix_world @ bone.head) for bone in posed.pose.bones}))
"""


@pytest.mark.skipif(not PYTHON, reason="needs Blender: set MOTIONKIT_BLENDER to a Python that has bpy")
@pytest.mark.parametrize(("kind", "millimetres"), [("glb", 0.01), ("bvh", 0.05)])
def test_joints_stand_where_they_did(kind, millimetres, tmp_path):
    motion = capture(Fraction(120), "walk", 2.0)
    motion.save(tmp_path / f"walk.{kind}")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    command = [PYTHON, "-c", LOOK, str(tmp_path / f"walk.{kind}")]
    printed = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    found = json.loads(printed.partition("FOUND")[2].splitlines()[0])
    assert set(found) == set(motion.skeleton.joint_names)
    # Blender's z is up, and its y points backwards.
    joints = np.array([found[name] for name in motion.skeleton.joint_names])[:, [0, 2, 1]] * (1, 1, -1)
    assert 1000 * np.abs(joints - motion.joint_positions[37]).max() < millimetres
