"""Sphinx configuration: pip install --group docs --editable . && python -m sphinx -W docs docs/_build."""

import re
import sys
import urllib.request
from importlib import metadata
from pathlib import Path

import pyvista
from sphinx.util.fileutil import copy_asset

project = "xcg"
copyright = "2026, the xcg developers"
release = metadata.version("xcg")
extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.intersphinx",
    "sphinx.ext.mathjax",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "gallery/**/*.ipynb", "jupyter_execute", "output"]
default_role = "py:obj"
templates_path = ["_templates"]

html_theme = "pydata_sphinx_theme"
html_title = "xcg"
html_static_path = ["_static"]
html_css_files = ["xcg.css"]
html_search_scorer = str(Path(__file__).with_name("scorer.js"))
html_show_sourcelink = False
html_logo = html_favicon = "_static/logo.svg"
html_sidebars = {"index": []}
html_theme_options = {
    "logo": {"text": "", "alt_text": "xcg"},
    "navbar_align": "left",
    "show_prev_next": False,
}

myst_enable_extensions = ["attrs_block", "deflist", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300  # a cell may compile
numpydoc_show_class_members = False
autodoc_typehints = "none"

# Pictures in 3D are drawn without a screen, by EGL or OSMesa where there is no X server.
pyvista.OFF_SCREEN = True
pyvista.BUILDING_GALLERY = True

# The gallery: each script of examples/gallery is run and becomes a page; one that has not changed is not run again.
sys.path.append(str(Path(__file__).parents[1]))
from docs.figures import SCENES  # noqa: E402

sphinx_gallery_conf = {
    "examples_dirs": "../examples/gallery",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "reset_modules": ("docs.figures.legible",),
    "image_srcset": ["2x"],
    "image_scrapers": ("matplotlib", "docs.figures.draw_3d"),
    "capture_repr": (),
    "remove_config_comments": True,
    "download_all_examples": False,
    "show_signature": False,
    "write_computation_times": False,
    "min_reported_time": float("inf"),
}

# Formulas are drawn without a network: MathJax of an installed package is copied into the site.
MATHJAX = (
    next(path for path in metadata.files("sphinx-mathjax-offline") if path.name == "tex-chtml.js")
    .locate()
    .parent
)
mathjax_path = "mathjax/tex-chtml.js"

# Links to other projects, where their lists of names can be fetched.
numpydoc_xref_aliases = {"Dataset": "xarray.Dataset", "path": "pathlib.Path"}
numpydoc_xref_ignore = {
    "optional",
    "or",
    "of",
    "sequence",
    "mapping",
    "callable",
    "array_like",
    "default",
}


def reachable(address):
    try:
        urllib.request.urlopen(f"{address}/objects.inv", timeout=5).close()
    except OSError:
        return False
    return True


OTHERS = {
    "dask": "https://docs.dask.org/en/stable",
    "matplotlib": "https://matplotlib.org/stable",
    "numpy": "https://numpy.org/doc/stable",
    "pandas": "https://pandas.pydata.org/docs",
    "python": "https://docs.python.org/3",
    "xarray": "https://docs.xarray.dev/en/stable",
}
intersphinx_mapping = {
    name: (address, None) for name, address in OTHERS.items() if reachable(address)
}
numpydoc_xref_param_type = "python" in intersphinx_mapping


def shorten_methods(app, what, name, obj, options, lines):
    """Methods of the accessor are functions that have their own entries: one line is enough."""
    if name.startswith("xcg.CoarseGrainAccessor.") and lines:
        del lines[1:]


def main_entries(comment):
    """Write a comment of words as index entries, which the search ranks highest if they are main ones."""
    words = [f"! {word}" for word in comment[1].split(", ")]
    return f"```{{index}} {', '.join(words)}\n```"


def link_pages(app, *names_and_text):
    """Replace links to the gallery and its scripts by links to their pages, and comments by index entries."""
    text = names_and_text[-1]
    text[0] = re.sub(r"<!-- index: (.*?) -->", main_entries, text[0])
    text[0] = re.sub(r"\(\.\./examples/gallery/([\w/]+)\.py\)", r"(gallery/\1.rst)", text[0])
    text[0] = re.sub(r"\]\(\.\./(examples/)?gallery\)", "](gallery/index.rst)", text[0])


def copy_mathjax(app, error):
    """Copy the part of MathJax that draws formulas with fonts of its own (2 of 24 MB)."""
    if error is None and app.builder.format == "html":
        for name in ("tex-chtml.js", "output/chtml/fonts/woff-v2", "input/tex/extensions"):
            target = Path(app.outdir, "_static", "mathjax", name)
            copy_asset(MATHJAX / name, target.parent if target.suffix else target)


def copy_scenes(app, error):
    """Copy the pictures that can be turned, which the pages of the gallery frame."""
    if error is None and app.builder.format == "html":
        copy_asset(Path(app.srcdir, SCENES), Path(app.outdir, SCENES), force=True)


def setup(app):
    app.connect("source-read", link_pages)
    app.connect("include-read", link_pages)
    app.connect("build-finished", copy_mathjax)
    app.connect("build-finished", copy_scenes)
    app.connect("autodoc-process-docstring", shorten_methods, priority=1)  # before numpydoc
