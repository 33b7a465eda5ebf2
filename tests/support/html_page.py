"""Parser of HTML pages and cards."""

from html.parser import HTMLParser

VOID = {"meta", "img", "br", "input", "link"}


class Page(HTMLParser):
    """Elements in order, texts by element, and tables as rows of cells."""

    def __init__(self, text):
        super().__init__()
        self.open, self.elements, self.tables, self.words = [], [], [], []
        self.headings = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        assert len(dict(attributes)) == len(attributes), (tag, attributes)
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
        elif tag in ("h1", "h2", "h3"):
            self.headings.append(tag)
        if tag not in VOID:
            self.open.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.open.pop()[0] == tag

    def handle_data(self, data):
        tag = self.open[-1][0] if self.open else ""
        if tag != "style":
            self.words.append(data.strip())
        if tag in ("td", "th"):
            self.tables[-1][-1][-1] += data

    def table(self, *heading):
        """Return the rows of all tables with a heading."""
        return [row for table in self.tables if table[0] == list(heading) for row in table[1:]]

    def all(self, tag):
        return [attributes for name, attributes in self.elements if name == tag]
