"""One evaluator suite for human motion, clip-FID at its centre.

`eval` is a common folder name in this field; a repository may hold one without `__init__.py`. Extending the path keeps
its modules importable beside this package.
"""

from pkgutil import extend_path
from typing import TYPE_CHECKING

from motionkit.core.public_names import give_names

if TYPE_CHECKING:
    from eval.clip_fid.motions import clip_fid

__all__ = ["clip_fid"]

__path__ = extend_path(__path__, __name__)

give_names(__name__, {"clip_fid": "eval.clip_fid.motions"})
