"""All sets smoothed alike, so that what is compared lies below the noise of capture."""

from eval.corruptions import low_pass
from eval.samples.sets import SampleSet


def low_passed(samples: SampleSet, cutoff_hz: float) -> SampleSet:
    """Every sequence through the same zero-phase low-pass, half amplitude at `cutoff_hz`.

    A cut-off at or above the set's Nyquist frequency leaves it as it is.
    """
    if cutoff_hz >= float(samples.fps) / 2:
        return samples
    smooth = [low_pass(sequence, float(samples.fps), cutoff_hz) for sequence in samples.sequences()]
    return samples.with_positions(samples.name, samples.fps, smooth)
