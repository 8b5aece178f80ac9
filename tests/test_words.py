"""How this code reads, measured: `python tests/test_words.py [FOLDER …]` prints the figures of any folders.

The same command says of pronoun-like words: KISS-ICP 1.3 1.2 %, evo 1.38 1.5 %, jaxlie 1.5 1.7 %, symforce 0.12 2.3 %.
"""

import ast
import re
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
OWN = ("pgti_gtsam", "scenarios")
PRONOUNS = frozenset(
    ["it", "its", "itself", "one", "ones", "what", "whatever", "which", "whose", "who", "this", "these", "those"]
    + ["they", "them", "their", "theirs", "there", "others"]
)
LONG_BODY = 18  # lines, beyond which a body shows its steps


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Function:
    """A function of a module: head and body without the docstring, and parameters without self and cls."""

    where: str
    head: str
    body: str
    docstring: str
    parameters: tuple[str, ...]
    is_public: bool

    @property
    def n_lines(self):
        return (self.head + self.body).count("\n")

    @property
    def is_long(self):
        return self.body.count("\n") > LONG_BODY

    @property
    def lacks_steps(self):
        return self.is_long and re.search(r"^\s*# ", self.body, re.MULTILINE) is None

    @property
    def lacks_parameters(self):
        return self.is_public and len(self.parameters) > 1 and "Parameters\n----------\n" not in self.docstring


def functions(path):
    """All functions of a module. Functions in functions and in private classes are private."""
    text = path.read_text(encoding="utf-8")
    lines = text.splitlines(keepends=True)

    def walk(node, is_public):
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
                seen = is_public and not child.name.startswith("_")
                yield function(child, seen)
                yield from walk(child, False)
            else:
                is_private = isinstance(child, ast.ClassDef) and child.name.startswith("_")
                yield from walk(child, is_public and not is_private)

    def function(node, is_public):
        docstring = ast.get_docstring(node) or ""
        head = node.body[0].lineno - 1  # the line of the docstring, or of the first statement
        first = node.body[0].end_lineno if docstring else head
        arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
        return Function(
            where=f"{path}:{node.lineno} {node.name}",
            head="".join(lines[node.lineno - 1 : head]),
            body="".join(lines[first : node.end_lineno]),
            docstring=docstring,
            parameters=tuple(each.arg for each in arguments if each.arg not in ("self", "cls")),
            is_public=is_public and not is_command(node),
        )

    return list(walk(ast.parse(text), True))


def is_command(node):
    """Whether a function is a command of the command line: the annotations of its options carry their help."""
    annotations = [ast.unparse(each.annotation) for each in node.args.args if each.annotation]
    return any("typer." in each or each in ("File", "Map", "MapOrStream") for each in annotations)


def modules(folder):
    return sorted(Path(folder).rglob("*.py"))


def pronoun_share(folder):
    """Share of pronoun-like words among all words of docstrings."""
    words = [word for path in modules(folder) for word in docstring_words(path)]
    return sum(word in PRONOUNS for word in words) / max(len(words), 1)


def docstring_words(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield from re.findall(r"[a-z']+", (ast.get_docstring(node) or "").lower())


def cycles(folder):
    """Pairs of modules that import each other, directly or through others."""
    root = Path(folder).resolve()
    files = {".".join(path.relative_to(root.parent).with_suffix("").parts): path for path in modules(root)}
    imports = {name: set(imported(path, files)) - {name} for name, path in files.items()}
    reached = {name: reachable(name, imports) for name in imports}
    return sorted((a, b) for a in reached for b in reached[a] if a < b and a in reached[b])


def imported(path, files):
    """The modules among `files` that a module imports, wherever in the module."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            names += [] if all(has(files, name) for name in names) else [str(node.module)]
        else:
            continue
        yield from (known for name in names for known in (name, f"{name}.__init__") if known in files)


def has(files, name):
    return name in files or f"{name}.__init__" in files


def reachable(name, imports):
    seen, left = set(), [name]
    while left:
        new = imports[left.pop()] - seen
        seen |= new
        left += new
    return seen


def figures(folder):
    """Every figure of a folder, by a name for people."""
    found = [each for path in modules(folder) for each in functions(path)]
    long = [each for each in found if each.is_long]
    public = [each for each in found if each.is_public and len(each.parameters) > 1]
    return {
        "pronoun-like words of docstrings": f"{pronoun_share(folder):.1%}",
        "bodies beyond 18 lines that show their steps": share([not each.lacks_steps for each in long]),
        "public functions of two parameters or more that tell them": share(
            [not each.lacks_parameters for each in public]
        ),
        "lines of code of a function, 90th percentile": f"{np.percentile([each.n_lines for each in found], 90):.0f}",
        "lines of the longest module": str(max(map(n_lines, modules(folder)))),
        "modules in import cycles": str(len({name for pair in cycles(folder) for name in pair})),
    }


def share(holds):
    return f"{sum(holds)} of {len(holds)}"


def n_lines(path):
    return path.read_text(encoding="utf-8").count("\n")


@pytest.fixture(scope="module", params=OWN)
def folder(request):
    return ROOT / request.param


@pytest.fixture(scope="module")
def found(folder):
    return [each for path in modules(folder) for each in functions(path)]


def test_docstrings_name_their_nouns(folder):
    assert pronoun_share(folder) <= 0.025


def test_long_bodies_show_their_steps(found):
    long = [each for each in found if each.is_long]
    lacking = [each.where for each in long if each.lacks_steps]
    assert len(lacking) <= 0.2 * len(long), "\n".join(lacking)


def test_public_functions_tell_their_parameters(found):
    assert [each.where for each in found if each.lacks_parameters] == []


def test_functions_are_short(found):
    assert np.percentile([each.n_lines for each in found], 90) <= 27


def test_modules_are_short(folder):
    assert [path for path in modules(folder) if n_lines(path) > 400] == []


def test_no_modules_import_each_other(folder):
    assert cycles(folder) == []


def test_cycles_are_found(tmp_path):
    package = tmp_path / "ring"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "first.py").write_text("from ring import second\n")
    (package / "second.py").write_text("from ring.first import anything\n")
    assert cycles(package) == [("ring.first", "ring.second")]


def main(folders):
    for name in folders or [str(ROOT / own) for own in OWN]:
        print(name)  # noqa: T201
        for what, value in figures(name).items():
            print(f"  {what:60}{value:>12}")  # noqa: T201


if __name__ == "__main__":
    main(sys.argv[1:])
