"""Mutation testing: are tests there that fail when an operator of a module is another one?

    python tests/mutations.py estimation/consider.py 20 tests/unit/estimation/test_consider.py [more tests]

Comparisons, arithmetic, signs and logical operators are exchanged one at a time, at random places of a fixed seed. Each
mutant runs the tests in a process of its own that has the mutated module in place of the file, until one fails. What
survives is printed: it needs a test, or is equivalent. Not for compiled kernels, whose source numba reads itself.
"""

import ast
import importlib.abc
import importlib.util
import os
import random
import signal
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TIMEOUT_S = 180
OTHERS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.And: ast.Or, ast.Or: ast.And, ast.USub: ast.UAdd, ast.Not: None,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip


def places(tree):
    """Nodes with an operator that can be another one, and which of their operators; texts are not computed with."""
    for node in ast.walk(tree):
        texts = isinstance(node, ast.BinOp) and any(
            isinstance(side, ast.JoinedStr)
            or (isinstance(side, ast.Constant) and isinstance(side.value, str))
            for side in (node.left, node.right)
        )
        for k, operator in enumerate(getattr(node, "ops", [getattr(node, "op", None)])):
            if type(operator) in OTHERS and not texts:
                yield node, k


def mutate(node, k):
    """Exchange an operator, and say what was done."""
    before = ast.unparse(node)
    if isinstance(node, ast.Compare):
        node.ops[k] = OTHERS[type(node.ops[k])]()
    elif isinstance(node.op, ast.Not):
        node.op, node.operand = ast.Not(), ast.UnaryOp(ast.Not(), node.operand)
    else:
        node.op = OTHERS[type(node.op)]()
    return f"line {node.lineno}: {before}  ->  {ast.unparse(node)}"


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
    """Whether a test fails with the mutated module; one that does not end counts as failed."""
    child = os.fork()
    if not child:
        os.setpgid(0, 0)
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        sys.meta_path.insert(0, Mutated(module, path, tree))
        import pytest

        options = ["-x", "-q", "-p", "no:cacheprovider", "--assert=plain", "-m", "not slow"]
        os._exit(int(pytest.main([*options, *tests])))
    until = time.monotonic() + TIMEOUT_S
    while time.monotonic() < until:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status != 0
        time.sleep(0.05)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return True


def main(file, most, *tests):
    import astropy.time  # noqa: F401  what takes long to import, once for all
    import numba  # noqa: F401
    import pyarrow  # noqa: F401
    import scipy.linalg  # noqa: F401

    os.chdir(ROOT)
    path = ROOT / "src" / "radioloc" / file
    module = "radioloc." + ".".join(Path(file).with_suffix("").parts)
    source = path.read_text()
    if fails(module, path, ast.parse(source), tests):
        sys.exit(f"{file}: the tests fail without a mutation")
    count = len(list(places(ast.parse(source))))
    chosen = sorted(random.Random(1).sample(range(count), min(int(most), count)))
    killed = 0
    for place in chosen:
        tree = ast.parse(source)
        node, k = list(places(tree))[place]
        what = mutate(node, k)
        found = fails(module, path, tree, tests)
        killed += found
        if not found:
            print(f"  survives, {what}", flush=True)
    print(f"{file}: {killed} of {len(chosen)} mutants killed ({count} places)", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
