"""Sphinx settings of the site that ``make site`` builds: the pages of docs, and the API from its docstrings."""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(Path(__file__).parent))

project = "gyrowheel"
author = "gyrowheel"
language = "en"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "pages"]

# The sources are at the paths that a forge shows, so that links work on the forge and on the site.
root_doc = "docs/README"
source_suffix = {".md": "markdown"}
include_patterns = ["*.md", "docs/**"]
# other folders have environments and recordings
exclude_patterns = [path.name for path in ROOT.iterdir() if path.is_dir() and path.name != "docs"]

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
# most blocks show printed tables, not programs
highlight_language = "text"

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings have more: shapes and units
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
napoleon_preprocess_types = False
default_role = "py:obj"
add_module_names = False
python_use_unqualified_type_names = True
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_title = "gyrowheel"
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_copy_source = False
html_show_copyright = False
html_show_sphinx = False
# a page that is opened from the disk may not read other pages for a summary
html_show_search_summary = False
html_theme_options = {"navigation_with_keys": True}
pygments_style = "tango"
pygments_dark_style = "monokai"
