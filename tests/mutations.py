"""Mutation testing: are there tests that fail when one thing in a module is another one?

    python tests/mutations.py                                   # the modules of TESTS, 15 changes of each
    python tests/mutations.py estimation/consider.py 40         # more of one module
    python tests/mutations.py lunar/tide.py 20 tests/unit/lunar/test_tide.py    # of any other, with its tests

Operators, signs, numbers, limits of comparisons, conditions and the likes of `min` are exchanged, statements left out,
one at a time, at random places of a fixed seed. Each mutant runs the tests in a process of its own that has the mutated
module in place of the file, until one fails. What survives is printed: it needs a test, or is equivalent. Left alone
are texts, and thresholds at the head of a module, which are judgements. Not for compiled kernels, whose source numba
reads itself.
"""

import ast
import importlib.abc
import importlib.util
import os
import random
import resource
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MANY = 15
LIMIT_S, LIMIT_BYTES = 120, 8 << 30  # of processor time and memory: no loop is endless, no array huge
TESTS = {
    "measurements": {
        "chebyshev_predictor": "", "combined_predictor": "", "dense_series": "chebyshev_predictor",
        "equipment_delays": "",
        "exact_predictor": "exact_predictor arc_selection differenced", "light_path": "light_path gravitational_delay",
        "prepared_paths": "exact_predictor arc_selection", "link": "observations differenced",
        "lunar_motion": "lunar_motion trajectory",
        "observations": "", "physical_model": "", "predictor": "arc_selection combined_predictor",
        "registry": "combined_predictor differenced measurement_type observations", "station_motion": "",
    },
    "estimation": {
        "consider": "consider budget", "editing": "", "phase_editing": "",
        "gauss_markov": "", "least_squares": "",
        "linearization": "least_squares linear_problem", "observability": "",
        "robust": "editing linear_problem", "series": "gauss_markov correlated_weights",
        "statistics": "", "time_correlation": "time_correlation correlated_weights",
        "variance_components": "",
    },
    "noise": {"covariance": "whiteners", "processes": "whiteners", "whitening": "whiteners"},
}  # fmt: skip
"""Unit tests by module, of the same name where none is given."""
OTHERS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult,
    ast.Pow: ast.Mult, ast.MatMult: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.And: ast.Or, ast.Or: ast.And, ast.USub: ast.UAdd,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
BEYOND = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
NAMES = {"min": "max", "minimum": "maximum", "any": "all", "argmin": "argmax", "floor": "ceil"}
NAMES |= {other: name for name, other in NAMES.items()}
Change = tuple[ast.AST, Callable[[], None]]


def parts(node: ast.AST) -> Iterator[ast.AST]:
    """Walk what is computed: no texts, types, decorators or checks of lengths."""
    if isinstance(node, ast.keyword) and node.arg in ("strict", "stacklevel", "copy"):
        return
    yield node
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not isinstance(child, ast.JoinedStr):
                yield from parts(child)


def is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def changes(tree: ast.Module) -> Iterator[Change]:
    """What can be changed: a node to show before and after, and a function that changes it."""
    judged = {
        id(one)
        for node in tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign) and not isinstance(node.value, ast.Call)
        for one in ast.walk(node)
    }
    for node in parts(tree):
        if id(node) not in judged:
            yield from of_expression(node)
            yield from of_statements(node)


def of_expression(node: ast.AST) -> Iterator[Change]:
    match node:
        case ast.BinOp(left=left, right=right) if is_text(left) or is_text(right):
            pass
        case ast.BinOp(op=op) | ast.BoolOp(op=op) | ast.UnaryOp(op=op) if type(op) in OTHERS:
            yield node, lambda: setattr(node, "op", OTHERS[type(op)]())
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            yield node, lambda: setattr(node, "operand", ast.UnaryOp(ast.Not(), operand))
        case ast.UnaryOp(op=ast.Invert(), operand=operand):
            yield node, lambda: setattr(node, "operand", ast.UnaryOp(ast.Invert(), operand))
        case ast.Compare(ops=ops, comparators=with_these):
            for k, op in enumerate(ops):
                yield node, lambda k=k, op=op: ops.__setitem__(k, OTHERS[type(op)]())
                whole = isinstance(with_these[k], ast.Constant) and isinstance(with_these[k].value, int)
                if type(op) in BEYOND and whole:
                    yield node, lambda k=k, op=op: ops.__setitem__(k, BEYOND[type(op)]())
        case ast.Constant(value=bool(value)):
            yield node, lambda: setattr(node, "value", not value)
        case ast.Constant(value=int(value)):
            yield node, lambda: setattr(node, "value", value + 1)
        case ast.Constant(value=float(value)):
            yield node, lambda: setattr(node, "value", 2.0 * value or 1.0)
        case ast.If(test=test) | ast.IfExp(test=test) if isinstance(
            test, ast.Name | ast.Attribute | ast.Call
        ):
            yield node, lambda: setattr(node, "test", ast.UnaryOp(ast.Not(), test))
        case ast.Call(func=ast.Name(id=name) as called) if name in NAMES:
            yield node, lambda: setattr(called, "id", NAMES[name])
        case ast.Call(func=ast.Attribute(attr=name) as called) if name in NAMES:
            yield node, lambda: setattr(called, "attr", NAMES[name])


