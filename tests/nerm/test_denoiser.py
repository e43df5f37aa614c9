"""Training the denoiser on posteriors whose distribution is known; resuming it; sampling from what was saved."""

import numpy as np
import pytest
import torch

from motionkit.generate.models import SamplingOptions
from motionkit.training.loop import train_loop
from motionkit.training.networks import NO_ACTION, Conditions, guided, window_conditions
from motionkit.training.run import RunFolder
from nerm.denoiser import ACTION_SHARE, DROP, DenoiserTraining, LatentCorpus
from nerm.model import TrainedDenoiser, load_denoiser, save_denoiser
from nerm.recipes import DenoiserConfig, TransformerConfig
from tests.nerm.small_fields import changed

TEXTS = ("a person walks", "someone is walking", "a jump")
NETWORK = TransformerConfig(num_layers=3, width=32, num_heads=2, ffn_width=64, dropout=0.0, latent_tokens=2)
CONFIG = changed(
    DenoiserConfig(network=NETWORK, ema_decay=0.98),
    "conditions.text_encoder=none diffusion.guidance_scale=2.0 schedule.batch_size=64 schedule.steps=350 "
    "schedule.epochs=none schedule.learning_rate=0.003 schedule.kind=cosine",
)
WALK_MEAN, JUMP_MEAN = torch.full((8,), 3.0), torch.tensor([-1.0, 5.0] * 4)


def embed(texts: list[str]) -> torch.Tensor:
    """A unit vector for each of TEXTS, zeros for none."""
    return torch.stack([torch.eye(4)[TEXTS.index(text)] if text else torch.zeros(4) for text in texts])


def mixture_corpus(windows: int = 60) -> LatentCorpus:
    """Half of the windows walk (two captions), half jump; every third has an action only, of the same meaning."""
    generator = torch.Generator().manual_seed(5)
    is_jump = torch.arange(windows) % 2
    means = torch.where(is_jump[:, None] > 0, JUMP_MEAN, WALK_MEAN) + 0.3 * torch.randn(windows, 8, generator=generator)
    captions = [() if i % 3 == 0 else (TEXTS[2:] if i % 2 else TEXTS[:2]) for i in range(windows)]
    actions = ["jump" if i % 2 else "walk" for i in range(windows)]
    return LatentCorpus(
        means,
        torch.full((windows, 8), 2 * float(np.log(0.2))),
        window_conditions(captions, actions, torch.linspace(0.2, 1.0, windows), embed),
    )


@pytest.fixture(scope="module")
def mixture(tmp_path_factory) -> tuple[TrainedDenoiser, RunFolder]:
    run = RunFolder(tmp_path_factory.mktemp("run"))
    folder = run.stage("denoiser")
    folder.path.mkdir()
    training = DenoiserTraining(CONFIG, mixture_corpus(), seed=0, device=torch.device("cpu"))
    train_loop(training, folder, seed=0)
    model = training.finished(text_fingerprint="", field_sha256="f" * 64)
    save_denoiser(folder, model)
    folder.finish({"loss": 1.0})
    return model, run


def conditions(count: int, text: int | None = None, action: int = NO_ACTION) -> Conditions:
    row = torch.zeros(4) if text is None else torch.eye(3, 4)[text]
    return Conditions.zero_masked(row.repeat(count, 1), torch.full((count,), action), torch.full((count,), 0.6))


@pytest.mark.parametrize("guidance_scale", [1.0, 2.0])
def test_texts_and_actions_lead_to_their_latents(mixture, guidance_scale):
    model, _ = mixture
    for given, expected in (
        (conditions(100, text=0), WALK_MEAN),
        (conditions(100, text=1), WALK_MEAN),
        (conditions(100, text=2), JUMP_MEAN),
        (conditions(100, action=model.layout.action_index("walk")), WALK_MEAN),
        (conditions(100, action=model.layout.action_index("jump")), JUMP_MEAN),
    ):
        found = model.sample(given, seed=1, sampling=SamplingOptions(guidance_scale))
        # The two means are 3 apart on the average; windows of one duration are few, and are learned by heart.
        assert float((found.mean(0) - expected).abs().max()) < 0.8


def test_samples_follow_the_seed_and_not_the_batch(mixture):
    model, _ = mixture
    many = model.sample(conditions(5, text=0), seed=3)
    torch.testing.assert_close(many, model.sample(conditions(5, text=0), seed=3), rtol=0, atol=0)
    torch.testing.assert_close(many[:2], model.sample(conditions(2, text=0), seed=3), rtol=1e-4, atol=1e-4)
    assert not torch.allclose(many, model.sample(conditions(5, text=0), seed=4))
    assert len(torch.unique(many.round(decimals=2), dim=0)) == 5


def test_what_was_saved_samples_the_same(mixture):
    model, run = mixture
    loaded = load_denoiser(run)
    assert loaded.layout == model.layout
    assert loaded.config == model.config
    torch.testing.assert_close(
        loaded.sample(conditions(3, text=0), seed=3), model.sample(conditions(3, text=0), seed=3), rtol=0, atol=0
    )
    torch.testing.assert_close(loaded.draw_durations(4, seed=2), model.draw_durations(6, seed=2)[:4])
    assert set(loaded.draw_durations(50, seed=0).tolist()) <= set(model.durations.tolist())


def test_conditions_are_mixed_as_configured():
    corpus = mixture_corpus()
    rows = torch.arange(len(corpus.means)).repeat(300)
    chance = torch.rand((3, len(rows)), generator=torch.Generator().manual_seed(0))
    given = corpus.conditions.draw(rows, chance, drop=DROP, action_share=ACTION_SHARE)
    has_text, has_action = given.text.any(1), given.action >= 0
    assert not (has_text & has_action).any()
    captioned = corpus.conditions.num_captions[rows] > 0
    assert float((~has_text & ~has_action).float().mean()) == pytest.approx(0.1, abs=0.01)
    assert float(has_action[~captioned].float().mean()) == pytest.approx(0.9, abs=0.01)
    assert float(has_action[captioned].float().mean()) == pytest.approx(0.9 * 0.25, abs=0.01)
    walking = captioned & (rows % 2 == 0) & has_text
    shares = given.text[walking].mean(0)
    assert shares[:2].tolist() == pytest.approx([0.5, 0.5], abs=0.03)
    assert shares[2:].tolist() == [0.0, 0.0]


def test_guidance_is_equation_6_in_one_batch_and_keeps_the_duration():
    given = Conditions.zero_masked(torch.randn(3, 5), torch.arange(3) % 2, torch.linspace(0.2, 1.0, 3))
    nothing, batches = given.unconditional(), []
    assert not nothing.text.any() and set(nothing.action.tolist()) == {NO_ACTION}
    assert torch.equal(nothing.duration, given.duration)

    def denoiser(latents, steps, given):
        batches.append(len(latents))
        return latents + given.text.sum(dim=1, keepdim=True) + 10 * given.action[:, None] + given.duration[:, None]

    latents, steps = torch.randn(3, 4), torch.full((3,), 7)
    found = guided(denoiser, latents, steps, given.paired(nothing, 7.5), 7.5)
    expected = 7.5 * denoiser(latents, steps, given) - 6.5 * denoiser(latents, steps, nothing)
    torch.testing.assert_close(found, expected)
    # A guidance of one, or of nothing, is a single pass.
    guided(denoiser, latents, steps, given.paired(nothing, 1.0), 1.0)
    guided(denoiser, latents, steps, nothing.paired(nothing, 1.0), nothing.guidance(7.5))
    assert batches == [6, 3, 3, 3, 3] and given.guidance(7.5) == 7.5
