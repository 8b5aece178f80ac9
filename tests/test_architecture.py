"""The house of the design: imports point one way, and the core knows neither GTSAM nor Open3D."""

import ast
import importlib
import subprocess
import sys
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
    "replaying",
    "estimate",
    "drift",
    "gate",
    "diagnosis",
    "parts",
    "diffusion",
    "datasets",
    "merging",
    "fleet",
    "dense_map",
    "mending",
    "report",
    "stream",
    "cli",
]
TERMINAL_TEXT = {PACKAGE / "report" / "terminal.py", PACKAGE / "report" / "closure_text.py"}
MAY_IMPORT_GTSAM = {
    "factor_graphs",
    "track",
    "adapter",
    "drift",
    "gate",
    "estimate",
    "diagnosis",
    "parts",
    "diffusion",
    "datasets",
    "merging",
    "mending",
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
    assert "small_gicp" not in tops or path == PACKAGE / "mending" / "alignment.py"
    assert "scenarios" not in tops
    assert not tops & {"rich", "typer"} or own == "cli" or path in TERMINAL_TEXT


@pytest.mark.parametrize("path", [*modules(), PACKAGE / "__init__.py"], ids=lambda path: str(path.relative_to(PACKAGE)))
def test_modules_stay_short_and_say_what_they_are(path):
    text = path.read_text(encoding="utf-8")
    assert text.count("\n") < 400
    assert ast.get_docstring(ast.parse(text)) or not text.strip()


def loaded_by(program):
    """Packages and modules of ours, by the first two parts of their names, that a program has loaded at its end."""
    told = f"{program}\nimport sys\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", told], cwd=ROOT, capture_output=True, text=True, check=True)
    return {".".join(name.split(".")[: 2 if name.startswith("pgti_gtsam") else 1]) for name in done.stdout.split()}


def test_the_package_alone_loads_neither_gtsam_nor_scipy():
    loaded = loaded_by("import pgti_gtsam; dir(pgti_gtsam)")
    assert {name for name in loaded if name.startswith("pgti_gtsam")} == {
        "pgti_gtsam",
        "pgti_gtsam.errors",
        "pgti_gtsam.version",
    }
    assert not loaded & {"gtsam", "numpy", "scipy"}


def test_a_public_name_loads_what_it_needs():
    loaded = loaded_by("import pgti_gtsam; pgti_gtsam.GatedISAM2, pgti_gtsam.diagnose, pgti_gtsam.merge")
    assert {"pgti_gtsam.gate", "pgti_gtsam.diagnosis", "pgti_gtsam.merging", "scipy"} <= loaded
    assert not loaded & {"pgti_gtsam.datasets", "pgti_gtsam.report", "pgti_gtsam.mending", "sqlite3", "msgpack"}
    assert not loaded & {"plotly", "rich", "typer", "open3d", "dask"}


def test_every_name_that_is_promised_exists():
    import pgti_gtsam

    tree = ast.parse((PACKAGE / "__init__.py").read_text(encoding="utf-8"))
    for_checkers = next(node for node in tree.body if isinstance(node, ast.If)).body
    seen = {alias.name: node.module for node in for_checkers for alias in node.names}
    assert seen == pgti_gtsam._MODULE_OF
    assert set(pgti_gtsam.__all__) == {*seen, "PgtiError", "__version__"} <= set(dir(pgti_gtsam))
    assert not set(seen) & {room_of(path) for path in modules()}  # an imported module would hide the name
    for name, module in seen.items():
        assert getattr(pgti_gtsam, name) is getattr(importlib.import_module(module), name)
    with pytest.raises(AttributeError, match="'pgti_gtsam' has no attribute 'diagnoze'"):
        _ = pgti_gtsam.diagnoze


def test_the_top_level_is_as_designed():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert settings["project"]["scripts"] == {"pgti-gtsam": "pgti_gtsam.cli:main"}
    assert all((ROOT / name).exists() for name in ("README.md", "LICENSE", ".ci/run"))
