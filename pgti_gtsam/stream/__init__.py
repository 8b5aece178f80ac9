"""The gate in a running pipeline of any language: lines in, verdicts out.

`lines` reads a line, `session` is the protocol for a map, `journal` keeps a session on disk, `serving` joins the
two.
"""

from pgti_gtsam.stream.journal import Journal
from pgti_gtsam.stream.lines import client_of
from pgti_gtsam.stream.serving import serve
from pgti_gtsam.stream.session import Session

__all__ = ["Journal", "Session", "client_of", "serve"]
