"""A model over MMCP: the SDK's own client asks a server on the loopback."""

from collections.abc import Iterator
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest

import motionkit as mk
from motionkit.core.kinematics import forward_kinematics_matrices
from tests.helpers.drift_model import Drift, DriftModel

NEEDED = "needs the extra motionkit[serve]"
motionmcp, uvicorn = (pytest.importorskip(name, reason=NEEDED) for name in ("motionmcp", "uvicorn"))
client, mmcp = (pytest.importorskip(name, reason=NEEDED) for name in ("motionmcp.client", "motionkit.generate.mmcp"))


class Listening(DriftModel):
    """Drifts, and remembers the constraints and sampling options of the last call."""

    constraint_kinds = frozenset(("path", "pose", "joint"))
    constraints: tuple[mk.Constraint, ...] = ()
    sampling = mk.SamplingOptions()

    def generate(self, requests, *, seed, sampling=None, first=0):  # type: ignore[no-untyped-def]
        self.constraints, self.sampling = requests[0].constraints, sampling
        return super().generate(requests, seed=seed, first=first)


@pytest.fixture(scope="module")
def model() -> Listening:
    return Listening()


@pytest.fixture(scope="module")
def address(model: Listening) -> Iterator[str]:
    app = motionmcp.build_app(mmcp.ServedModel(mk.MotionModel(model, Path("runs/drift")), "drift"))
    server = uvicorn.Server(uvicorn.Config(app, port=0, log_level="error", ws="none"))
    thread = Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        assert thread.is_alive()
    yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    server.should_exit = True
    thread.join()


def answer(address: str, **request: Any) -> list[dict[str, Any]]:
    [described] = client.get_capabilities(address)["models"]
    body = {"protocol_version": "1.4", "model": "drift", "skeleton": described["canonical_skeleton"]}
    samples: list[dict[str, Any]] = client.parse_gltf_samples(client.generate(address, body | request, timeout=60))
    return samples


def positions(sample: dict[str, Any]) -> np.ndarray:
    matrices, places = sample["local_rot_mats"].astype(np.float64), sample["local_translations"].astype(np.float64)
    return forward_kinematics_matrices(matrices, places[:, 0], mk.SMPL22, places)


TEXT = {"type": "text", "prompt": "a person drifts", "duration_frames": 48}


def test_what_is_served_is_said(address: str) -> None:
    [described] = client.get_capabilities(address)["models"]
    assert (described["id"], described["fps"], described["native_clip_seconds"]) == ("drift", 120.0, 10.0)
    assert set(described["supported_constraints"]) == {"root_path", "pose_keyframe", "effector_target"}
    joints = described["canonical_skeleton"]["joints"]
    assert tuple(joint["name"] for joint in joints) == mk.SMPL22.joint_names
    assert 0.7 < joints[0]["rest_translation"][1] < 1.1


@pytest.mark.parametrize("fps", [24000 / 1001, 60.0, 144.0])
def test_motions_are_the_models_at_the_framerate_of_the_request(address: str, fps: float) -> None:
    options = {"seed": 3, "num_samples": 2, "post_processing": False}
    for number, sample in enumerate(answer(address, segments=[TEXT], timing={"fps": fps}, options=options)):
        expected = Drift(3 + number / 10, 48 / fps).query(np.arange(48) / fps).joint_positions
        assert sample["fps"] == pytest.approx(fps) and sample["joint_names"] == list(mk.SMPL22.joint_names)
        np.testing.assert_allclose(positions(sample), expected, atol=1e-4)


def test_segments_follow_one_another(address: str) -> None:
    segments = [TEXT, {"type": "unconditioned", "duration_frames": 30}]
    [sample] = answer(address, segments=segments, timing={"fps": 30.0}, options={"post_processing": False})
    assert sample["num_frames"] == 78


def test_constraints_are_ours(address: str, model: Listening) -> None:
    lifted = (0.0, 0.0, float(np.sin(0.5)), float(np.cos(0.5)))  # one radian about Z+
    place = {"type": "root_path", "frames": [0, 30], "positions_xz": [(0, 0), (0, 1.5)], "heading_radians": [0, 1]}
    point = {"type": "root_path", "frames": [47], "positions_xz": [(0, 2)]}
    hand = {"type": "effector_target", "joint": "right_wrist", "frames": [10, 11], "positions": [(0, 1, 0.2)] * 2}
    pose = {"type": "pose_keyframe", "frame": 30, "joint_rotations": {"pelvis": (0, 0, 0, 1), "left_hip": lifted}}
    whole = {**pose, "root_position": (1.0, 0.9, 2.0), "fill_mode": "rest"}
    answer(address, segments=[TEXT], timing={"fps": 30.0}, constraints=[place, point, hand, pose, whole])
    path, end, wrist, free, placed = model.constraints
    assert (path.kind, path.seconds[-1]) == ("path", 1.0)
    np.testing.assert_allclose(path.positions[-1, 0, [0, 2]], (0, 1.5))
    np.testing.assert_allclose(path.heading[[0, -1]], (0, 1))
    assert end.places_motion and end.seconds.tolist() == [47 / 30] and np.isnan(end.heading).all()
    assert wrist.joints == ("right_wrist",) and wrist.seconds.tolist() == [10 / 30, 11 / 30]
    assert not free.places_motion and placed.places_motion
    assert set(free.joints) == {"pelvis", "left_hip", "right_hip", "spine1", "left_knee"}
    assert free.positions[..., 1].min() == pytest.approx(0.0)
    assert placed.joints == mk.SMPL22.joint_names
    np.testing.assert_allclose(placed.positions[0, 0], (1.0, 0.9, 2.0))
    knee = placed.positions[0, 4] - placed.positions[0, 1]
    np.testing.assert_allclose(knee / np.linalg.norm(knee), (np.sin(1), -np.cos(1), 0), atol=1e-5)


def test_options_are_ours(address: str, model: Listening) -> None:
    answer(address, segments=[TEXT])
    assert model.sampling == mk.SamplingOptions()
    answer(address, segments=[TEXT], options={"diffusion_steps": 7, "guidance": {"type": "regular", "weight": [3.5]}})
    assert model.sampling == mk.SamplingOptions(guidance_scale=3.5, steps=7)
    answer(address, segments=[TEXT], options={"guidance": {"type": "nocfg"}})
    assert model.sampling == mk.SamplingOptions(guidance_scale=1.0)


@pytest.mark.parametrize(
    ("request_of", "code", "why"),
    [
        ({"options": {"guidance": {"type": "separated", "weight": [1, 2]}}}, "invalid_options", "one weight"),
        ({"segments": [TEXT, {**TEXT, "duration_frames": 20}]}, "invalid_request", "each lasts longer than the 0.5 s"),
        ({"segments": [{**TEXT, "duration_frames": 10**6}], "timing": {"fps": 10**5}}, "invalid_request", "60,000"),
        ({"model": "other"}, "unknown_model", "drift"),
    ],
)
def test_what_cannot_be_answered_is_said(address: str, request_of: dict[str, Any], code: str, why: str) -> None:
    with pytest.raises(client.MmcpError) as caught:
        answer(address, **({"segments": [TEXT], "timing": {"fps": 60.0}} | request_of))
    assert caught.value.code == code and why in f"{caught.value} {caught.value.details}"
