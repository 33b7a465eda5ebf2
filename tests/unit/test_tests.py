"""Every test asserts something: one that only runs passes whatever comes out."""

import ast
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
CHECKS = {"raises", "warns", "fail", "check_call", "check_output"}


def asserts(node, helpers=frozenset()):
    """Whether a piece of code asserts, also by calling a function that does."""
    for inner in ast.walk(node):
        if isinstance(inner, ast.Assert):
            return True
        if isinstance(inner, ast.Call):
            name = getattr(inner.func, "attr", getattr(inner.func, "id", ""))
            if name.startswith("assert_") or name in CHECKS or name in helpers:
                return True
    return False


def functions(path):
    return [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.FunctionDef)]


def test_every_test_asserts():
    shared = {f.name for path in (TESTS / "toys").glob("*.py") for f in functions(path) if asserts(f)}
    idle = []
    for path in TESTS.rglob("test_*.py"):
        found, helpers, before = functions(path), set(shared), -1
        while len(helpers) > before:
            before = len(helpers)
            helpers |= {f.name for f in found if not f.name.startswith("test_") and asserts(f, helpers)}
        tests = [f for f in found if f.name.startswith("test_")]
        idle += [f"{path.relative_to(TESTS)}: {f.name}" for f in tests if not asserts(f, helpers)]
    assert idle == []
