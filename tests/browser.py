"""Pages opened in a browser that reaches nothing, and what their HTML refers to."""

import re
import shutil
import subprocess
from html.parser import HTMLParser

import pytest

from pgti_gtsam.report import web

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
OFFLINE = [
    "--headless",
    "--no-sandbox",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--host-resolver-rules=MAP * ~NOTFOUND",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--virtual-time-budget=10000",
]

needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="needs a browser: Debian package chromium")


def dom_of_page(path, fragment="", width=1400):
    """The DOM of a file after its scripts have run in a window of so many pixels; a browser has 500 at least."""
    shown = [f"--window-size={width},1000", f"--user-data-dir={path.parent / 'profile'}", "--dump-dom"]
    command = [CHROMIUM, *OFFLINE, *shown, path.as_uri() + fragment]
    return subprocess.run(command, capture_output=True, text=True, timeout=180, check=True).stdout


def run_after_script(monkeypatch, name, script):
    """Let every page run a script after one of its own: `assembled` puts its hash into the policy."""
    asset = web.asset
    monkeypatch.setattr(web, "asset", lambda each: asset(each) + script * (each == name))


TELL_WHAT_IS_CUT = """
document.body.dataset.cut = JSON.stringify([document.documentElement, ...document.querySelectorAll(".scroll")]
  .filter((box) => box.scrollWidth > box.clientWidth + 1).map((box) => box.id || box.tagName));
"""


def cut_on_a_phone(path, monkeypatch, write, script):
    """What scrolls sideways on a phone, of the page that `write` writes to a path: identifiers, as JSON."""
    run_after_script(monkeypatch, script, TELL_WHAT_IS_CUT)
    write(path)
    return re.search(r'data-cut="([^"]*)"', dom_of_page(path, width=500)).group(1)


def rows_of(dom, table):
    """The rows of a table of the page as (classes, text)."""
    body = re.search(rf'id="{table}">.*?<tbody>(.*?)</tbody>', dom, re.DOTALL).group(1)
    rows = re.findall(r'<tr(?: class="([^"]*)")?>(.*?)</tr>', body, re.DOTALL)
    return [(classes, " ".join(re.sub(r"<[^>]*>", " ", text).split())) for classes, text in rows]


class References(HTMLParser):
    """Addresses that elements load, without links that only a click follows; and the scripts' types."""

    def __init__(self, text):
        super().__init__()
        self.found, self.scripts = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.found += [value for name, value in attrs if name in ("src", "data", "srcset", "action") or
                       (name == "href" and tag != "a")]  # fmt: skip
        if tag == "script":
            self.scripts.append(dict(attrs).get("type"))
