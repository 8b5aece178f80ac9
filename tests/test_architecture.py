"""The house of the design: imports point one way, and the core knows neither GTSAM nor Open3D."""

import ast
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "pgti_gtsam"

# From the ground up: a room may import from those before it in its own row, and from the rows above it.
FLOORS = [
    "version",
    "errors",
    "plain_text",
    "checks",
    "outputs",
    "encode",
    "factor_graphs",
    "sightings",
    "pair_codes",
    "pose_graph",
    "track",
    "adapter",
    "support_graph",
    "spectral",
    "optimality",
    "integrity",
    "places",
    "new_ties",
    "replay",
    "estimate",
    "gate",
    "diagnosis",
    "parts",
    "diffusion",
    "datasets",
    "merging",
    "fleet",
    "dense_map",
    "mend",
    "report",
    "stream",
    "cli",
]
TERMINAL_TEXT = {PACKAGE / "report" / "terminal.py", PACKAGE / "report" / "closure_text.py"}
MAY_IMPORT_GTSAM = {
    "factor_graphs",
    "track",
    "adapter",
    "gate",
    "estimate",
    "diagnosis",
    "parts",
    "diffusion",
    "datasets",
    "merging",
    "mend",
    "stream",
}


def room_of(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported(path):
    """Dotted names of all modules that a file imports, wherever in the file."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def modules():
    return [path for path in sorted(PACKAGE.rglob("*.py")) if room_of(path) != "__init__"]


def test_every_room_has_a_floor():
    assert {room_of(path) for path in modules()} == set(FLOORS)


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_one_way(path):
    own = room_of(path)
    rooms = {name.split(".")[1] for name in imported(path) if name.startswith("pgti_gtsam.")}
    allowed = {own, *FLOORS[: FLOORS.index(own)]}
    if own == "spectral":
        allowed = {"spectral", "errors"}
    assert rooms & set(FLOORS) <= allowed


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_no_two_modules_import_each_other(path):
    def reached(start, seen):
        for name in imported(start):
            target = PACKAGE.parent / (name.replace(".", "/") + ".py")
            if name.startswith("pgti_gtsam.") and target.is_file() and target not in seen:
                seen.add(target)
                reached(target, seen)
        return seen

    assert path not in reached(path, set())


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_foreign_packages_stay_in_their_rooms(path):
    own, tops = room_of(path), {name.split(".")[0] for name in imported(path)}
    assert "gtsam" not in tops or own in MAY_IMPORT_GTSAM
    assert "open3d" not in tops or path in {PACKAGE / "dense_map.py", PACKAGE / "report" / "scene.py"}
    assert "small_gicp" not in tops or path == PACKAGE / "mend" / "alignment.py"
    assert "scenarios" not in tops
    assert not tops & {"rich", "typer"} or own == "cli" or path in TERMINAL_TEXT


@pytest.mark.parametrize("path", [*modules(), PACKAGE / "__init__.py"], ids=lambda path: str(path.relative_to(PACKAGE)))
def test_modules_stay_short_and_say_what_they_are(path):
    text = path.read_text(encoding="utf-8")
    assert text.count("\n") < 400
    assert ast.get_docstring(ast.parse(text)) or not text.strip()


def test_every_name_that_is_promised_exists():
    import pgti_gtsam

    assert all(hasattr(pgti_gtsam, name) for name in pgti_gtsam.__all__)


def test_the_top_level_is_as_designed():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert settings["project"]["scripts"] == {"pgti-gtsam": "pgti_gtsam.cli:main"}
    assert all((ROOT / name).exists() for name in ("README.md", "LICENSE", ".ci/run"))
