"""How Sphinx builds the documentation: `make docs`. Pages are Markdown, the reference is made of docstrings."""

import json
import re
from pathlib import Path

import jupytext
from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx
from sphinx.highlighting import lexers

from motionkit import __version__

project = "motionkit"
release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc"]
html_theme = "furo"
html_title = f"motionkit {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_copyright = False

# A block of no language is commands or what they print: no Python.
highlight_language = "none"
# A link may name any heading, as on the sites of repositories.
myst_heading_anchors = 4
# Docstrings mark names as Markdown does.
default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
# Pygments has no lexer of this name; a table needs no colours.
lexers["csv"] = TextLexer()


def link_pages(app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """Make links of the pages that a docstring names, which are then checked like any other."""
    lines[:] = [re.sub(r"docs/([\w/-]+)\.md", r":doc:`/\1`", line) for line in lines]


def write_notebook(app: Sphinx) -> None:
    """Make the notebook of the tutorial of its page, without what would differ from one time to the next."""
    notebook = jupytext.read(Path(app.srcdir, "tutorial.md"))
    cells = [
        {key: cell[key] for key in sorted(cell) if key != "id"}
        | {"metadata": {}, "source": cell["source"].splitlines(keepends=True)}
        for cell in notebook.cells
    ]
    content = {"cells": cells, "metadata": {}, "nbformat": 4, "nbformat_minor": 4}
    Path(app.srcdir, "tutorial.ipynb").write_text(f"{json.dumps(content, indent=1, ensure_ascii=False)}\n", "utf-8")


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("builder-inited", write_notebook)
    app.connect("autodoc-process-docstring", link_pages)
