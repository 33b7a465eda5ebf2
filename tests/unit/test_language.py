"""Plain English in source and tests: bounds on docstring openings, pronouns as names, and phrases of denial."""

import ast
import re
from collections import Counter
from functools import cache
from pathlib import Path

import pytest
from paths import ROOT

OPENINGS = re.compile(
    r"(as|at|by|for|from|how|if|in|it|its|likewise|no|none|not|nothing|of|on|ones?|same|so|such|that|their|these|they"
    r"|this|those|to|what|when|where|whether|which|who|whom|whose|with|without|the same)\b",
    re.IGNORECASE,
)
PRONOUNS = re.compile(
    r"_*(about|above|after|again|all_of|alone|along|already|always|among|apart|aside|away|before|below|beside|both|each"
    r"|ever|far|few|fewer|fewest|here|inside|it|its|least|less|many|mine|more|most|much|near|never|none|nothing|now"
    r"|nowhere|once|ones?|others?|outside|over|own|rest|same|still|such|that|them|then|there|these|they|this|those|thus"
    r"|together|twice|what|when|where|which|who|whole|whose|why|within|without"
    r"|asked|found|given|gone|kept|known|left|lost|made|meant|said|seen|taken|told|wanted)_*",
    re.IGNORECASE,
)
PHRASES = re.compile(
    r"\b(is|are|was|were) (no|none|nothing)\b(?! (longer|more|later|earlier|greater|larger|smaller|less)\b)"
    r"|\bhas none\b|\bnobody\b|\b(tells?|told|feels?|felt|buys?)\b|\bknows? (how|nothing|of|that|what)\b"
    r"|\bsays? (how|no|nothing|so|what|which)\b"
)
MAXIMA = {
    "src/radioloc/cli": (0, 3, 1),
    "src/radioloc/dynamics": (0, 4, 0),
    "src/radioloc/estimation": (0, 11, 0),
    "src/radioloc/imaging": (0, 9, 0),
    "src/radioloc/jobs": (0, 12, 3),
    "src/radioloc/measurements": (0, 2, 0),
    "src/radioloc/noise": (0, 4, 0),
    "src/radioloc/results": (0, 20, 3),
    "src/radioloc/simulation": (0, 1, 0),
    "tests": (3, 15, 0),
    "tests/data/odf": (0, 2, 0),
    "tests/data/plugin_package/radioloc_toys": (1, 0, 0),
    "tests/properties": (1, 11, 1),
    "tests/reference": (0, 1, 0),
    "tests/regression": (0, 5, 1),
    "tests/statistics": (0, 2, 3),
    "tests/support": (0, 1, 0),
    "tests/unit/ephemeris": (1, 0, 0),
    "tests/unit/estimation": (2, 4, 14),
    "tests/unit/io": (1, 0, 0),
    "tests/unit/jobs": (22, 0, 16),
    "tests/unit/measurements": (1, 1, 0),
    "tests/unit/parameters": (1, 0, 0),
    "tests/unit/report": (1, 0, 1),
    "tests/unit/results": (0, 4, 0),
    "tests/unit/study": (0, 1, 0),
}
"""Maximum counts by folder, to be lowered with the counts; other folders have zero."""
MAX_PATTERN_WORDS, MAX_LONG_PATTERNS = 4, 60
"""Words of a pattern of `pytest.raises` that is not prose, and number of longer ones."""


@cache
def counts(folder):
    """Return the numbers of openings, pronouns and phrases in the modules of a folder."""
    openings, names, texts = Counter(), Counter(), []
    for path in set(folder.glob("*.py")) - {Path(__file__)}:
        text = path.read_text()
        texts += re.findall(r"^\s*#.*", text, re.MULTILINE)
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                openings[(ast.get_docstring(node) or "")[:30]] += 1
            if isinstance(node, ast.ClassDef | ast.FunctionDef):
                names[node.name] += 1
            elif isinstance(node, ast.arg):
                names[node.arg] += 1
            elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                names[node.id] += 1
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.append(node.value)
    return (
        sum(count for text, count in openings.items() if OPENINGS.match(text)),
        sum(count for name, count in names.items() if PRONOUNS.fullmatch(name)),
        len(PHRASES.findall("\n".join(texts))),
    )


@pytest.mark.parametrize("package", MAXIMA)
def test_counts_are_within_their_bounds(package):
    numbers = counts(ROOT / package)
    assert all(n <= maximum for n, maximum in zip(numbers, MAXIMA[package], strict=True)), numbers


def test_each_folder_has_bounds():
    folders = {path.parent for top in ("src", "tests") for path in (ROOT / top).rglob("*.py")}
    assert {str(folder.relative_to(ROOT)) for folder in folders if any(counts(folder))} <= set(MAXIMA)


def test_few_tests_match_prose():
    long_patterns = [
        text
        for path in (ROOT / "tests").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.keyword) and node.arg == "match"
        for text in [ast.unparse(node.value)]
        if len(text.split()) > MAX_PATTERN_WORDS
    ]
    assert len(long_patterns) <= MAX_LONG_PATTERNS, long_patterns
