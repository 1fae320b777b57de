# SPDX-License-Identifier: Apache-2.0
"""The documentation as a site, by `make docs`; the reference is made from the code."""

import importlib.metadata
import importlib.util
import shutil
import sys
from pathlib import Path

from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / '_extensions'))

project = 'microhand'
author = 'the microhand authors'
copyright = 'the microhand authors; Apache-2.0'
release = importlib.metadata.version('microhand_station')

extensions = [
    'myst_parser',
    'sphinx.ext.autodoc',
    'sphinx.ext.napoleon',
    'sphinx.ext.mathjax',
    'made_from_code',
]
exclude_patterns = ['_build', '_extensions']

myst_enable_extensions = ['dollarmath', 'colon_fence', 'attrs_inline']
myst_heading_anchors = 4
myst_links_external_new_tab = False

# A text between single backticks in docstrings is code, as in the Markdown pages.
default_role = 'code'
smartquotes = False  # -- is an option, not a dash
napoleon_google_docstring = False
napoleon_use_rtype = False
autodoc_member_order = 'bysource'
autodoc_typehints = 'none'  # the docstrings say it, with shapes and units
autodoc_preserve_defaults = True
python_display_all_members = False

html_theme = 'furo'
html_title = f'microhand {release}'
html_static_path = ['_static']
html_css_files = ['site.css']
html_copy_source = False
html_show_sphinx = False
html_theme_options = {
    'light_css_variables': {'color-brand-primary': '#31688e', 'color-brand-content': '#31688e'},
    'dark_css_variables': {'color-brand-primary': '#7fb8dd', 'color-brand-content': '#7fb8dd'},
}
# Formulas are set by a MathJax that comes along: the site needs no network.
mathjax_path = 'mathjax/tex-chtml.js'
MATHJAX_FILES = ('tex-chtml.js', 'output/chtml/fonts/woff-v2')


# What stands where. `*`: the pages that nobody listed, at the end.
MENU = {
    'index': (
        ('Learn', ('tutorial/first-reorientation',)),
        ('Do', ('how-to/index',)),
        ('Understand', ('explanation/index',)),
        ('Look up', ('reference/index', 'references', 'decisions/index')),
    ),
    'how-to/index': (('', ('own-part', 'station-settings', 'live-view', '*')),),
    'explanation/index': (('', ('model', 'search', 'robust-plans', 'twin', '*')),),
    'reference/index': (
        ('', ('command-line', 'python', 'interfaces', 'nodes', 'station-file', 'plan-file', '*')),
    ),
    'decisions/index': (('', ('*',)),),
}


def add_menu(app: Sphinx, page: str, source: list[str]) -> None:
    """Append its part of the menu to a page, which stays plain Markdown in the repository."""
    for caption, entries in MENU.get(page, ()):
        options = ':hidden:\n:glob:\n' + (f':caption: {caption}\n' if caption else '')
        menu = '\n'.join(entries)
        source[0] += f'\n```{{toctree}}\n{options}\n{menu}\n```\n'


def add_mathjax(app: Sphinx, error: Exception | None) -> None:
    """Copy what pages need of MathJax; the whole package is ten times as much."""
    package = importlib.util.find_spec('sphinx-mathjax-offline')
    if error is not None or app.builder.format != 'html' or package is None:
        return
    source = Path(str(package.origin)).parent / 'static' / 'mathjax'
    target = Path(app.outdir) / '_static' / 'mathjax'
    for name in MATHJAX_FILES:
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        if (source / name).is_dir():
            shutil.copytree(source / name, target / name, dirs_exist_ok=True)
        else:
            shutil.copy(source / name, target / name)


def setup(app: Sphinx) -> None:
    """Connect what is not configuration."""
    app.add_lexer('mermaid', TextLexer)  # git hosts draw it; here it stays text
    app.connect('source-read', add_menu)
    app.connect('build-finished', add_mathjax)
