"""Sphinx configuration: pip install --group docs --editable . && python -m sphinx -W docs docs/_build."""

project = "xcg"
copyright = "2026, the xcg developers"
extensions = ["myst_nb", "numpydoc", "sphinx.ext.autodoc", "sphinx.ext.mathjax"]
exclude_patterns = ["_build", "jupyter_execute", "output"]
default_role = "py:obj"

html_theme = "pydata_sphinx_theme"
html_title = "xcg"
html_static_path = ["_static"]
html_css_files = ["xcg.css"]
html_show_sourcelink = False
html_sidebars = {"**": ["globaltoc"]}
html_theme_options = {"navbar_center": []}

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300  # a cell may compile
numpydoc_show_class_members = False
autodoc_typehints = "none"


def shorten_methods(app, what, name, obj, options, lines):
    """Methods of the accessor are functions that have their own entries: one line is enough."""
    if name.startswith("xcg.CoarseGrainAccessor.") and lines:
        del lines[1:]


def setup(app):
    app.connect("autodoc-process-docstring", shorten_methods, priority=1)  # before numpydoc
