"""One evaluator suite for human motion, clip-FID at its centre.

`eval` is a common folder name in this field; a repository may hold one without `__init__.py`. Extending the path keeps
its modules importable beside this package. Names are listed in `__init__.pyi` and imported when they are first used.
"""

from pkgutil import extend_path

import lazy_loader

__path__ = extend_path(__path__, __name__)
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
