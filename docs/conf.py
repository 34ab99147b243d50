"""The site: `sphinx-build -W -b html docs docs/_build/html` (`pip install '.[docs]'`). Nothing is computed here."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import pages  # noqa: E402
import reference  # noqa: E402
import showcase  # noqa: E402
from docutils import nodes  # noqa: E402
from latex2mathml.converter import convert  # noqa: E402

import granjax  # noqa: E402

HERE = Path(__file__).parent

project = "granjax"
author = "the granjax developers"
copyright = "the granjax developers"
release = version = granjax.__version__
extensions = ["myst_nb", "sphinx_design", "sphinx_copybutton"]
html_math_renderer = "mathml"
exclude_patterns = ["_build", "films/make.py", "**/.ipynb_checkpoints"]
nb_execution_mode = "off"
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
nitpicky = True
# words of annotations that are Python's, JAX's or a class's own
nitpick_ignore_regex = [("py:class", ".*")]
python_maximum_signature_line_length = 88
add_module_names = False
python_use_unqualified_type_names = True
toc_object_entries_show_parents = "hide"

html_theme = "pydata_sphinx_theme"
html_title = "granjax"
html_favicon = "_static/icon.svg"
html_context = {"default_mode": "auto"}
html_static_path = ["_static"]
templates_path = ["_templates"]
html_css_files = ["granjax.css"]
html_show_sourcelink = False
html_copy_source = False
# excerpts are cut from the pages that are found, all of which are loaded for it: 5 MB
html_show_search_summary = False
html_theme_options = {
    "show_prev_next": False,
    "navigation_with_keys": False,
    "show_nav_level": 1,
    "navigation_depth": 2,
    "header_links_before_dropdown": 6,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "navbar_persistent": ["search-button"],
    "navbar_end": ["theme-switcher"],
    "pygments_light_style": "tango",
}
# pages without others beside them
html_sidebars = {page: [] for page in ("index", "gallery/index", "changes", *pages.ALONE)}
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True


def _math(display):
    """Formulas as MathML, which browsers draw by themselves, without a script from elsewhere."""

    def visit(translator, node):
        translator.body.append(convert(node.astext(), display=display))
        raise nodes.SkipNode

    return visit, None


def _lazily(app, pagename, templatename, context, doctree):
    """Pictures are loaded where they come into view: a page of many opens at once."""
    if "body" in context:
        context["body"] = context["body"].replace("<img ", '<img loading="lazy" ')


def setup(app):
    """Pages that are made of what the package, the gallery and the notebooks hold."""
    app.connect("html-page-context", _lazily)
    app.connect("source-read", pages.with_outputs)
    app.add_html_math_renderer("mathml", _math("inline"), _math("block"))
    reference.write(HERE / "reference")
    showcase.write(HERE)
