"""TS-Former: a context transformer drafts the missing frames, a detail transformer refines them."""

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Bool, Float
from pahires.temporal.network import ObservedWindow
from peers.attention import RelativeEncoder, longest_gap
from peers.layers import gathered, neighbours
from peers.settings import TsFormerNetworkConfig

# A row begins with the root's position (motionkit.features.rotations).
ROOT_NUMBERS = 3
_ROUNDING_FRAMES = 1e-3


class TsFormer(nn.Module):
    """TS-Former (Qin et al. 2022, doi 10.1145/3550454.3555454; victorqin/motion_inbetweening).

    Context: missing frames enter as zeros with the root on a straight line, a flag for given frames and an embedding
    of the distances to both ends of the gap, and attend to given frames only. Detail: given frames and the drafts of
    all missing ones attend to each other, and its output is added to the draft.

    Missing frames lie on a grid of `frames_per_second` from the window's first frame to its last. Queried instants
    attend to them but are not attended to, so an output does not depend on the other queries.
    """

    def __init__(self, config: TsFormerNetworkConfig, numbers: int) -> None:
        super().__init__()
        self.frames_per_second = config.frames_per_second
        sizes = {
            "width": config.width,
            "layers": config.layers,
            "heads": config.heads,
            "head_width": config.head_width,
            "inner": config.inner,
        }
        self.keyframe_position = nn.Sequential(
            nn.Linear(2, config.width), nn.PReLU(), nn.Linear(config.width, config.width)
        )
        self.context = RelativeEncoder(numbers + 1, numbers, **sizes)
        self.detail = RelativeEncoder(numbers + 1, numbers, **sizes)

    def forward(self, window: ObservedWindow) -> Float[Tensor, "batch queries numbers"]:
        """Normalised pose vectors at the queries."""
        given = window.frames.shape[1]
        grid, on_grid = missing_instants(window, self.frames_per_second)
        instants = torch.cat((grid, window.queries_seconds), dim=1)
        positions = self._positions(window, torch.cat((window.times_seconds, instants), dim=1))
        seen = torch.ones_like(window.times_seconds, dtype=torch.bool)

        entered = _marked(torch.cat((window.frames, _placeholders(window, instants)), dim=1), given)
        draft = self.context(entered, positions, seen, added=self._keyframe_positions(window, instants))[:, given:]
        refined = self.detail(
            _marked(torch.cat((window.frames, draft), dim=1), given), positions, torch.cat((seen, on_grid), dim=1)
        )
        queries = slice(grid.shape[1], None)
        outputs: Tensor = draft[:, queries] + refined[:, given:][:, queries]
        return outputs

    def _positions(
        self, window: ObservedWindow, times_seconds: Float[Tensor, "batch rows"]
    ) -> Float[Tensor, "batch rows"]:
        return (times_seconds - window.times_seconds[:, :1]) * self.frames_per_second

    def _keyframe_positions(
        self, window: ObservedWindow, times_seconds: Float[Tensor, "batch instants"]
    ) -> Float[Tensor, "batch rows width"]:
        gap, times = longest_gap(window), torch.cat((window.times_seconds, times_seconds), dim=1)
        ends = torch.stack((times - gap.before_seconds[:, None], gap.after_seconds[:, None] - times), dim=-1)
        embedded: Tensor = self.keyframe_position(ends * self.frames_per_second)
        return embedded


def missing_instants(
    window: ObservedWindow, frames_per_second: float
) -> tuple[Float[Tensor, "batch grid"], Bool[Tensor, "batch grid"]]:
    """The instants t_0 + k/fps of each window that lie in its span and at no observed frame.

    An instant less than half a frame from an observed one counts as observed. Windows with fewer missing instants than
    others are padded; the second output is the mask of missing ones.
    """
    times = window.times_seconds
    span_frames = (times[:, -1] - times[:, 0]) * frames_per_second
    steps = torch.arange(int(torch.round(span_frames.max())) + 1, device=times.device, dtype=times.dtype)
    grid = times[:, :1] + steps / frames_per_second
    off = (grid[:, :, None] - times[:, None]).abs().amin(dim=2) * frames_per_second
    missing = (off >= 0.5 - _ROUNDING_FRAMES) & (grid <= times[:, -1:] + _ROUNDING_FRAMES / frames_per_second)
    most = int(missing.sum(dim=1).max())
    first = torch.argsort((~missing).to(torch.int8), dim=1, stable=True)[:, :most]
    return grid.gather(1, first), missing.gather(1, first)


def _placeholders(
    window: ObservedWindow, times_seconds: Float[Tensor, "batch instants"]
) -> Float[Tensor, "batch instants numbers"]:
    """Zeros, with the root on straight lines between observed frames."""
    near = neighbours(window.asked(times_seconds))
    lines = torch.sum(near.weights[..., None] * gathered(window.frames, near.rows), dim=0)
    root = torch.arange(lines.shape[-1], device=lines.device) < ROOT_NUMBERS
    return lines * root


def _marked(poses: Float[Tensor, "batch rows numbers"], given: int) -> Float[Tensor, "batch rows inputs"]:
    """Append a flag to the poses: 1 for the first `given`, which are known, 0 for the others."""
    mark = (torch.arange(poses.shape[1], device=poses.device) < given).to(poses.dtype)
    return torch.cat((poses, mark[:, None].expand(*poses.shape[:2], 1)), dim=-1)
