"""Settings of the documentation's site; `make docs` builds it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
for place in (HERE, HERE.parent):
    sys.path.insert(0, str(place))

import reference  # noqa: E402

import loose_env  # noqa: E402
from loose_env.report import DARK, FONT, LIGHT  # noqa: E402

project = "loose-env"
author = "loose-env developers"
version = release = loose_env.__version__
copyright = "loose-env developers, Apache-2.0"
language = "en"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
# A source listed under References need not be cited in the text.
suppress_warnings = ["ref.footnote"]
exclude_patterns = ["_build", "figures"]
root_doc = "index"

# Pages are Markdown; headings get anchors, so that pages can point at each other's sections.
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
myst_heading_anchors = 4
myst_enable_extensions = ["deflist"]

# The reference: what every module says it offers, in the order in which it is written.
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_default_options = {"members": True, "show-inheritance": True}
autodoc_class_signature = "mixed"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_use_legacy_class_based = False
default_role = "py:obj"
napoleon_numpy_docstring = True
napoleon_google_docstring = False
# Types in docstrings are words ("ndarray (n,)"), not names to be looked up.
napoleon_use_param = False
napoleon_use_rtype = False
napoleon_use_ivar = True
maximum_signature_line_length = 88
add_module_names = False
toc_object_entries = False

# The look is that of the reports: the same colours and letters, nothing from a network.
html_theme = "furo"
html_title = "loose-env"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"


def _colours(by_day: dict[str, str]) -> dict[str, str]:
    """What the theme calls the colours of the reports."""
    return {
        **by_day,
        "font-stack": FONT,
        "color-foreground-primary": by_day["ink"],
        "color-foreground-secondary": by_day["muted"],
        "color-foreground-muted": by_day["muted"],
        "color-foreground-border": by_day["faint"],
        "color-background-primary": by_day["paper"],
        "color-background-secondary": by_day["page"],
        "color-background-hover": by_day["rule"],
        "color-background-border": by_day["rule"],
        "color-brand-primary": by_day["measured"],
        "color-brand-content": by_day["measured"],
        "color-brand-visited": by_day["measured"],
        "color-link-underline": by_day["faint"],
        "color-inline-code-background": by_day["page"],
    }


html_theme_options: dict[str, Any] = {
    "light_css_variables": _colours(dict(LIGHT)),
    "dark_css_variables": _colours(dict(DARK)),
    "navigation_with_keys": True,
}


def setup(app: Any) -> None:
    """Write the pages of the reference before anything is read."""
    app.connect("builder-inited", lambda app: reference.write(Path(app.srcdir) / "api"))
    # Before napoleon, which writes markup of its own, and after it.
    app.connect("autodoc-process-docstring", reference.as_meant, priority=400)
    app.connect("autodoc-process-docstring", reference.as_written, priority=600)
    app.connect("autodoc-process-signature", reference.short_types)
    app.connect("doctree-read", reference.unlinked)
