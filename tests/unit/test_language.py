"""Plain English in source and tests: bounds on docstring openings, pronouns as names, and phrases of denial."""

import ast
import re
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
    n_openings = n_pronouns = n_phrases = 0
    for path in set(folder.glob("*.py")) - {Path(__file__)}:
        text = path.read_text()
        comments = re.findall(r"^\s*#.*", text, re.MULTILINE)
        names, texts = [], comments
        for node in ast.walk(ast.parse(text)):
            match node:
                case ast.Module() | ast.ClassDef() | ast.FunctionDef():
                    n_openings += bool(OPENINGS.match(ast.get_docstring(node) or ""))
            match node:
                case ast.ClassDef(name=name) | ast.FunctionDef(name=name) | ast.arg(arg=name):
                    names.append(name)
                case ast.Name(id=name, ctx=ast.Store()):
                    names.append(name)
                case ast.Constant(value=str(value)):
                    texts.append(value)
        n_pronouns += sum(bool(PRONOUNS.fullmatch(name)) for name in names)
        n_phrases += sum(len(PHRASES.findall(value)) for value in texts)
    return n_openings, n_pronouns, n_phrases


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
