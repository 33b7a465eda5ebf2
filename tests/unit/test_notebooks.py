"""The notebooks run from a fresh kernel, and show what their files keep."""

import ast
import re
from decimal import Decimal

import nbformat
import pytest
from paths import EXAMPLES, ROOT
from run_notebooks import run

NOTEBOOKS = sorted((ROOT / "examples/notebooks").glob("*.ipynb"))
MOST_BYTES = 410_000
LAST_DIGITS = 3
"""By how many units of its last digit a number may differ: rounding, and revisions of Earth orientation."""

NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder beside the examples, so that what notebooks write is not among them."""
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    place = tmp_path / "examples" / "notebooks"
    place.mkdir(parents=True)
    (tmp_path / "kernels").symlink_to(ROOT / "kernels")
    for sibling in (EXAMPLES).iterdir():
        if sibling.name != place.name:
            (place.parent / sibling.name).symlink_to(sibling)
    return place


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs_and_its_file_has_what_it_shows(path, folder):
    saved, executed = nbformat.read(path, as_version=4), run(path, folder)
    for cell, saved_cell in zip(executed.cells, saved.cells, strict=True):
        if cell.cell_type == "code":
            assert_alike(cell, saved_cell)


def assert_alike(cell, saved):
    shown, saved_shown = texts(cell), texts(saved)
    assert len(shown) == len(saved_shown), cell.source
    for text, saved_text in zip(shown, saved_shown, strict=True):
        assert NUMBER.sub("#", text).split() == NUMBER.sub("#", saved_text).split()
        for number, saved_number in zip(NUMBER.findall(text), NUMBER.findall(saved_text), strict=True):
            assert is_near(Decimal(number), Decimal(saved_number)), f"{number} is {saved_number} in the file"


def texts(cell):
    """Return the outputs of a cell as text; pictures by their formats only."""
    outputs = []
    for output in cell.outputs:
        assert output.output_type in ("stream", "display_data", "execute_result")
        if output.output_type == "stream":
            assert output.name == "stdout", f"{cell.source} warns: {output.text}"
            outputs.append(output.text)
        else:
            table = re.sub("<[^>]*>", " ", output.data.get("text/html", ""))
            outputs.append(f"{sorted(output.data)} {output.data['text/plain']} {table}")
    return outputs


def is_near(number, saved):
    exponent = saved.as_tuple().exponent
    return abs(number - saved) <= (LAST_DIGITS * Decimal(10) ** exponent if exponent else 0)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_is_small_was_run_in_order_and_ends_with_checks(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert path.stat().st_size < MOST_BYTES
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    assert code[-1] is notebook.cells[-1]
    checks = ast.parse(code[-1].source).body
    assert sum(isinstance(statement, ast.Assert) for statement in checks) > 0.6 * len(checks)


def test_numbers_agree_in_their_last_digits_only():
    assert is_near(Decimal("3.628497"), Decimal("3.628495"))
    assert not is_near(Decimal("3.62850"), Decimal("3.62846"))
    assert not is_near(Decimal("151"), Decimal("152"))


@pytest.fixture
def run_cells(folder, tmp_path):
    """Run cells of code in a fresh kernel; the outputs of each."""

    def outputs(*sources):
        path = tmp_path / "cells.ipynb"
        cells = [nbformat.v4.new_code_cell(source) for source in sources]
        nbformat.write(nbformat.v4.new_notebook(cells=cells), path)
        return [cell.outputs for cell in run(path, folder).cells]

    return outputs


FIGURE = "from radioloc.report.figures import new_figure\na = new_figure(3, 2)\na.subplots()\na"
BAR = "from radioloc.progress import progress_bar\nprogress_bar(shown=True, total=3).update(2)"
TABLE = (
    "from radioloc.results.cards import text_table\nprint(*text_table(['a', 'b'], [['1', '2']], 9), sep='|')"
)
NO_WIDGETS = "import sys\nsys.modules['ipywidgets'] = None"


@pytest.mark.study
def test_figures_and_cards_show_once_and_bars_without_warnings(run_cells):
    pyplot = "import matplotlib.pyplot as plt\nplt.plot([1, 2]);"
    cells = run_cells(FIGURE, f"{FIGURE};", pyplot, FIGURE, "b = a", TABLE, NO_WIDGETS, BAR)
    shown = [[sorted(output.data) for output in outputs] for outputs in cells[:5]]
    png = ["image/png", "text/plain"]
    assert shown == [[png], [], [png], [png], []]
    [table] = cells[5]
    assert table.text == "a  b|1  2\n"
    [bar] = [output for output in cells[-1] if output.output_type == "stream"]
    assert "2/3" in bar.text
    assert "arn" not in bar.text


@pytest.mark.slow
def test_a_bar_is_a_widget_where_there_are_some(run_cells):
    [[bar, *_]] = run_cells(BAR)
    assert "application/vnd.jupyter.widget-view+json" in bar.data
