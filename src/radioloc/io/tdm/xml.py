"""Tracking Data Messages in XML, rewritten as lines of KVN and read by :mod:`radioloc.io.tdm.kvn`.

An XML parser makes sure that the file is whole. It refuses a document type and with it all entities of a file's own.

Source: CCSDS 503.0-B-2 (2020), chapter 5.
"""

from __future__ import annotations

import re
from html import unescape
from pathlib import Path
from xml.parsers import expat

import numpy as np

from radioloc.errors import FileFormatError
from radioloc.io.tdm.kvn import parse_kvn
from radioloc.io.tdm.message import TdmFile

# Line ends of the file only count its lines: they become white space at the ends of the lines of KVN.
_LINE_END = "\t"
_MARKS = {
    "<metadata>": "META_START",
    "</metadata>": "META_STOP",
    "<data>": "DATA_START",
    "</data>": "DATA_STOP",
}
_BRANCH = re.compile(r"</?(?:metadata|data|tdm|header|body|segment)>")
_COMMENT = re.compile(r"<!--.*?-->|<\?.*?\?>", re.DOTALL)
_ROOT = re.compile(r"<(?P<prefix>[\w.-]+:)?tdm\b(?:[^<>]*?\bversion\s*=\s*[\"']([^<>\"']*)[\"'])?[^<>]*>")
_LEAF = re.compile(r"<(?!(?:metadata|data|tdm|header|body|segment)\b)(\w+)(?:/>|>([^<]*)</\1>)")
_LEAF_COMMENT = re.compile(r"<(COMMENT)(?:/>|>([^<]*)</COMMENT>)")
_RECORD = r"^(?P<epoch>VALUE+)\s+<(?P<keyword>\w+)>\s*(?P<value>VALUE*)\s*</\w+>$".replace(
    "VALUE", "[!-%'-;=?-~]"
)


def looks_like_xml(text: str) -> bool:
    """Whether a text begins like XML and soon has the element of a Tracking Data Message."""
    start = text[:20_000].lstrip()
    return start.startswith("<") and re.search(r"<(?:[\w.-]+:)?tdm[\s>]", start) is not None


def parse_xml(path: str | Path, text: str) -> TdmFile:
    """Read a message from the text of an XML file; :class:`FileFormatError` names the line that is wrong."""
    _require_whole(path, text)
    lines = _lines_of(text)
    breaks = np.frombuffer(lines.encode(), dtype=np.uint8)
    numbers = 1 + np.cumsum(breaks == ord(_LINE_END), dtype=np.int32)[breaks == ord("\n")]
    return parse_kvn(path, lines.split("\n"), np.concatenate([[1], numbers]), _RECORD)


def _require_whole(path: str | Path, text: str) -> None:
    def refuse_doctype(*_: object) -> None:
        problem = "a document type is not part of a TDM; remove the line <!DOCTYPE ...>"
        raise FileFormatError(path, problem, parser.CurrentLineNumber)

    parser = expat.ParserCreate(encoding="utf-8")
    parser.StartDoctypeDeclHandler = refuse_doctype
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        problem = f"is not whole XML: {expat.ErrorString(error.code)}; fetch it again"
        raise FileFormatError(path, problem, error.lineno) from None


def _lines_of(text: str) -> str:
    """Rewrite elements as lines of KVN, records as EPOCH <KEYWORD>VALUE</KEYWORD>; other elements stay."""

    def assignment(match: re.Match[str]) -> str:
        keyword, value = match[1], unescape(match[2] or "")
        equals = "" if keyword == "COMMENT" else "= "
        return f"\n{keyword} {equals}{' '.join(value.split())}\n{_LINE_END * value.count(_LINE_END)}"

    def of_branch(text: str) -> str:
        return _BRANCH.sub(lambda match: f"\n{_MARKS.get(match[0], '')}\n", _LEAF.sub(assignment, text))

    text = text.replace(_LINE_END, " ").replace("\n", _LINE_END)
    if "<!" in text or text.count("<?") > 1:
        text = _COMMENT.sub(lambda match: _LINE_END * match[0].count(_LINE_END), text)
    if (root := _ROOT.search(text)) is None:
        return text
    text = f"\nCCSDS_TDM_VERS = {root[2] or ''}\n{_LINE_END * text.count(_LINE_END, 0, root.end())}{text[root.end() :]}"
    if prefix := root["prefix"]:
        text = text.replace(f"<{prefix}", "<").replace(f"</{prefix}", "</")
    branch, *sections = text.split("<data>")
    lines = [of_branch(branch)]
    for section in sections:
        data, end, branch = section.partition("</data>")
        data = data.replace("<observation>", "").replace("</observation>", "")
        data = data.replace("<EPOCH>", "\n").replace("</EPOCH>", " ")
        data = _LEAF_COMMENT.sub(assignment, data) if "<COMMENT" in data else data
        lines += ["\nDATA_START\n", data, of_branch(end + branch)]
    return "".join(lines)
