"""The documentation builds without a warning, and its Python is Python."""

import ast
import re
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [*sorted((ROOT / "docs").rglob("*.md")), ROOT / "CONTRIBUTING.md"]


def test_the_pages_build_without_a_warning(tmp_path):
    pytest.importorskip("furo", reason="furo is missing")
    pytest.importorskip("myst_nb", reason="myst-nb is missing")
    build = [sys.executable, "-m", "sphinx", "-W", "-q", "-b", "html", ROOT / "docs", tmp_path]
    done = subprocess.run(list(map(str, build)), capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "api.html").read_text(encoding="utf-8")
    assert "LoopClosureGate" in page
    shown = {path.stem for path in (tmp_path / "notebooks").glob("*.html")}
    assert shown == {path.stem for path in (ROOT / "notebooks").glob("*.ipynb")}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_code_on_a_page_can_be_read(page):
    text = page.read_text(encoding="utf-8")
    for block in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL):
        names = {
            node.attr
            for node in ast.walk(ast.parse(dedent(block)))
            if isinstance(node, ast.Attribute) and is_ours(node)
        }
        assert names <= set(dir(__import__("pgti_gtsam")))
    assert text.startswith(("#", "```{include}"))


def is_ours(node):
    return isinstance(node.value, ast.Name) and node.value.id == "pgti"
