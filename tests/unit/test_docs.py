"""Correctness of the documentation: links, files, keys, columns, terms and sizes, commands and code."""

import dataclasses
import json
import re
import runpy
import shlex
import tomllib
from pathlib import Path
from typing import NamedTuple

import pytest
from paths import EXAMPLES, ROOT
from recorded import recorded

import radioloc
from radioloc.cli import main
from radioloc.dynamics.elements import EQUINOCTIAL, KEPLERIAN
from radioloc.imaging.study import TABLES as IMAGE_TABLES
from radioloc.imaging.study import read_image_study
from radioloc.measurements.registry import MEASUREMENTS
from radioloc.measurements.table_columns import COLUMNS
from radioloc.media import MEDIA
from radioloc.parameters.registry import PARAMETERS
from radioloc.results.tables import RESIDUAL_COLUMNS
from radioloc.study.schema import keys_of
from radioloc.study.study import PARAMETER_KEYS
from radioloc.study.study_file import GEODETIC, TABLES

DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
OTHER_PAGES = [
    ROOT / name
    for name in (
        "README.md",
        "CONTRIBUTING.md",
        "kernels/README.md",
        "examples/change5/README.md",
        "examples/reflectors/README.md",
    )
]


class Block(NamedTuple):
    """A fenced block of a page; `file` is what a first line such as ``# study.toml`` names."""

    language: str
    text: str
    file: str | None


def blocks(page: Path) -> list[Block]:
    links = []
    for language, text in re.findall(r"^```(\w*)\n(.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL):
        name = re.match(r"# (\S+\.(?:toml|csv))\n", text)
        links.append(Block(language, text, name[1] if name else None))
    return links


def prose(page: Path) -> str:
    """Text of a page without its fenced blocks."""
    return re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)


def anchors(page: Path) -> set[str]:
    """Anchors that GitHub gives to the headings."""
    headings = re.findall(r"^#+ (.*)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings}


def rows_of_table(page: Path, first_heading: str) -> list[list[str]]:
    """Cells of the rows of the table whose heading begins with a word, without heading and ruler."""
    lines = page.read_text().splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith(f"| {first_heading} |"))
    rows = []
    for line in lines[start + 2 :]:
        if not line.startswith("|"):
            return rows
        rows.append([cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]])
    return rows


def quoted(text: str) -> set[str]:
    return set(re.findall(r"`([^`]+)`", text))


# Pages as text.


@pytest.mark.parametrize("page", [*PAGES, *OTHER_PAGES], ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    for address in re.findall(r"\[[^\]]*\]\(([^)\s]+)\)", prose(page)):
        if re.match(r"[a-z]+:", address):
            continue
        name, _, anchor = address.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), f"{page.name}: {address}"
        if anchor:
            assert anchor in anchors(target), f"{page.name}: {address}"


def test_index_lists_every_page():
    listed = {
        (DOCS / a).resolve() for a in re.findall(r"\]\(([^)#]+\.md)\)", (DOCS / "index.md").read_text())
    }
    assert listed >= {page for page in PAGES if page.name != "index.md"}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(DOCS)))
def test_files_named_are_there(page):
    for name in quoted(prose(page)):
        if re.match(r"(tests|examples|kernels|docs|src)/\S*$", name):
            assert (ROOT / name).exists(), f"{page.name}: {name}"


