"""A generative model in Python: what is asked for becomes motions; longer ones from pieces that meet."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import motionkit as mk
from motionkit.generate import models
from motionkit.generate.long_motions import OVERLAP_SECONDS, generate_joined, pieces_of
from motionkit.generate.models import GenerationRequest
from motionkit.training.run import Loader, RunFolder
from tests.helpers.analytic import analytic_motion
from tests.helpers.plugin_lists import install_only
from tests.helpers.scripted_model import ScriptedModel


def script(request: models.GenerationRequest, chance: tuple[int, int]):
    """A body that moves along z at a speed that its text, seed and number give."""
    speed = len(request.text) + 0.1 * chance[0] + 0.01 * chance[1]
    body = np.random.default_rng(0).normal(size=(22, 3))
    return lambda seconds: (body + speed * seconds[:, None, None] * np.array([0, 0, 1])).astype(np.float32)


class Drawing(ScriptedModel):
    """Draws a length of 1.5 s where none is asked for, and knows no "fly"."""

    def generate(self, requests, *, seed, sampling=models.SamplingOptions(), first=0):
        self.sampling = sampling
        requests = [
            request if request.duration_seconds else models.GenerationRequest(1.5, request.text, request.action)
            for request in requests
        ]
        return super().generate(requests, seed=seed, sampling=sampling, first=first)

    def check(self, request, sampling=models.SamplingOptions()):
        if "fly" in (request.text, request.action):
            raise mk.UsageError("it cannot fly")


@pytest.fixture
def model() -> mk.MotionModel:
    """A model of up to 4 s, trained at up to 120 fps."""
    return mk.MotionModel(Drawing(script, 4.0), Path("runs/nano"))


def test_one_text_is_one_motion(model: mk.MotionModel) -> None:
    motion = model.generate("a walk", fps=60, seconds=2)
    assert isinstance(motion, mk.Motion)
    assert motion.num_frames == 120 and motion.fps == 60 and motion.duration_seconds == 2.0
    assert motion.captions == (mk.Caption("a walk"),) and motion.sequence_id == "0000-a-walk"
    speed = np.diff(motion.joint_positions[:, 0, 2]).mean() * 60
    assert speed == pytest.approx(len("a walk"), rel=1e-3)


def test_several_texts_or_a_number_are_a_list(model: mk.MotionModel) -> None:
    assert [m.sequence_id for m in model.generate("walk", seconds=1, n=2)] == ["0000-walk", "0001-walk"]
    assert len(model.generate("walk", seconds=1, n=1)) == 1
    assert [m.captions[0].text for m in model.generate(["a", "b"], seconds=1)] == ["a", "b"]
    assert [m.captions[0].text for m in model.generate(("a", "b"), seconds=1, n=2)] == ["a", "a", "b", "b"]


def test_a_motion_is_the_same_at_every_framerate_and_in_every_number(model: mk.MotionModel) -> None:
    slow = model.generate("walk", fps="30", seconds=2, seed=3)
    fast = model.generate("walk", fps=60, seconds=2, seed=3, n=3)
    np.testing.assert_allclose(fast[0].joint_positions[::2], slow.joint_positions, atol=1e-5)
    assert np.abs(fast[1].joint_positions - fast[0].joint_positions).max() > 1e-3


def test_framerates_lengths_and_conditions_by_default(model: mk.MotionModel) -> None:
    motion = model.generate()
    assert motion.fps == 120 and motion.duration_seconds == 1.5
    assert motion.captions == () and motion.sequence_id == "0000-unconditional"
    acted = model.generate(action="run", fps=23.976, seconds=1)
    assert acted.action == "run" and acted.fps == Fraction(24000, 1001)
    options = mk.SamplingOptions(guidance_scale=2.0)
    model.generate("walk", seconds=1, sampling=options)
    assert model.model.sampling == options  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        *(({"text": text}, "text") for text in ("", ["a", " "], [])),
        ({"action": ""}, "action"),
        ({"n": 0}, "n"),
        ({"text": ["walk", "fly"], "seconds": 1}, "fly"),
        ({"text": "walk", "seconds": 4000}, "3600"),
        ({"text": "walk", "fps": "fast"}, "fast"),
    ],
)
def test_all_is_checked_before_the_first_is_made(model: mk.MotionModel, given: dict, message: str) -> None:
    with pytest.raises((mk.UsageError, ValueError), match=message):
        model.generate(**given)
    assert model.model.asked == 0  # type: ignore[attr-defined]


def load_plain(run: Path) -> "Drawing":
    if run.name == "damaged":
        raise mk.MotionkitError(f"{run} is damaged")
    return Drawing(script)


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A model that a plain function loads, and one with a loader of two stages."""
    full = Loader("Full", ("first", "second"), lambda run: Drawing(script, 2.0))
    install_only(monkeypatch, MODELS={"full": full, "plain": load_plain})


