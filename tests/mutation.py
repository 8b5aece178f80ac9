"""Change the mathematics and the gate a little, and ask the tests: `python tests/mutation.py --sample 150 --seed 0`.

A sample of cosmic-ray's mutants (`pip install cosmic-ray`), drawn by seed over all places that can be changed, and the
changes of `KNOWN`. Each mutant is imported in place of its module by a fork of this process, which runs the test files
that concern the module, up to a failure. A fork that needs five times the processor time of the
unchanged module is killed, and counts as noticed. Outcomes are written as JSON as they come; started again, the script
tries only what its file does not tell as noticed.
"""

import argparse
import ast
import difflib
import importlib
import importlib.abc
import importlib.util
import json
import os
import random
import resource
import signal
import sys
import time
from pathlib import Path

import cosmic_ray.plugins
import pytest
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "pgti_gtsam"
WARM = "gtsam hypothesis networkx numpy plotly scipy.sparse.linalg scipy.spatial scipy.stats rich typer jsonschema"
GATE = (
    "candidates gate_options admission drift_model contact_rise grown_map upright own_closures candidate_map evidence "
    "gate gate_situations units"
)
OF_GROUPS = {
    "spectral": "spectrum heat_kernel poles",
    "drift": GATE,
    "gate": GATE,
    "track": "track support_graph explained_overlaps adapter",
    "diagnosis": "meeting diagnosis diagnosis_held document",
}
OF_MODULES = {
    "integrity": "integrity",
    "support_graph": "support_graph explained_overlaps",
    "spectral/block_inverse": "block_inverse drift_model",
    "spectral/dense_kernel": "heat_kernel low_rank pole_kernel",
    "spectral/elimination_tree": "selected_inverse block_inverse pole_kernel",
    "spectral/heat_kernel": "heat_kernel integrity",
    "spectral/laplacian": "heat_kernel low_rank spectrum",
    "spectral/locality": "low_rank fleet_parts",
    "spectral/low_rank": "low_rank candidate_map",
    "spectral/one_edge": "new_ties",
    "spectral/pole_kernel": "pole_kernel",
    "spectral/poles": "poles pole_kernel",
    "spectral/selected_inverse": "selected_inverse pole_kernel",
    "spectral/spectrum": "spectrum poles optimality",
    "gate/batch": "gate own_closures cli_gate",
    "gate/candidates": f"candidates landmark_closures {GATE}",
    "drift/model": "drift_model upright own_closures gate diagnosis_held units",
    "gate/smoothers/fixed_lag": "fixed_lag saved",
    "gate/gate": f"{GATE} isam2",
    "gate/smoothers/gated": "isam2 saved fixed_lag units",
    "gate/kept/grown_map": "grown_map saved isam2 stream",
    "gate/smoothers/history": "isam2 saved fixed_lag",
    "gate/smoothers/isam2": "saved isam2",
    "gate/smoothers/kept_map": "saved isam2 stream",
    "drift/left_out": "drift_model own_closures gate",
    "drift/own_closures": "own_closures diagnosis gate",
    "gate/paper_rule": "gate spikes",
    "gate/smoothers/remembered": "saved fixed_lag",
    "gate/revisits": "gate isam2 units",
    "gate/smoothers/saved": "saved stream",
}
"""Tests that concern a module, where these are not those of the module's package. The quickest stand first."""

MATCH = "variances_of(OFFSET * unit, OFFSET_RAD, is_planar=planar)"
KNOWN = [
    ("drift/ties", "step, step_variances(step, unit), -1, _drift(step, unit) ** 2", f"step, {MATCH}, -1, 0.0"),
    ("drift/ties", "z, tolerance, slot, 0.0", "z, step_variances(z, unit), slot, 0.0"),
    ("drift/ties", "variances_of(drift * unit, drift,", "variances_of(drift / unit, drift,"),
    ("drift/ties", MATCH, MATCH.replace("*", "/")),
    ("gate/candidates", "axis=2) / unit_m", "axis=2) * unit_m"),
    ("gate/reference_map", "way_m / offered.model.units.unit_m", "way_m * offered.model.units.unit_m"),
    ("gate/smoothers/gated", "way_m / free_space_unit(pose_graph)", "way_m * free_space_unit(pose_graph)"),
]
"""Changes that earlier tests did not notice: tolerances of odometry and closures exchanged, lengths times ρ."""


def modules():
    """Names of the modules that are changed."""
    found = [PACKAGE / "integrity.py", PACKAGE / "support_graph.py"]
    for group in OF_GROUPS:
        found += sorted((PACKAGE / group).rglob("*.py"))
    return [str(path.relative_to(PACKAGE).with_suffix("")) for path in found]


def tests_of(module):
    """Test files that concern a module."""
    names = OF_MODULES.get(module) or OF_GROUPS[module.split("/")[0]]
    return [f"tests/test_{name}.py" for name in names.split()]


RECORD = {"frozen", "slots", "kw_only", "eq"}
"""Options of records: they refuse an assignment, an attribute or an unnamed argument, and compute nothing."""


def idle(code):
    """First and last lines and columns of the places that change no result, by their kind."""
    found = []
    for node in ast.walk(ast.parse(code)):
        # nothing reads annotations
        found += [getattr(node, "annotation", None), getattr(node, "returns", None)]
        if isinstance(node, ast.Call):
            name = getattr(node.func, "id", None) or getattr(node.func, "attr", None)
            options = {keyword.arg: keyword.value for keyword in node.keywords}
            # records refuse misuse, and `init=False` an argument that nobody gives
            found += [options.get(option) for option in {"dataclass": RECORD, "field": {"init"}}.get(name, ())]
            # rows of equal number are walked alike, strictly or not
            found += [options.get("strict")] if name == "zip" else []
            # NumPy takes any negative number for the size that follows from the others
            found += [size for size in node.args if name == "reshape" and ast.unparse(size) == "-1"]
    return [((at.lineno, at.col_offset), (at.end_lineno, at.end_col_offset)) for at in found if isinstance(at, ast.AST)]


