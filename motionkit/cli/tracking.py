"""Training curves for TensorBoard, in addition to metrics.jsonl."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from motionkit.core.errors import MissingExtraError
from motionkit.training.run import OnMetrics, ignore_metrics


@contextmanager
def tensorboard_events(folder: Path | None) -> Iterator[OnMetrics]:
    """A callback that writes each stage's metrics as events to `folder/STAGE`; without a folder it does nothing.

    When a stage is resumed, events of repeated steps are hidden. Raises `MissingExtraError` without the extra `track`.
    """
    if folder is None:
        yield ignore_metrics
        return
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise MissingExtraError("tensorboard", "track") from None
    writers: dict[str, Any] = {}

    def write(stage: str, values: Mapping[str, float]) -> None:
        step = int(values["step"])
        if stage not in writers:
            writers[stage] = SummaryWriter(str(folder / stage), purge_step=step)
        for name, value in values.items():
            if name != "step":
                writers[stage].add_scalar(name, value, step)
        writers[stage].flush()

    try:
        yield write
    finally:
        for writer in writers.values():
            writer.close()
