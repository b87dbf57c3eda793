"""The site: sphinx-build -W docs site.  Nothing is fetched while it is built; its pages make no request to any host."""

import shutil
import sys
from importlib.util import find_spec
from pathlib import Path

import minimd

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS / "_ext"), str(DOCS)]

import gallery  # noqa: E402
import pages  # noqa: E402
import plain_docstrings  # noqa: E402

MATHJAX = Path(find_spec("sphinx-mathjax-offline").origin).parent / "static" / "mathjax"

project = "minimd"
author = "the authors of minimd"
version = release = minimd.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.mathjax", "sphinx_gallery.gen_gallery"]
exclude_patterns = ["_build", "_ext", "gallery/*.md5", "**/sg_execution_times.rst", "sg_execution_times.rst"]
highlight_language = "text"
smartquotes = False  # what is quoted may be code
nitpicky = False
suppress_warnings = ["config.cache"]

myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence", "deflist"]
myst_heading_anchors = 4

autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_class_signature = "mixed"
add_module_names = False
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_title = f"minimd {version}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_copyright = False
html_show_sourcelink = False
html_search_scorer = str(DOCS / "_ext" / "scorer.js")
html_show_search_summary = False  # it would fetch the pages that were found, which a browser forbids to files
mathjax_path = "mathjax/tex-svg-full.js"

EXAMPLES = """Examples
========

Each answers a question about physics, in at most sixty lines, and prints what it finds beside the known value. All
pictures and outputs were made when this site was built. Every script can be downloaded at the end of its page.
"""
# path integrals are shown without their result where i-PI is not installed
RUN = r"\.py$" if shutil.which("i-pi") else r"(?<!path_integrals)\.py$"
FOLDERS = {name: DOCS.parent / folder for name, folder in (("gallery", "examples"), ("course", "course"))}
FOLDERS = {name: folder for name, folder in FOLDERS.items() if folder.is_dir()}
PAGES = {"gallery": [DOCS / "notebook.md"]}  # in the gallery, with their results
sphinx_gallery_conf = {
    "examples_dirs": [
        gallery.prepare(folder, DOCS / "_build" / name, EXAMPLES, PAGES.get(name, ()))
        for name, folder in FOLDERS.items()
    ],
    "gallery_dirs": list(FOLDERS),
    "filename_pattern": RUN,
    "within_subsection_order": "gallery.by_theme",
    "image_scrapers": ("matplotlib", "gallery.saved_pictures"),
    "reset_modules": ("matplotlib", "gallery.large_fonts"),
    "abort_on_example_error": True,
    "ignore_repr_types": r"record_picture\.Picture",
    "show_signature": False,
    "show_memory": False,
    "min_reported_time": 1e9,
    "write_computation_times": False,
    "download_all_examples": False,
}


def copy_mathjax(app, error):
    """One file of MathJax, which has its fonts in it, beside the pages; its licence lies in _static."""
    if error is None and app.builder.format == "html":
        target = Path(app.outdir) / "_static" / "mathjax"
        target.mkdir(parents=True, exist_ok=True)
        (target / "tex-svg-full.js").write_bytes((MATHJAX / "tex-svg-full.js").read_bytes())


def setup(app):
    """Connect the functions that Sphinx calls."""
    app.connect("source-read", gallery.escape_bars)
    app.connect("source-read", gallery.divide)
    app.connect("source-read", pages.prepare)
    app.connect("autodoc-process-docstring", plain_docstrings.process)
    app.connect("build-finished", copy_mathjax)
