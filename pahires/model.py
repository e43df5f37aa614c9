"""PA-HiRes: multi-scale temporal encoding, parametric activations, progressive cross-scale attention, one decoder.

The frames' part of every scale's encoder does not depend on the query: it is computed once per segment between observed
frames, and a query adds its own times.
"""

import math
from itertools import pairwise

import torch

from motionkit.core.shapes import Float, Int64
from pahires.activation import FourierActivation, linear
from pahires.recipes import RECIPES, NetworkSettings, PaHiResConfig
from pahires.temporal.base_curves import located, seconds_beyond
from pahires.temporal.network import ObservedWindow
from pahires.temporal.prediction import num_answers
from pahires.temporal.system import TemporalSystem

# Signed times enter as asinh(Δt · 30 / s): linear in frames nearby, logarithmic far away.
_FRAME_SECONDS = 1 / 30
_TINY = 1e-3


class PaHiRes(torch.nn.Module):
    """The network of Eq. 2 to 7, a `TemporalNetwork`, with `num_outputs` a query (`num_features` by default)."""

    time_frequencies: torch.Tensor

    def __init__(self, settings: NetworkSettings, num_features: int, num_outputs: int | None = None) -> None:
        super().__init__()
        self.settings = settings
        activations = _Activations(settings)
        bands = settings.time_band * torch.rand(settings.time_features)
        self.register_buffer("time_frequencies", bands)
        num_times = 2 * settings.time_features + 2
        self.scales = torch.nn.ModuleList(
            ScaleEncoder(count, num_features, settings, activations) for count in settings.frames_per_scale
        )
        self.attentions = torch.nn.ModuleList(
            CrossScaleAttention(settings.code, settings.attention_tokens) for _ in settings.frames_per_scale[1:]
        )
        # The decoder's first layer in two parts; the frames' part is shared by a segment.
        self.context = linear(settings.code * len(settings.frames_per_scale), settings.hidden, settings.initialisation)
        self.when = linear(num_times, settings.hidden, settings.initialisation)
        widths = [settings.hidden] * settings.decoder_layers
        self.decoder = torch.nn.Sequential(activations.next(), *_layers(widths, settings, activations))
        self.answer = torch.nn.Linear(settings.hidden, num_outputs or num_features)
        # Initial output zero: the mean pose, or the unchanged interpolation.
        torch.nn.init.zeros_(self.answer.weight)
        torch.nn.init.zeros_(self.answer.bias)

    def forward(self, window: ObservedWindow) -> Float[torch.Tensor, "batch queries numbers"]:
        """Standardised rows at the queries."""
        segment, times = self._time_features(window)
        num_frames = window.frames.shape[1]
        rows = torch.arange(len(segment), device=segment.device)[:, None]
        places, place = torch.unique(rows * num_frames + segment, return_inverse=True)
        row, segments = places // num_frames, places % num_frames
        codes = [scale(window, row, segments) for scale in self.scales]
        fused = codes[:1]
        for attention, finer, coarser in zip(self.attentions, codes, codes[1:], strict=False):
            fused.append(attention(finer, coarser))
        context = self.context(torch.cat(fused, dim=-1))
        hidden = (context[place] + self.when(times)) / math.sqrt(2)
        answer: torch.Tensor = self.answer(self.decoder(hidden))
        return answer

    def _time_features(
        self, window: ObservedWindow
    ) -> tuple[Int64[torch.Tensor, "batch queries"], Float[torch.Tensor, "batch queries times"]]:
        """The segment of each query, its position in it as Fourier features of [−1, 1], and the segment's length."""
        segment, fraction = located(window)
        angle = (2 * fraction - 1)[..., None] * self.time_frequencies
        last = window.times_seconds.shape[1] - 1
        before, after = (
            window.times_seconds.gather(1, segment),
            window.times_seconds.gather(1, (segment + 1).clamp(max=last)),
        )
        apart = torch.stack((after - before, seconds_beyond(window)), dim=-1)
        return segment, math.sqrt(2) * torch.cat((torch.sin(angle), torch.cos(angle), _octaves(apart)), dim=-1)


