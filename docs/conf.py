"""How Sphinx builds these pages: `python -m sphinx -W -b html docs build/docs`.

`docs/notebooks` is a link to the notebooks, which are stored without outputs. `-D nb_execution_mode=force` runs them
and shows what comes out; without, their pages show the code alone.
"""

from importlib.metadata import version as installed

project = "pgti_gtsam"
author = "the authors of pgti_gtsam"
version = release = installed("pgti-gtsam")

extensions = ["myst_nb", "numpydoc", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.mathjax"]
exclude_patterns = ["build"]
html_theme = "furo"
html_title = "pgti_gtsam"
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
nb_execution_mode = "off"
nb_execution_timeout = 240
nb_execution_raise_on_error = True

autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
