"""What this machine may lack; tests that need it skip and say which it is."""

import importlib.util
import subprocess
import sys

import pytest


def importable():
    """Why Open3D cannot be imported here, or None."""
    if importlib.util.find_spec("open3d") is None:
        return 'pip install "pgti-gtsam[scene]"'
    tried = subprocess.run([sys.executable, "-c", "import open3d"], capture_output=True, text=True, timeout=300)
    return None if tried.returncode == 0 else tried.stderr.strip().splitlines()[-1]


MISSING = importable()
needs_open3d = pytest.mark.skipif(MISSING is not None, reason=f"Open3D cannot be loaded: {MISSING}")
