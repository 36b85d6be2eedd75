"""Configuration of Sphinx. `make docs` builds the site from this folder with it."""

import os
import sys
from pathlib import Path

import geomesh

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_extensions"))

# The notebook of the tutorial uses the Python that builds the site, and prints only errors.
os.environ["JUPYTER_PATH"] = str(HERE / "_jupyter")
os.environ.pop("MPLBACKEND", None)

project = "geomesh"
author = "The geomesh developers"
copyright = author  # noqa: A001
version = release = geomesh.__version__

extensions = [
    "sphinx.ext.autodoc",
    "numpydoc",
    "myst_nb",
    "commands",
    "mathml",
    "parameters",
]
default_role = "code"  # for text in single backquotes in docstrings
exclude_patterns = ["_extensions", "_jupyter"]
nitpicky = True

# The pages are Markdown, so that the website of the repository can show them too.
source_suffix = {".rst": "restructuredtext", ".md": "myst-nb"}
# Headings can be linked to from other pages, as on code hosting sites.
myst_heading_anchors = 2
myst_enable_extensions = ["dollarmath"]
# Command blocks also contain output or comments, so highlighting as a language does not work.
highlight_language = "none"
smartquotes = False  # without this, the two hyphens of an option become a dash

# The tutorial runs in every build. This is slow, but the page is never outdated.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 120
nb_merge_streams = True
nb_ipywidgets_js = {}

autodoc_typehints = "none"  # docstrings contain the types, with shapes and units
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

html_theme = "pydata_sphinx_theme"
html_title = "geomesh"
html_static_path = ["_static"]
html_css_files = ["geomesh.css"]
html_math_renderer = "mathml"
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "logo": {
        "text": "geomesh",
        "image_light": "_static/logo.svg",
        "image_dark": "_static/logo.svg",
    },
    "navbar_align": "left",
    "navbar_end": ["theme-switcher"],
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
html_sidebars = {
    page: []
    for page in (*("index", "getting-started", "tutorial", "paper", "adaptive", "how-it-is-built"),)
}
