"""Tracking Data Messages in XML, rewritten as lines of KVN and read by :mod:`radioloc.io.tdm.kvn`.

Source: CCSDS 503.0-B-2 (2020), chapter 5.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from xml.parsers import expat

import numpy as np

from radioloc.errors import FileFormatError
from radioloc.io.tdm.kvn import parse_kvn
from radioloc.io.tdm.message import TdmFile

_MARKERS = {"metadata": ("META_START", "META_STOP"), "data": ("DATA_START", "DATA_STOP")}
_BRANCHES = {"tdm", "header", "body", "segment", "observation", *_MARKERS}


def looks_like_xml(text: str) -> bool:
    """Return whether a text begins like XML and soon has the element of a Tracking Data Message."""
    start = text[:20_000].lstrip()
    return start.startswith("<") and re.search(r"<(?:[\w.-]+:)?tdm[\s>]", start) is not None


def parse_xml(path: str | Path, text: str) -> TdmFile:
    """Read a message from the text of an XML file; :class:`FileFormatError` names the line that is wrong."""
    lines = _Lines(path)
    try:
        lines.parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        problem = f"is not complete XML: {expat.ErrorString(error.code)}; fetch it again"
        raise FileFormatError(path, problem, error.lineno) from None
    return parse_kvn(path, lines.lines, np.array(lines.numbers, dtype=np.int32))


class _Lines:
    """Lines of KVN of the elements that the parser reports, with the numbers of their lines in the file."""

    def __init__(self, path: str | Path) -> None:
        self.path = path
        self.lines: list[str] = []
        self.numbers: list[int] = []
        self.parser = expat.ParserCreate(encoding="utf-8")
        self.parser.buffer_text = True
        self.parser.StartDoctypeDeclHandler = self._refuse_doctype
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._add_text
        self._text = self._epoch = ""
        self._number = 1

    def _fail(self, problem: str) -> FileFormatError:
        return FileFormatError(self.path, problem, self.parser.CurrentLineNumber)

    def _refuse_doctype(self, *_: object) -> None:
        raise self._fail("expected no document type in a TDM; remove the line <!DOCTYPE ...>")

    def _append(self, line: str) -> None:
        self.lines.append(line)
        self.numbers.append(self._number)

    def _start(self, prefixed: str, attributes: Mapping[str, str]) -> None:
        name, self._text = prefixed.rpartition(":")[2], ""
        if not self._epoch:
            self._number = self.parser.CurrentLineNumber
        if not self.lines:
            if name != "tdm":
                raise self._fail(f"expected the root element tdm, got {name}")
            self._append(f"CCSDS_TDM_VERS = {attributes.get('version', '')}")
        elif name in _MARKERS:
            self._append(_MARKERS[name][0])
        elif attributes:
            raise self._fail(f"{name}: expected an element without attributes, got {', '.join(attributes)}")

    def _add_text(self, text: str) -> None:
        self._text += text

    def _end(self, prefixed: str) -> None:
        name, text = prefixed.rpartition(":")[2], " ".join(self._text.split())
        self._text = ""
        if name in _BRANCHES:
            # Text between elements and an epoch without a value are not lines of KVN, which are refused.
            if text or self._epoch:
                self._append(text or self._epoch)
            self._epoch = ""
            if name in _MARKERS:
                self._append(_MARKERS[name][1])
        elif name == "EPOCH":
            self._epoch = text
        else:
            self._append(f"COMMENT {text}" if name == "COMMENT" else f"{name} = {self._epoch} {text}".strip())
            self._epoch = ""
