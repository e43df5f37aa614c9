"""The project's metrics as `torchmetrics.Metric`s: update, compute, reset, on any device, over batches and processes.

Each accumulates the inputs of a pure function of `eval.metrics` and calls it in `compute`, so the value does not depend
on the batches. They need the extra `metrics`; the functions do not.
"""

from importlib.util import find_spec

from motionkit.core.errors import MissingExtraError

if find_spec("torchmetrics") is None:
    raise MissingExtraError("torchmetrics", "metrics")
