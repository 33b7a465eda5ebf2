"""CCSDS Tracking Data Messages (TDM) 1.0 and 2.0: files in KVN and XML to observations and back.

A :class:`TdmAgreement` has what a message leaves open: sigmas, the length of a range unit, whether a range is the round
trip or half of it. ccsds-ndm reads the same messages, but takes ten minutes for a million KVN records where this module
takes two seconds; it serves the tests.

Source: Tracking Data Message, Recommended Standard CCSDS 503.0-B-2, June 2020.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from radioloc.earth.stations import StationCatalogue
from radioloc.errors import FileFormatError
from radioloc.io.tdm.agreement import TdmAgreement
from radioloc.io.tdm.kvn import looks_like_kvn, looks_like_xml, parse_kvn, parse_xml
from radioloc.io.tdm.meaning import TdmReadout, tdm_observations
from radioloc.io.tdm.message import TdmFile
from radioloc.io.tdm.write import write_tdm
from radioloc.measurements.observations import Observations
from radioloc.text_files import read_head, read_lines, read_text

__all__ = [
    "TdmAgreement",
    "TdmFile",
    "TdmReadout",
    "read_tdm",
    "read_tdm_file",
    "tdm_observations",
    "write_tdm",
]
_START_BYTES = 20_000  # that contain the first line


def looks_like_tdm(lines: Sequence[str]) -> bool:
    """Return whether the first lines are those of a message, KVN or XML."""
    return looks_like_kvn(lines) or looks_like_xml("\n".join(lines[:200]))


def read_tdm_file(path: str | Path) -> TdmFile:
    """Read the content of a message, KVN or XML, plain or gzip, as its records.

    Raises
    ------
    FileFormatError
        The file is not a message, was cut, or violates the standard. Has the line.
    """
    start = read_head(path, _START_BYTES).decode(errors="replace")
    if looks_like_xml(start):
        return parse_xml(path, read_text(path))
    if looks_like_kvn(start.splitlines()):
        return parse_kvn(path, read_lines(path))
    first = next(line for line in read_lines(path) if line.strip())
    raise FileFormatError(path, f"expected CCSDS_TDM_VERS = 2.0, or XML with <tdm>, got {first[:40]!r}", 1)


def read_tdm(
    paths: str | Path | Sequence[str | Path],
    agreement: TdmAgreement,
    *,
    catalogue: StationCatalogue | None = None,
) -> Observations:
    """Read one or more messages, each KVN or XML, plain or gzip, as observations.

    Parameters
    ----------
    paths : path-like or sequence of path-like
        Files; transmitted frequencies, clocks and weather in one hold for the measurements of all.
    agreement, catalogue
        Parameters of :func:`tdm_observations`, which also returns the ignored records and the corrections that are
        logged here. Errors and warnings are the same.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import radioloc
    >>> from radioloc.io import TdmAgreement, read_tdm, write_tdm
    >>> path = pathlib.Path(tempfile.mkdtemp(), "ranges.tdm")
    >>> ranges = radioloc.read_observations("examples/change5/short_arc.csv")
    >>> write_tdm(path, ranges[:10], originator="MY AGENCY")
    >>> read_tdm(path, TdmAgreement(sigma_m={"range": 2.5}))
    <Observations 10 2020-12-01 to 2020-12-01>
    """
    files = [paths] if isinstance(paths, (str, Path)) else paths
    messages = [read_tdm_file(file) for file in files]
    return tdm_observations(messages, agreement, catalogue=catalogue).observations