class ScaleEncoder(torch.nn.Module):
    """E_s and F_s: the N_s observed frames around a segment with their signed times, as one latent code (Eq. 2, 3)."""

    def __init__(self, count: int, num_features: int, settings: NetworkSettings, activations: "_Activations") -> None:
        super().__init__()
        self.count = count
        # One linear map of all pairs (frame, Δt), in parts.
        initialisation = settings.initialisation
        self.pose = linear(num_features + 1, settings.code, initialisation)
        self.embed = linear(num_features, settings.embedding, initialisation)
        self.changes = linear(count * settings.embedding, settings.code, initialisation)
        self.times = linear(count, settings.code, initialisation)
        layers = _layers([settings.code] * settings.encoder_layers, settings, activations)
        self.layers = torch.nn.Sequential(activations.next(), *layers)

    def forward(
        self, window: ObservedWindow, row: Int64[torch.Tensor, "segments"], segment: Int64[torch.Tensor, "segments"]
    ) -> Float[torch.Tensor, "segments code"]:
        """z_s of segments between two frames of the windows `row`."""
        half = self.count // 2
        around = torch.arange(1 - half, 1 + half, device=segment.device)
        slots = (segment[:, None] + around).clamp(0, window.frames.shape[1] - 1)
        row = row[:, None]
        frames = window.frames[row, slots]
        middle = frames[:, half - 1 : half + 1].mean(dim=1)
        scale = (frames - middle[:, None]).square().mean(dim=(1, 2)).sqrt()[:, None]
        pose = torch.cat((middle, torch.log(scale + _TINY)), dim=-1)
        embedded = self.embed(window.frames)[row, slots] - self.embed(middle)[:, None]
        times = window.times_seconds[row, slots]
        apart = times - times[:, half - 1 : half + 1].mean(dim=1, keepdim=True)
        pairs = self.pose(pose) + self.changes(embedded.flatten(1) / (scale + _TINY)) + self.times(_octaves(apart))
        code: torch.Tensor = self.layers(pairs / math.sqrt(3))
        return code


class CrossScaleAttention(torch.nn.Module):
    """Att_s(z_s, z_{s+1}, z_{s+1}) (Eq. 5) over tokens of the codes, added to z_{s+1}.

    A code is one vector, and attention over a single key is trivial; so both codes are split into tokens, and tokens of
    the finer scale attend to those of the coarser one.
    """

    def __init__(self, code: int, tokens: int) -> None:
        super().__init__()
        self.tokens, width = tokens, code // tokens
        self.query, self.key, self.value = (torch.nn.Linear(width, width, bias=False) for _ in range(3))
        self.places = torch.nn.Parameter(0.5 * torch.randn(2, tokens, width))
        self.mix = torch.nn.Linear(code, code, bias=False)

    def forward(
        self, finer: Float[torch.Tensor, "segments code"], coarser: Float[torch.Tensor, "segments code"]
    ) -> Float[torch.Tensor, "segments code"]:
        """z̃_{s+1}."""
        finer_tokens, coarser_tokens = (
            each.reshape(*each.shape[:-1], self.tokens, each.shape[-1] // self.tokens) for each in (finer, coarser)
        )
        query, key = self.query(finer_tokens + self.places[0]), self.key(coarser_tokens + self.places[1])
        weight = torch.softmax(query @ key.transpose(-1, -2) / math.sqrt(query.shape[-1]), dim=-1)
        fused: torch.Tensor = coarser + self.mix((weight @ self.value(coarser_tokens)).flatten(-2))
        return fused


class _Activations:
    """Creates the layers' activations: one per layer, or one shared by all."""

    def __init__(self, settings: NetworkSettings) -> None:
        self.settings = settings
        self.shared = self._new() if settings.shared_activation else None

    def next(self) -> FourierActivation:
        """The activation of the next layer."""
        return self._new() if self.shared is None else self.shared

    def _new(self) -> FourierActivation:
        return FourierActivation(self.settings.num_sines, self.settings.initialisation)


def _layers(widths: list[int], settings: NetworkSettings, activations: _Activations) -> list[torch.nn.Module]:
    layers: list[torch.nn.Module] = []
    for inputs, outputs in pairwise(widths):
        layers += [linear(inputs, outputs, settings.initialisation), activations.next()]
    return layers


def _octaves(seconds: torch.Tensor) -> torch.Tensor:
    return torch.asinh(seconds / _FRAME_SECONDS)


def _make_network(config: PaHiResConfig, num_features: int) -> PaHiRes:
    return PaHiRes(config.network, num_features, num_answers(config.training.answer, num_features))


SYSTEM = TemporalSystem(
    "pahires",
    "continuous completion of observed frames: interpolation, in-betweening, extrapolation (PA-HiRes)",
    PaHiResConfig,
    _make_network,
    RECIPES,
)