@pytest.mark.parametrize("page", [*PAGES, *OTHER_PAGES], ids=lambda p: str(p.relative_to(ROOT)))
def test_what_is_installed_is_the_checkout_and_its_extras(page):
    """The pages install the checkout, as radioloc has not been released."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for package in re.findall(r"pip install (?:-\S+ )*(\S+)", page.read_text()):
        name = re.fullmatch(r"'?\.(?:\[(\w+)\])?'?[`.,;)]*", package)
        assert name, package
        assert name[1] is None or name[1] in extras, package


# What the code has against what the pages say.


def test_what_the_architecture_adds_is_the_package_that_is_tested():
    page, package = (DOCS / "architecture.md").read_text(), ROOT / "tests" / "data" / "plugin_package"
    modules = [file for file in sorted((package / "radioloc_toys").glob("*.py")) if file.stem != "__init__"]
    shown = [block.text for block in blocks(DOCS / "architecture.md") if block.language == "python"]
    assert set(shown) <= {file.read_text() for file in modules}
    assert all(file.read_text() in shown or f"radioloc_toys/{file.name})" in page for file in modules)
    project = (package / "pyproject.toml").read_text()
    assert project[project.index("[project.entry-points") :] in page


def touch_named_files(folder):
    """Files that the example of the study file names beside those that ship."""
    for name in (
        "my_c04.txt",
        "ranges.kvn",
        "night.dat",
        "night.tdm",
        "y2006.vmf3_r",
        "y2007.vmf3_r",
        "gpt3_5.grd",
        "dsn_2006.tro",
        "dsn_2006.ion",
        "dem_10m.tif",
        "strip_0236.tif",
        "strip_0237.tif",
        "mosaic_7m.tif",
        "grblugf2012_100_0434smmmv1.odf",
        "grblugf2012_101_0350smmmv1.odf",
    ):
        (folder / name).touch()
    (folder / "strips").mkdir()
    for name in ("strip07.tif", "strip07.json"):
        (folder / "strips" / name).touch()
    (folder / "sites.txt").write_text("4171 CB   52.8344    6.3785     10    An Observer\n")
    (folder / "quasars.csv").write_text(
        "source,right_ascension_deg,declination_deg\n0059+581,15.690677,58.403093\n"
    )
    tie = [
        {"name": f"map_tie.map.{axis}", "unit": "m", "sigma": 25.0, "position_enu_m": [0.0, 0.0, 0.0]}
        for axis in ("east", "north")
    ]
    images = recorded("images", sigma_m=(26.0, 26.0, 11.0), method="images", message="", considered=tie)
    for name in ("images", "radio"):
        (folder / "out" / name).mkdir(parents=True)
        (folder / "out" / name / "solution.json").write_text(json.dumps(images))


def test_every_key_of_a_study_of_images():
    documented = documented_keys("image-study.md")
    assert documented == {name: set(keys_of(record)) for name, record in IMAGE_TABLES.items()}


def documented_keys(page: str = "study-file.md") -> dict[str, set[str]]:
    """Keys by table, from the headings and tables of a page of a study file."""
    keys: dict[str, set[str]] = {}
    names: list[str] = []
    for line in prose(DOCS / "reference" / page).splitlines():
        if line.startswith("## "):
            names = re.findall(r"\[([\w.]+)\]", line)
        elif match := re.match(r"\| ((`\w+`(, )?)+) \|", line):
            for name in names:
                keys.setdefault(name, set()).update(quoted(match[1]))
    return keys


def test_every_key_of_the_study_file(workspace):
    keys = {name: set(keys_of(record)) for name, record in TABLES.items()}
    assert set(PARAMETER_KEYS) < keys["estimate"]
    keys["estimate"] -= set(PARAMETER_KEYS)  # which the page has as a rule
    documented = documented_keys()
    documented["estimate"] -= set(PARAMETERS)  # the table of kinds
    documented["targets.NAME"] |= documented["target"]  # of a spacecraft among several targets
    # Those of a spacecraft have a section of their own, under the same name.
    assert documented == keys
    # The example shows every key but those that exclude each other.
    [example] = [b for b in blocks(DOCS / "reference" / "study-file.md") if b.file == "everything.toml"]
    (workspace / example.file).write_text(example.text)
    touch_named_files(workspace)
    assert radioloc.read_study(workspace / example.file).name == "everything"
    written = tomllib.loads(example.text)
    shown = {**written, "stations.NAME": written["stations"]["MYSITE"]}
    for table in ("frequencies", "uplinks", "weights", "map_positions"):
        [shown[f"observations.{table}"]] = written["observations"][table]
    place = written["target"] | written["reference"]
    shown |= dict.fromkeys(("target", "reference", "references.NAME", "targets.NAME"), place)
    excluded = {"kind", "trajectory", "body", "ionex", "vmf3_orography", "solution", "known_deg_m", "orbit"}
    excluded |= {"dynamics", "epoch", "velocity_m_s", "altitude_m", "axes", *KEPLERIAN, *EQUINOCTIAL}
    for table in [key for key in keys if key.startswith(("forces", "estimate.orbit", "target.landing"))]:
        del keys[table]  # of an orbiter
    keys["stations.NAME"] -= set(GEODETIC)
    assert all(set(shown[name]) >= keys[name] - excluded for name in keys)


def test_defaults_and_choices_of_the_study_file_are_those_of_the_schema():
    """Rows of the reference state the default of each key and all of a few choices."""
    rows: dict[tuple[str, str], list[str]] = {}
    tables: list[str] = []
    for line in prose(DOCS / "reference" / "study-file.md").splitlines():
        if line.startswith("## "):
            tables = re.findall(r"\[([\w.]+)\]", line)
        elif match := re.match(r"\| ((`\w+`(, )?)+) \|", line):
            cells = [cell.strip().replace("`", "") for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
            rows |= {(table, key): cells for table in tables for key in quoted(match[1])}
    wrong = []
    for table, record in TABLES.items():
        for field in dataclasses.fields(record):
            if "keys" in field.metadata or table == "target.landing":
                continue
            cells = rows.get((table, field.name)) or rows["target", field.name]
            if any(f'"{choice}"' not in " ".join(cells) for choice in field.metadata.get("choices", ())[:6]):
                wrong += [(table, field.name, "choices")] * (len(field.metadata["choices"]) <= 6)
            default, needed = field.default, field.default_factory is dataclasses.MISSING
            if default is dataclasses.MISSING:
                text = "needed" if needed else ""
            elif isinstance(default, bool):
                text = str(default).lower()
            elif isinstance(default, int | float):
                text = f"{default:g}"
            else:
                text = f'"{default}"' if isinstance(default, str) and default else ""
            if text not in cells[1]:
                wrong.append((table, field.name, f"default {text}"))
    assert wrong == []


def test_every_kind_of_parameter_has_its_row():
    rows = rows_of_table(DOCS / "reference" / "study-file.md", "parameter")
    assert [(row[0].strip("`"), row[1], row[2], row[3]) for row in rows] == [
        (
            kind.name,
            kind.unit,
            ", ".join(scope.value for scope in kind.scopes),
            ", ".join(filter(None, kind.components)) or "-",
        )
        for kind in PARAMETERS.values()
    ]


def test_every_column_of_the_table_of_observations():
    page = DOCS / "reference" / "observation-table.md"
    assert {row[0].strip("`") for row in rows_of_table(page, "column")} == set(COLUMNS)


def test_every_type_of_measurement():
    page = DOCS / "reference" / "observation-table.md"
    rows = {row[0].strip("`"): row[1].strip("`").replace("\\|", "|") for row in rows_of_table(page, "type")}
    assert rows == {name: kind.form for name, kind in MEASUREMENTS.items()}


def test_every_column_of_residuals():
    page = DOCS / "reference" / "output-files.md"
    assert tuple(row[0].strip("`") for row in rows_of_table(page, "column")) == RESIDUAL_COLUMNS


@pytest.fixture(scope="module")
def solution():
    return radioloc.locate(radioloc.read_study(EXAMPLES / "apollo15" / "apollo15.toml"))


def test_every_key_of_the_solution(solution):
    page = DOCS / "reference" / "output-files.md"
    documented = set().union(*(quoted(row[0]) for row in rows_of_table(page, "key")))
    summarized = {"biases", "time_biases", "provenance"}  # described as a whole

    def keys(value, prefix):
        if isinstance(value, dict) and value and prefix not in summarized:
            starred = prefix in ("fit.by_station", "fit.by_type", "fit.by_path")
            for name, item in value.items():
                if starred:
                    yield f"{prefix}.*"
                else:
                    yield from keys(item, f"{prefix}.{name}" if prefix else name)
        else:
            yield prefix

    assert documented - {"reference"} == set(keys(solution.to_dict(), ""))


# Commands and code.


@pytest.fixture
def workspace(tmp_path, monkeypatch):
    """A folder that has the project's examples and kernels, to work in; media that a page registers end with it."""
    monkeypatch.setattr(MEDIA, "_entries", {**MEDIA})
    monkeypatch.setattr(MEDIA, "_registered", set())
    for name in ("examples", "kernels"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def without_numbers(text: str) -> str:
    """Words of a card: values change in the last digit from machine to machine, and line breaks with them."""
    return " ".join(re.sub(r"[-+]?\d[\d.]*", "#", text).split())


def runs(language: str) -> list[Path]:
    return [page for page in PAGES if any(block.language == language for block in blocks(page))]


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", sorted({*runs("sh"), *runs("python")}), ids=lambda p: str(p.relative_to(DOCS))
)
def test_commands_and_code_run(page, workspace, restored_registries, capsys):
    for block in blocks(page):
        if block.file:
            (workspace / block.file).write_text(block.text)
    for block in blocks(page):
        if block.language == "sh":
            for line in block.text.splitlines():
                program, *arguments = shlex.split(line, comments=True)
                if [program, *arguments[:1]] == ["pip", "install"]:
                    continue  # of extras, which the development environment has
                assert program == "radioloc"
                if arguments == ["--version"]:
                    with pytest.raises(SystemExit) as ended:
                        main(arguments)
                    assert ended.value.code == 0
                else:
                    assert main(arguments) == 0, line
        elif block.language == "python":
            exec(compile(block.text, str(page), "exec"), {})
        elif block.language == "text" and block.text.startswith(
            ("solution ", "arc lengths ", "monte carlo ", "omissions ")
        ):
            assert without_numbers(block.text) in without_numbers(capsys.readouterr().out)