def of_statements(node: ast.AST) -> Iterator[Change]:
    """Statements that can be left out without a name missing."""
    for field in ("body", "orelse"):
        block = getattr(node, field, None)
        for k, one in enumerate(block if isinstance(block, list) else ()):
            match one:
                case (
                    ast.Expr(value=ast.Call()) | ast.AugAssign() | ast.Raise() | ast.Continue() | ast.Break()
                ):
                    pass
                case ast.Assign(targets=[ast.Subscript() | ast.Attribute()]):
                    pass
                case ast.Assign(targets=[ast.Name(id=name)], value=value) if any(
                    isinstance(part, ast.Name) and part.id == name for part in ast.walk(value)
                ):
                    pass
                case ast.Return() if isinstance(node, ast.If | ast.For | ast.While):
                    pass
                case _:
                    continue
            yield one, lambda block=block, k=k: block.__setitem__(k, ast.Pass())


class Mutated(importlib.abc.MetaPathFinder, importlib.abc.SourceLoader):
    """Finds one module, with another source."""

    def __init__(self, name, path, tree):
        self.name, self.path, self.source = name, path, ast.unparse(ast.fix_missing_locations(tree))

    def find_spec(self, name, path, target=None):
        return importlib.util.spec_from_loader(name, self) if name == self.name else None

    def get_filename(self, name):
        return str(self.path)

    def get_data(self, path):
        return self.source.encode()


def fails(module, path, tree, tests):
    """Whether a test fails with the mutated module; one that comes to no end counts as failed."""
    child = os.fork()
    if not child:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (LIMIT_S, LIMIT_S))
        resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))
        sys.meta_path.insert(0, Mutated(module, path, tree))
        import pytest

        options = ["-x", "-q", "-p", "no:cacheprovider", "--assert=plain", "-m", "not slow"]
        os._exit(int(pytest.main([*options, *tests])))
    return os.waitpid(child, 0)[1] != 0


def shown(node):
    text = ast.unparse(node).splitlines()[0]
    return text if len(text) < 100 else f"{text[:97]}..."


def mutants(file, most, tests):
    """Print the survivors of a module; how many mutants were killed, of how many."""
    path = ROOT / "src" / "radioloc" / file
    module = "radioloc." + ".".join(Path(file).with_suffix("").parts)
    source = path.read_text()
    if fails(module, path, ast.parse(source), tests):
        sys.exit(f"{file}: the tests fail without a mutation")
    count = len(list(changes(ast.parse(source))))
    chosen = sorted(random.Random(1).sample(range(count), min(most, count)))
    killed = 0
    for place in chosen:
        tree = ast.parse(source)
        node, change = list(changes(tree))[place]
        before = shown(node)
        change()
        after = shown(node) if shown(node) != before else "left out"
        found = fails(module, path, tree, tests)
        killed += found
        if not found:
            print(f"  survives, line {node.lineno}: {before}  ->  {after}", flush=True)
    print(f"{file}: {killed} of {len(chosen)} mutants killed ({count} places)", flush=True)
    return killed, len(chosen)


def main(file=None, most=MANY, *tests):
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    import astropy.time  # noqa: F401  what takes long to import, once for all
    import numba  # noqa: F401
    import pyarrow  # noqa: F401
    import pytest  # noqa: F401
    import scipy.linalg  # noqa: F401

    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT / "src"))
    table = {
        f"{package}/{name}.py": [f"tests/unit/{package}/test_{test}.py" for test in (names or name).split()]
        for package, modules in TESTS.items()
        for name, names in modules.items()
    }
    chosen = {file: tests or table[file]} if file else table
    found = [mutants(one, int(most), of_one) for one, of_one in chosen.items()]
    killed, made = (sum(column) for column in zip(*found, strict=True))
    print(f"{killed} of {made} mutants killed")


if __name__ == "__main__":
    main(*sys.argv[1:])
