"""One evaluator suite for human motion, clip-FID at its centre.

`eval` is a common folder name in this field; a repository may hold one without `__init__.py`. Extending the path keeps
its modules importable beside this package.
"""

from pkgutil import extend_path
from typing import TYPE_CHECKING

from motionkit.core.public_names import give_names

if TYPE_CHECKING:
    from eval.clip_fid.motions import clip_fid
    from eval.torch_metrics.clips import ClipFID
    from eval.torch_metrics.means import (
        L2P,
        L2Q,
        MPJPE,
        NPSS,
        AccelerationError,
        Accuracy,
        DeclaredMean,
        JerkError,
        MotionMean,
        SkatingSpeed,
    )
    from eval.torch_metrics.sets import FID, Diversity, MultiModality, RPrecision

__all__ = [
    "FID",
    "L2P",
    "L2Q",
    "MPJPE",
    "NPSS",
    "AccelerationError",
    "Accuracy",
    "ClipFID",
    "DeclaredMean",
    "Diversity",
    "JerkError",
    "MotionMean",
    "MultiModality",
    "RPrecision",
    "SkatingSpeed",
    "clip_fid",
]

__path__ = extend_path(__path__, __name__)

give_names(
    __name__,
    {
        "clip_fid": "eval.clip_fid.motions",
        "ClipFID": "eval.torch_metrics.clips",
        "AccelerationError": "eval.torch_metrics.means",
        "Accuracy": "eval.torch_metrics.means",
        "DeclaredMean": "eval.torch_metrics.means",
        "JerkError": "eval.torch_metrics.means",
        "L2P": "eval.torch_metrics.means",
        "L2Q": "eval.torch_metrics.means",
        "MPJPE": "eval.torch_metrics.means",
        "MotionMean": "eval.torch_metrics.means",
        "NPSS": "eval.torch_metrics.means",
        "SkatingSpeed": "eval.torch_metrics.means",
        "Diversity": "eval.torch_metrics.sets",
        "FID": "eval.torch_metrics.sets",
        "MultiModality": "eval.torch_metrics.sets",
        "RPrecision": "eval.torch_metrics.sets",
    },
)