def test_delays_beside_quasars_fit_as_the_page_has_them(workspace):
    """Clocks of 0.3 us and 2e-13, noise of 2 and 3 cm."""
    for block in blocks(DOCS / "how-to" / "delta-dor.md"):
        if block.file:
            (workspace / block.file).write_text(block.text)
    solution = radioloc.locate("lander.toml")
    assert solution.converged
    assert len(solution.residuals) == 8
    assert solution.fit.total.rms_m < 0.03
    study = radioloc.read_study("lander.toml")
    differenced = radioloc.compute_residuals(study, radioloc.read_observations("differenced.csv"))
    assert differenced.residuals.residual_m == pytest.approx(0.0, abs=3.0 * 0.03)


@pytest.mark.parametrize("page", runs("toml"), ids=lambda p: str(p.relative_to(DOCS)))
def test_toml_is_a_study_or_part_of_one(page, workspace):
    touch_named_files(workspace)
    for block in blocks(page):
        if block.language != "toml":
            continue
        content = tomllib.loads(block.text)
        if {"images", "image_point", "stereo", "base_map"} & set(content):
            if block.file:
                (workspace / block.file).write_text(block.text)
                read_image_study(workspace / block.file)
            continue
        assert set(content) <= {
            "target",
            "targets",
            "observations",
            "estimate",
            "consider",
            "covariance",
            "forces",
            "model",
            "stations",
            "reference",
            "references",
            "simulation",
        }
        if block.file:
            for data in blocks(page):
                if data.file and data.file.endswith(".csv"):
                    (workspace / data.file).write_text(data.text)
            (workspace / block.file).write_text(block.text)
            radioloc.read_study(workspace / block.file)


def test_commands_options_and_exit_statuses_are_those_of_the_parser():
    """After a change of the command line: ``python docs/command_reference.py``."""
    script = runpy.run_path(str(DOCS / "command_reference.py"))
    text = script["PAGE"].read_text(encoding="utf-8")
    assert script["updated"](text) == text