@pytest.mark.usefixtures("installed")
def test_the_model_that_a_run_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    stages = {"held": ["plain"], "half": ["first"], "both": ["plain", "first", "second"], "damaged": ["plain"]}
    for run, names in {**stages, "empty": []}.items():
        (tmp_path / "runs" / run).mkdir(parents=True)
        for stage in names:
            folder = RunFolder(tmp_path / "runs" / run).stage(stage)
            folder.path.mkdir()
            folder.finish({"loss": 1.0})
    full, plain = models.installed_models().values()
    assert list(models.installed_models()) == ["full", "plain"]
    assert full.begun_in(Path("runs/half")) and not full.complete_in(Path("runs/half"))
    assert full.complete_in(Path("runs/both")) and not plain.begun_in(Path("runs/half"))
    for run in ("runs/held", Path("runs/held"), "held"):
        model = mk.load_model(run)
        assert model.run == Path("runs/held") and model.name == "NeRM"
    assert mk.generate("walk", run="held", seconds=1, fps=20).num_frames == 20
    assert mk.load_model("both", "full").model.max_duration_seconds == 2.0
    for run, name in (("both", None), ("damaged", None), ("empty", None), ("held", "third"), ("nowhere", None)):
        with pytest.raises(mk.MotionkitError, match=name or run):
            mk.load_model(run, name)


def requests_of(*seconds, text="walks"):
    return tuple(GenerationRequest(each, text=f"{text} {number}") for number, each in enumerate(seconds))


class Performer:
    """Motions that follow from seed, number and length; every other one a walk."""

    name, skeleton, max_training_fps, max_duration_seconds = "Performer", mk.SMPL22, Fraction(120), 4.0

    def text_encoder(self):
        return None

    def generate(self, requests, *, seed, sampling=None, first=0):
        fields = []
        for number, request in enumerate(requests, start=first):
            field = analytic_motion("walk" if number % 2 else "squat", request.duration_seconds, (seed + number) % 100)
            fields.append(replace(field, skeleton=mk.SMPL22))
        return fields


@given(seconds=st.lists(st.floats(0.6, 60.0), min_size=1, max_size=4), longest=st.floats(1.0, 12.0))
def test_pieces_make_up_the_script_to_the_second(seconds, longest):
    overlap, wanted = OVERLAP_SECONDS, requests_of(*seconds)
    pieces = pieces_of(wanted, longest)
    lengths = np.array([piece.duration_seconds for piece in pieces])
    assert (lengths <= longest + 1e-9).all() and (lengths > overlap).all()
    assert lengths.sum() - (len(pieces) - 1) * overlap == pytest.approx(sum(seconds))
    # Where one request gives way to the next, the middle of the overlap is the end of its seconds.
    middles = np.cumsum(lengths - overlap) + overlap / 2
    of_request = [[piece for piece in pieces if piece.text == request.text] for request in wanted]
    last = np.cumsum([len(each) for each in of_request]) - 1
    np.testing.assert_allclose(middles[last][:-1], np.cumsum(seconds)[:-1])
    for each in of_request:
        assert len(set(each)) == 1
        # One piece fewer would not do.
        shorter = len(each) - 1
        span = each[0].duration_seconds * len(each) - (len(each) - 1) * overlap
        assert shorter == 0 or (span + (shorter - 1) * overlap) / shorter > longest


@pytest.mark.parametrize(
    ("seconds", "longest"), [((8.0,), 0.9), ((2.0, 0.4), 4.0), ((2.0, None), 4.0), ((float("inf"),), 4.0)]
)
def test_what_cannot_be_joined(seconds, longest):
    with pytest.raises(mk.UsageError):
        pieces_of(requests_of(*seconds), longest)


def test_a_motion_follows_from_its_seed_and_number():
    instants = np.linspace(0.0, 9.0, 50)

    def poses(**options):
        return generate_joined(Performer(), requests_of(9.0), **options).query(instants).joint_positions

    np.testing.assert_array_equal(poses(seed=1, number=2), poses(seed=1, number=2))
    assert np.abs(poses(seed=1, number=2) - poses(seed=1, number=3)).max() > 1e-3
    assert np.abs(poses(seed=1, number=2) - poses(seed=2, number=2)).max() > 1e-3
