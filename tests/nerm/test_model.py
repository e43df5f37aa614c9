"""NeRM as a generative model: requests become conditions, durations and latents."""

import math
from fractions import Fraction

import numpy as np
import pytest
import torch

from motionkit.core.errors import MissingExtraError, UsageError
from motionkit.core.skeleton import SMPL22
from motionkit.generate.models import GenerationRequest, SamplingOptions
from motionkit.training.config import DiffusionConfig
from motionkit.training.loop import seeded_initialisation
from motionkit.training.networks import ConditionSizes
from motionkit.training.run import RunError
from nerm.latents import ALWAYS, LatentSpace
from nerm.model import NermModel, TrainedDenoiser, TrainedField
from nerm.network import Denoiser
from nerm.recipes import DenoiserConfig, FieldConfig, TransformerConfig

NETWORK = TransformerConfig(num_layers=3, width=16, num_heads=2, ffn_width=32, dropout=0.0)


class KnownField(TrainedField):
    """A field whose motions are not decoded."""

    max_duration_seconds, max_training_fps, skeleton = 8.0, Fraction(120), SMPL22
    config = FieldConfig(pose_vectors="native")

    def __init__(self):
        pass


def known_model(text_fingerprint: str = "") -> NermModel:
    layout = ConditionSizes(text_dimension=6, actions=("jump", "walk"))
    with seeded_initialisation(0, "test"):
        denoiser = Denoiser(NETWORK, torch.full((4,), ALWAYS), layout)
    trained = TrainedDenoiser(
        config=DenoiserConfig(network=NETWORK, diffusion=DiffusionConfig(sampling_steps=5, guidance_scale=2.0)),
        denoiser=denoiser.eval(),
        space=LatentSpace(None, torch.full((4,), 5.0), torch.ones(4)),
        layout=layout,
        durations=torch.tensor([0.25, 0.5]),
        text_encoder="letters",
        text_fingerprint=text_fingerprint,
        field_sha256="",
    )
    return NermModel(KnownField(), trained)


class LetterEncoder:
    """Embeds a text as the counts of six letters, and counts the texts it saw."""

    name, fingerprint, dimension = "letters", "ab" * 32, 6

    def __init__(self):
        self.seen = []

    def encode(self, texts):
        self.seen.extend(texts)
        return np.array([[text.count(letter) for letter in "abcdjw"] for text in texts], dtype=np.float32)


@pytest.fixture
def encoder(monkeypatch):
    letters = LetterEncoder()
    monkeypatch.setattr("motionkit.training.text.load_text_encoder", lambda name: letters)
    return letters


def test_seeds_and_requests_decide(encoder):
    model = known_model(LetterEncoder.fingerprint)
    requests = [GenerationRequest(2.0, text=text) for text in ("a jump", "a walk", "a jump")]

    def latents(seed, **options):
        return torch.stack([field.latent for field in model.generate(requests, seed=seed, **options)])

    first = latents(0)
    assert torch.equal(first, latents(0))
    assert not torch.allclose(first, latents(1))
    assert not torch.allclose(first[0], first[2])
    for other in (SamplingOptions(guidance_scale=5.0), SamplingOptions(sampler="ddpm"), SamplingOptions(steps=4)):
        assert not torch.allclose(first, latents(0, sampling=other))
    torch.testing.assert_close(first, latents(0, sampling=SamplingOptions(2.0, "ddim", 5)), rtol=0, atol=0)
    assert encoder.seen == ["a jump", "a walk"] * 7


@pytest.mark.parametrize(
    ("sampling", "why"),
    [
        (SamplingOptions(sampler="euler"), "ddim, ddpm"),
        (SamplingOptions(steps=1001), "has 1 … 1000"),
        (SamplingOptions(guidance_scale=math.nan), "a finite number .*, not nan"),
    ],
)
def test_sampling_that_there_is_not_is_explained(sampling, why):
    with pytest.raises(UsageError, match=why):
        known_model().generate([GenerationRequest(1.0)], seed=0, sampling=sampling)


def test_durations_come_from_the_data_where_none_is_asked_for():
    model = known_model()
    fields = model.generate([GenerationRequest(None)] * 30 + [GenerationRequest(1.5)], seed=0)
    assert {field.end_seconds for field in fields[:-1]} == {2.0, 4.0}
    assert fields[-1].end_seconds == 1.5


def test_conditions_that_make_no_sense_are_refused(encoder):
    with pytest.raises(UsageError, match=r"no action 'swim'; it knows jump, walk"):
        known_model().generate([GenerationRequest(1.0, action="swim")], seed=0)
    with pytest.raises(UsageError, match="trained without texts"):
        known_model().generate([GenerationRequest(1.0, text="a walk")], seed=0)


def test_of_a_text_and_an_action_the_text_counts(encoder):
    def latent(model, **condition):
        return model.generate([GenerationRequest(1.0, **condition)], seed=0)[0].latent

    with_texts, without = known_model(LetterEncoder.fingerprint), known_model()
    both, text, action = {"text": "a jump", "action": "walk"}, {"text": "a jump"}, {"action": "walk"}
    assert torch.equal(latent(with_texts, **both), latent(with_texts, **text))
    assert torch.equal(latent(without, **both), latent(without, **action))
    assert not torch.equal(latent(with_texts, **both), latent(with_texts, **action))


def test_another_encoder_than_the_trained_one_is_refused(encoder):
    with pytest.raises(RunError, match="is not the one that the model was trained with"):
        known_model("cd" * 32).generate([GenerationRequest(1.0, text="a walk")], seed=0)


def test_without_the_encoder_actions_work_and_texts_say_what_to_install(monkeypatch):
    def missing(name):
        raise MissingExtraError("letters", "text")

    monkeypatch.setattr("motionkit.training.text.load_text_encoder", missing)
    model = known_model(LetterEncoder.fingerprint)
    assert len(model.generate([GenerationRequest(1.0, action="walk"), GenerationRequest(1.0)], seed=0)) == 2
    with pytest.raises(UsageError, match=r"'letters'.*pip install.*an action, such as walk, needs none"):
        model.generate([GenerationRequest(1.0, text="a walk")], seed=0)
