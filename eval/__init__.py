"""One evaluator suite for human motion, clip-FID at its centre.

`eval` is a common folder name in this field; a repository may hold one without `__init__.py`. Extending the path keeps
its modules importable beside this package.
"""

from pkgutil import extend_path

__path__ = extend_path(__path__, __name__)
