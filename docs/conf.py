"""Configuration of the documentation site: `make docs` builds it into build/docs, with warnings as errors."""

from __future__ import annotations

from importlib.metadata import version as installed_version
from typing import TYPE_CHECKING, NoReturn

from docutils.nodes import SkipNode
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util.logging import getLogger

if TYPE_CHECKING:
    import click
    from docutils import nodes
    from sphinx.application import Sphinx
    from sphinx.writers.html5 import HTML5Translator

project = "strapdown-rotation-test"
project_copyright = "the authors of strapdown-rotation-test"
version = release = installed_version(project)

extensions = ["myst_parser", "numpydoc", "sphinx.ext.autodoc", "sphinx_click"]
exclude_patterns = ["derivations"]
smartquotes = False  # would make one dash of the two of an option
nitpicky = True
nitpick_ignore = [  # cross-references of docstrings to names that have no page
    ("py:data", "NAMES"),
    ("py:func", "find_importer"),
    ("py:func", "run_schedule"),
    ("py:mod", "srt.model.sensor_model"),
    ("py:mod", "srt.diagnosis.faults"),
    ("py:mod", "srt.exporters.linear_model"),
]
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3

# The docstrings have the types, with shape and unit; the signatures show names and defaults only.
autodoc_typehints = "none"
autodoc_class_signature = "mixed"
autodoc_member_order = "bysource"
autodoc_inherit_docstrings = False
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

highlight_language = "text"

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_title = "strapdown-rotation-test"
html_math_renderer = "mathml"
html_copy_source = False
html_show_sourcelink = False


def _mathml(code: str, at: nodes.Element, *, block: bool) -> str:
    # Browsers render MathML without a script or network access.
    try:
        return tex2mathml(code, as_block=block)
    except MathError as error:
        getLogger(__name__).warning("invalid formula: %s (%s)", code, error, location=at)
        return ""


def _inline(translator: HTML5Translator, node: nodes.math) -> NoReturn:
    translator.body.append(_mathml(node.astext(), node, block=False))
    raise SkipNode


def _block(translator: HTML5Translator, node: nodes.math_block) -> NoReturn:
    formula = _mathml(node.astext(), node, block=True)
    translator.body.append(f'<div class="math">{formula}</div>')
    raise SkipNode


def _escaped(_: Sphinx, __: click.Context, lines: list[str]) -> None:
    # The help of a command is plain text: the asterisk of 'lot-7/*' is no markup.
    lines[:] = [line.replace("*", r"\*") for line in lines]


def _titled(_: Sphinx, name: str, source: list[str]) -> None:
    # srt robustness --markdown writes tables without a heading.
    if name.startswith("studies/"):
        source[0] = f"# Campaign {name.removeprefix('studies/')}\n\n{source[0]}"


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect the hooks and the renderer of formulas."""
    app.connect("source-read", _titled)
    app.connect("sphinx-click-process-description", _escaped)
    app.add_html_math_renderer("mathml", inline_renderers=(_inline, None), block_renderers=(_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
