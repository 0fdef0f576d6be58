"""The documentation, for Sphinx: `make docs`."""

import os
import re
import sys
from importlib.metadata import version as installed_version
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

project = "petalfit"
copyright = "petalfit's authors"
version = release = installed_version("petalfit")

# Sphinx's source folder is the repository, so that links between files are links between pages.
root_doc = "docs/index"
include_patterns = ["docs/**.md", "notebooks/**.py", "benchmarks/RESULTS.md"]
exclude_patterns = [".*", "build", "petalfit", "tests", "data_synthetic", "notebooks/pictures.py"]

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "extension", "execution"]
nitpicky = True

# Notebooks are run while other pages are read (execution.py), and come with their outputs.
nb_custom_formats = {".py": ["execution.executed", {}]}
nb_execution_mode = "off"
nb_merge_streams = True
nb_render_markdown_format = "gfm"  # of tables in outputs
# What one notebook compiled is there for the next.
os.environ.setdefault("PETALFIT_CACHE", str(HERE.parent / "build" / "programs"))
os.environ["PYTHONSTARTUP"] = str(HERE / "kernel.py")

myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3

# Types are shown as they are written, beside what an argument means (extension.py).
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
napoleon_attr_annotations = False
add_module_names = False

html_theme = "furo"
html_title = "petalfit"
html_static_path = ["_static"]
html_css_files = ["pages.css"]
templates_path = ["_templates"]
html_additional_pages = {"index": "start.html"}
html_copy_source = False
html_show_copyright = False
html_show_sphinx = False
pygments_style = "friendly"
pygments_dark_style = "github-dark"
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#a83f6b", "color-brand-content": "#a83f6b"},
    "dark_css_variables": {"color-brand-primary": "#e58fb0", "color-brand-content": "#e58fb0"},
}

_SCRIPT = re.compile(r"\]\((?!\w+:)((?!\.\./notebooks/)[^)#]+\.py)\)")


def _scripts_as_downloads(app: object, name: str, source: list[str]) -> None:
    """A link to a Python file that is no notebook is a download."""
    source[0] = _SCRIPT.sub(r"](path:\1)", source[0])


def setup(app) -> None:
    app.connect("source-read", _scripts_as_downloads)
