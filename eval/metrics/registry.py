"""All metrics, by their names."""

from collections.abc import Mapping

from eval.metrics import actions, distributions, motion, physical, physical_published, retrieval
from eval.metrics.metric import Metric

METRICS: Mapping[str, Metric] = {
    metric.name: metric
    for module in (actions, distributions, motion, physical, physical_published, retrieval)
    for metric in module.METRICS
}


def find_metric(name: str) -> Metric:
    """A metric by name; raises `KeyError` with the names there are."""
    if name not in METRICS:
        raise KeyError(f"there is no metric {name!r}: {', '.join(METRICS)}")
    return METRICS[name]
