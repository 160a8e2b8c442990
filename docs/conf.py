"""Sphinx configuration."""

import sys
from importlib.metadata import version as installed_version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # for gallery_order and offline

project = "residua"
author = "residua developers"
copyright = "2026, residua developers"
release = version = installed_version("residua")

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "offline",  # equations, by sphinx.ext.mathjax
    "numpydoc",
    "sphinx_gallery.gen_gallery",
    "matplotlib.sphinxext.plot_directive",  # pictures of measured tables, drawn from docs/pictures
]
exclude_patterns = ["_build", "_templates", "examples", "pictures"]
templates_path = ["_templates"]
nitpicky = False
default_role = None

autosummary_generate = True
autosummary_imported_members = False
autodoc_typehints = "none"  # the docstrings say it, with shapes and units
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",  # every example is executed
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "plot_gallery": True,
    "remove_config_comments": True,
    "min_reported_time": 1000,
    "write_computation_times": False,  # these pages load scripts from other hosts
    "within_subsection_order": "gallery_order.by_interest",
}

plot_html_show_source_link = False
plot_html_show_formats = False
plot_formats = [("svg", 100)]

html_theme = "pydata_sphinx_theme"
html_title = "residua"
html_static_path = ["_static"]
html_show_sourcelink = False
html_theme_options = {
    "navigation_depth": 3,
    "show_toc_level": 2,
    "header_links_before_dropdown": 9,
    "navbar_end": ["theme-switcher"],
    "footer_start": ["copyright"],
    "footer_end": [],
}
html_css_files = ["wide.css"]
# The doors are pages of their own; the others stand in a section, whose pages are listed beside them.
html_sidebars = {name: [] for name in ("install", "i-have-a-log", "getting-started", "i-have-a-paper", "gallery/**")}