def places(module):
    """Changes that cosmic-ray can make in a module: by line, column and kind, each an operator and an occurrence."""
    code = (PACKAGE / f"{module}.py").read_text()
    tree, skipped, found = get_ast(code), idle(code), {}
    for name in sorted(cosmic_ray.plugins.operator_names()):
        operator = cosmic_ray.plugins.get_operator(name)
        if operator.arguments():
            continue
        at = [start for node in ast_nodes(tree) for start, _ in operator().mutation_positions(node)]
        for occurrence, start in enumerate(at):
            if not any(first <= tuple(start) <= last for first, last in skipped):
                found.setdefault((tuple(start), name.split("_")[0]), []).append((name, occurrence))
    return found


def drawn(sample, seed):
    """The known changes, and a sample of cosmic-ray's: module, what is changed, code."""
    chosen, rng = [], random.Random(seed)
    for module, old, new in KNOWN:
        code = (PACKAGE / f"{module}.py").read_text()
        if code.count(old) != 1:
            raise SystemExit(f"{module}.py no longer says {old!r} once")
        chosen.append({"module": module, "operator": "known", "code": code.replace(old, new)})
    everywhere = [(module, place, options) for module in modules() for place, options in places(module).items()]
    for module, _, options in rng.sample(everywhere, min(sample, len(everywhere))):
        name, occurrence = rng.choice(options)
        code = (PACKAGE / f"{module}.py").read_text()
        changed = mutate_code(code, cosmic_ray.plugins.get_operator(name)(), occurrence)
        chosen.append({"module": module, "operator": name.removeprefix("core/"), "code": changed})
    return chosen, len(everywhere)


class Changed(importlib.abc.MetaPathFinder, importlib.abc.SourceLoader):
    """Imports other code in place of one module."""

    def __init__(self, module, code):
        path = PACKAGE / f"{module}.py"
        parts = ("pgti_gtsam/" + module).removesuffix("/__init__").split("/")
        self.name, self.path, self.code, self.is_package = ".".join(parts), path, code, path.name == "__init__.py"

    def find_spec(self, fullname, path, target=None):
        if fullname != self.name:
            return None
        folder = [str(self.path.parent)] if self.is_package else None
        return importlib.util.spec_from_file_location(
            fullname, self.path, loader=self, submodule_search_locations=folder
        )

    def get_filename(self, fullname):
        return str(self.path)

    def get_data(self, path):
        return self.code.encode()


def tried(module, code, files, limit_s):
    """How a fork's tests end: 0 where all pass, and its processor time."""
    child = os.fork()
    if not child:
        out = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(out, stream)
        resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s + 5))
        resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
        sys.meta_path.insert(0, Changed(module, code))
        options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-o", "addopts=", "-m", "not slow"]
        os._exit(min(pytest.main([*options, *files]), 100))
    _, status, used = os.wait4(child, 0)
    return os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime


def main():
    """Try the changes and write what became of each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sample", type=int, default=150)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("mutants.json"))
    options = parser.parse_args()
    signal.signal(signal.SIGXCPU, signal.SIG_DFL)
    for name in WARM.split():
        importlib.import_module(name)
    chosen, n_places = drawn(options.sample, options.seed)

    # what an interrupted run found
    earlier = json.loads(options.out.read_text()) if options.out.exists() else {}
    needed, rows = earlier.get("needed_s", {}), [row for row in earlier.get("mutants", []) if row["killed"]]
    known = {row["change"] for row in rows}

    # each change, with as long as its tests may take
    for each in (each for each in chosen if change(each) not in known):
        own = tests_of(each["module"])
        for file in own:
            if file not in needed:
                needed[file] = alone(file)
        started = time.monotonic()
        limit_s = int(5 * sum(needed[file] for file in own)) + 10
        ended, seconds = tried(each["module"], each["code"], own, limit_s)

        # what became of it
        row = {key: each[key] for key in ("module", "operator")} | {"change": change(each)}
        rows.append(row | {"killed": ended != 0, "exit": ended, "processor_s": round(seconds, 1)})
        tell(f"{'killed' if ended else 'SURVIVED'} {seconds:.1f} s ({time.monotonic() - started:.0f}) {row['change']}")
        counts = {"killed": sum(row["killed"] for row in rows), "tried": len(rows), "places": n_places}
        found = counts | {"seed": options.seed, "needed_s": needed, "mutants": rows}
        options.out.write_text(json.dumps(found, indent=1) + "\n")


def alone(file):
    """Processor time of a test file without a change."""
    ended, seconds = tried("integrity", (PACKAGE / "integrity.py").read_text(), [file], 3600)
    if ended:
        raise SystemExit(f"{file} fails without a change")
    return round(seconds, 1)


def change(mutant):
    """Module, line and changed lines."""
    old = (PACKAGE / f"{mutant['module']}.py").read_text().splitlines()
    lines = list(difflib.unified_diff(old, mutant["code"].splitlines(), n=0, lineterm=""))[2:]
    at = lines[0].split()[1].lstrip("-").split(",")[0]
    return f"{mutant['module']}.py:{at}: " + " ".join(line[0] + line[1:].strip() for line in lines[1:])


def tell(line):
    """Progress for who waits."""
    sys.stderr.write(line + "\n")


if __name__ == "__main__":
    main()
