"""Configuration of the documentation site: `make docs` builds it into build/docs, with warnings as errors."""

from __future__ import annotations

import shutil
from importlib.metadata import version as installed_version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final, NoReturn

from docutils.nodes import SkipNode
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util.logging import getLogger

if TYPE_CHECKING:
    from collections.abc import Iterator

    import click
    from docutils import nodes
    from sphinx.application import Sphinx
    from sphinx.writers.html5 import HTML5Translator

EXAMPLES: Final = Path(__file__).parents[1] / "examples"
NOTEBOOK: Final = "from_log_to_navigation.ipynb"
TITLE: Final = "# From a log of counts to a navigation solution\n"

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


def _with_notebook(_: Sphinx, name: str, source: list[str]) -> None:
    if name == "notebook":
        source[0] += "\n\n".join(part for cell in _executed(EXAMPLES / NOTEBOOK) for part in _rendered(cell))


def _executed(path: Path) -> list[Any]:
    """Cells of a notebook with their outputs, run in a folder of its own beside copies of the examples."""
    import nbclient
    import nbformat

    notebook = nbformat.read(path, as_version=4)
    with TemporaryDirectory() as folder:
        for file in path.parent.glob("*.py"):
            shutil.copy(file, folder)
        nbclient.NotebookClient(
            notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": folder}}
        ).execute()
    cells: list[Any] = notebook.cells
    return cells


def _rendered(cell: Any) -> Iterator[str]:
    """Parts of a page in Markdown that show a cell and its outputs."""
    if cell.cell_type == "markdown":
        yield cell.source.removeprefix(TITLE)  # the page has it
        return
    yield f"```python\n{cell.source}\n```"
    for output in cell.outputs:
        data = output.get("data", {})
        if "image/png" in data:
            html = f'<p><img alt="Output of the cell" src="data:image/png;base64,{data["image/png"].strip()}"></p>'
        elif "text/html" in data:
            html = data["text/html"]
        else:
            yield f"```text\n{(output.get('text') or data.get('text/plain', '')).rstrip()}\n```"
            continue
        yield f"```{{raw}} html\n{html}\n```"


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect the hooks and the renderer of formulas."""
    app.connect("source-read", _titled)
    app.connect("source-read", _with_notebook)
    app.connect("sphinx-click-process-description", _escaped)
    app.add_html_math_renderer("mathml", inline_renderers=(_inline, None), block_renderers=(_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
