"""Texts that go out beside the data, as jinja2 templates."""

from typing import Any


def render(template: str, **values: Any) -> str:
    """The text of `motionkit/export/templates/TEMPLATE`; a name that is missing raises."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("motionkit.export", "templates"),
        undefined=StrictUndefined,
        autoescape=False,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(template).render(values)
