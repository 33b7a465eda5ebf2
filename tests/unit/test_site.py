"""The documentation as a site: complete, without dead links, and nothing that a browser would fetch from elsewhere."""

import importlib
import pkgutil
import subprocess
import sys
import zlib
from html.parser import HTMLParser
from urllib.parse import unquote, urlsplit

import pytest
from paths import ROOT

import radioloc

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-c", "docs", "-d", out / "trees"]
    subprocess.run([*command, ".", out / "html"], cwd=ROOT, check=True, timeout=600)
    return out / "html"


class Page(HTMLParser):
    """Anchors of a page, its links, and what a browser loads for it."""

    def __init__(self, path):
        super().__init__()
        self.anchors, self.links, self.loaded = {""}, [], []
        self.feed(path.read_text())

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.anchors.add(attrs.get("id"))
        if tag == "a" and "href" in attrs:
            self.links.append(attrs["href"])
        elif tag == "link" and attrs.get("rel") not in ("next", "prev", "index", "search", "genindex"):
            self.loaded.append(attrs["href"])
        elif "src" in attrs:
            self.loaded.append(attrs["src"])


def test_links_and_anchors_of_the_site_are_there_and_nothing_comes_from_elsewhere(site):
    pages = {path: Page(path) for path in site.rglob("*.html")}
    assert len(pages) > len(list((ROOT / "docs").rglob("*.md")))
    for path, page in pages.items():
        for address in page.links + page.loaded:
            parts = urlsplit(address)
            if parts.scheme in ("http", "https", "mailto"):
                assert address in page.links, f"{path.name} loads {address}"
                continue
            if parts.scheme == "data":
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            assert target.exists(), f"{path.name}: {address}"
            if target in pages:
                assert parts.fragment in pages[target].anchors, f"{path.name}: {address}"
    for style in site.rglob("*.css"):
        assert "url(http" not in style.read_text(), style
        assert "@import" not in style.read_text(), style


def test_the_site_has_every_public_name(site):
    text = zlib.decompress((site / "objects.inv").read_bytes().split(b"\n", 4)[4]).decode()
    documented = {line.split()[0] for line in text.splitlines()}
    modules = [module.name for module in pkgutil.iter_modules(radioloc.__path__, "radioloc.")]
    for module in {"radioloc", *modules} - {"radioloc.__main__"}:
        face = importlib.import_module(module)
        for name in set(getattr(face, "__all__", ())) - {"__version__"}:
            home = ".".join(str(getattr(getattr(face, name), "__module__", "")).split(".")[:2])
            assert {f"{module}.{name}", f"{home}.{name}"} & documented, f"{module}.{name}"


def test_formulas_are_mathml(site):
    page = (site / "docs" / "physics.html").read_text()
    assert page.count("<math") > 100
    assert "$" not in page.partition("<article")[2].partition("</article>")[0]
