"""Settings of Sphinx: ``sphinx-build -W -b html docs docs/_build`` builds the pages, without a network."""

from __future__ import annotations

import pydoc
import re
import sys
from pathlib import Path

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
sys.path.insert(0, str(HERE.parent))

from api_pages import public_names, write_pages  # noqa: E402

import torchreg  # noqa: E402

project = "torchreg"
copyright = "the torchreg authors"
version = release = torchreg.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
nitpicky = True
nitpick_ignore_regex = [("py:.*", r"(?!torchreg).*")]  # what other libraries have is not linked
pygments_style = "tango"
pygments_dark_style = "monokai"

myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]

napoleon_use_ivar = True
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 90
python_use_unqualified_type_names = True
add_module_names = False
toc_object_entries = False

html_theme = "furo"
html_title = f"torchreg {release}"
html_static_path = ["static"]
html_css_files = ["pages.css"]
html_copy_source = False
html_show_sphinx = False

write_pages(HERE / "api")
_PATHS = {public.path.rpartition(".")[2]: public.path for public in public_names()}


def setup(app: Sphinx) -> None:
    """Connect what these pages need beyond the extensions."""
    app.connect("source-read", _links_out_of_the_folder)
    app.connect("missing-reference", _public_name)
    app.connect("autodoc-skip-member", _is_described_by_its_class)


def _links_out_of_the_folder(app: Sphinx, page: str, source: list[str]) -> None:
    """Files beside ``docs/`` that pages link to have a page here that includes them."""
    up = "../" * page.count("/")
    source[0] = re.sub(r"\]\((?:\.\./)+CONTRIBUTING\.md", f"]({up}project/contributing.md", source[0])


def _public_name(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, shown: nodes.TextElement
) -> nodes.Element | None:
    """Lead a name in a signature or docstring to where the public name is described, wherever it is defined."""
    if node.get("refdomain") != "py":
        return None
    target = node["reftarget"]
    path = _PATHS.get(target.rpartition(".")[2])
    if path is None:  # a class that is not public has no description to lead to
        return shown if pydoc.locate(target) is not None else None
    python = env.get_domain("py")
    return python.resolve_xref(env, node["refdoc"], app.builder, "obj", path, node, shown)


def _is_described_by_its_class(app: Sphinx, kind: str, name: str, value: object, skip: bool, options: object) -> bool:
    """Fields of named tuples, whose docstrings say no more than their number."""
    return skip or type(value).__name__ == "_tuplegetter"
