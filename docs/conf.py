"""Sphinx configuration: pip install . --group docs; sphinx-build -W docs docs/_build."""

project = "xcg"
copyright = "2026, the xcg developers"
extensions = ["myst_nb", "numpydoc", "sphinx.ext.autodoc", "sphinx.ext.mathjax"]
html_theme = "pydata_sphinx_theme"
html_static_path = ["_static"]
exclude_patterns = ["_build"]
myst_enable_extensions = ["dollarmath"]
nb_execution_mode = "force"
nb_execution_raise_on_error = True
numpydoc_show_class_members = False
autodoc_typehints = "none"
