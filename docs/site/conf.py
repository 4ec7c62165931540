"""Sphinx's settings."""

from importlib.metadata import version as _version

project = "twinproof"
release = version = _version("twinproof")
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_click",
]
myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3
# Links to folders and to files that are no pages are checked by a test instead.
suppress_warnings = ["myst.xref_missing", "ref.python", "myst.header"]
autodoc_typehints = "description"
autodoc_member_order = "bysource"
html_theme = "furo"
html_title = "twinproof"
html_show_sphinx = False
exclude_patterns = ["docs/site"]
root_doc = "index"
