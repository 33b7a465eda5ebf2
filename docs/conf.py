"""How Sphinx makes a site of these pages (`make docs`), which stay plain Markdown, linked as files are."""

import importlib
import inspect
import pkgutil
import re
import sys
from itertools import chain
from pathlib import Path
from posixpath import normpath

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.pycode import ModuleAnalyzer

import radioloc

ROOT = Path(__file__).resolve().parents[1]

project = "radioloc"
author = project_copyright = "The radioloc developers"
version = release = radioloc.__version__

# The source folder is that of the project, so that links between documents, examples and the README hold.
root_doc = "docs/index"
include_patterns = [
    "*.md",
    "docs/**",
    "examples/*/README.md",
    "examples/notebooks/*.ipynb",
    "kernels/README.md",
]
exclude_patterns = [".*", "out", "src", "tests", "docs/_*"]
templates_path = [str(ROOT / "docs" / "_templates")]  # in full, as autosummary looks in the source folder
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "numpydoc"]
nitpicky = True
highlight_language = "text"  # of blocks that name no language

myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 6
nb_execution_mode = "off"

autodoc_member_order = "bysource"
autodoc_typehints = "none"
numpydoc_show_class_members = False  # autodoc has them
python_maximum_signature_line_length = 88

html_theme = "furo"
html_title = f"radioloc {version}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_search_summary = False  # scripts of a page that is opened from a disk may not read other pages


def public_names() -> dict[str, list[tuple[str, str]]]:
    """Names of each package's ``__all__``: the place where each is documented, and what kind of thing it is.

    What several packages name is documented on the page of the one that defines it.
    """
    modules = [
        "radioloc",
        *(
            module.name
            for module in pkgutil.iter_modules(radioloc.__path__, "radioloc.")
            if module.name != "radioloc.__main__"
        ),
    ]
    faces = {name: importlib.import_module(name) for name in modules}

    def described(name, public):
        value = getattr(faces[name], public)
        home = ".".join(str(getattr(value, "__module__", name)).split(".")[:2])
        place = home if public in getattr(faces.get(home), "__all__", ()) else name
        if isinstance(value, type):
            return f"{place}.{public}", "exception" if issubclass(value, BaseException) else "class"
        return f"{place}.{public}", "function" if inspect.isroutine(inspect.unwrap(value)) else "data"

    return {
        name: [described(name, public) for public in face.__all__ if public != "__version__"]
        for name, face in faces.items()
        if hasattr(face, "__all__")
    }


autosummary_context = {"names": public_names()}


def data_docstring(app, what, name, value, options, lines):
    """Insert the text below a constant, from the module that defines it: the package or one of its imports."""
    package, _, public = name.rpartition(".")
    if what != "data" or (package, public) == ("radioloc", "__version__"):
        return
    source = Path(importlib.import_module(package).__file__).read_text()
    home = re.search(rf"^ *from (\S+) import (?:[^\n(]*|\([^)]*)\b{public}\b", source, re.MULTILINE)
    lines[:] = ModuleAnalyzer.for_module(home[1] if home else package).find_attr_docs()["", public]


def resolve(name):
    """Return the object of a full name, or None."""
    words = name.split(".")
    for k in range(len(words), 0, -1):
        try:
            value = importlib.import_module(".".join(words[:k]))
        except ImportError:
            continue
        for word in words[k:]:
            value = getattr(value, word, None)
        return value
    return None


def missing_reference(app, env, node, contnode):
    """Resolve a name in the namespace of its docstring: a link if a page has it, and otherwise plain text."""
    if node.get("refdomain") != "py":
        return None
    target, package = node["reftarget"], node.get("py:module") or "radioloc"
    places = [target, *(f"{name}.{target}" for name in sorted(sys.modules) if name.startswith(package))]
    if node.get("py:class"):
        places += [f"{place.removesuffix(target)}{node['py:class']}.{target}" for place in places]
    value = next((value for value in map(resolve, places) if value is not None), None)
    for place, _ in chain(*autosummary_context["names"].values()):
        if place.endswith("." + target.rpartition(".")[2]) and resolve(place) is value:
            return env.domains["py"].resolve_xref(
                env, node["refdoc"], app.builder, "obj", place, node, contnode
            )
    return None if value is None else contnode


def contents_of_index(app, docname, source):
    """Give the index, whose sections are lists of links, the table of contents that they are."""
    if docname != root_doc:
        return
    for title, body in re.findall(r"^## ([^\n]*)$(.*?)(?=^## |\Z)", source[0], re.MULTILINE | re.DOTALL):
        items = "".join(re.findall(r"^(?:- |  ).*$", body, re.MULTILINE))
        pages = [normpath(f"docs/{link}") for link in re.findall(r"\]\(([^)#]+)\)", items)]
        source[0] += "\n".join(
            ["\n```{toctree}", ":hidden:", f":caption: {title}", *(f"/{page}" for page in pages), "```\n"]
        )


def add_mathml(self, node):
    """Formulas as MathML, which browsers set without a script."""
    if isinstance(node, nodes.math_block):
        self.body.append(f'<div class="math">{convert(node.astext(), display="block")}</div>')
    else:
        self.body.append(convert(node.astext()))
    raise nodes.SkipNode


def first_page(app, exception):
    """``index.html`` at the top of the site leads to the index of the documentation."""
    page = (
        f'<!doctype html><meta http-equiv="refresh" content="0; url={root_doc}.html"><title>{project}</title>'
    )
    (Path(app.outdir) / "index.html").write_text(page)


def setup(app):
    """Connect the functions above."""
    app.connect("autodoc-process-docstring", data_docstring)
    app.connect("missing-reference", missing_reference)
    app.connect("source-read", contents_of_index)
    app.connect("build-finished", first_page)
    app.add_html_math_renderer(
        "mathml", inline_renderers=(add_mathml, None), block_renderers=(add_mathml, None)
    )


html_math_renderer = "mathml"
