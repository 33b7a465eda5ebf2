"""Observations in and out (tables, normal points, messages, orbit data files, frequencies); solutions out."""

from typing import TYPE_CHECKING

from radioloc.lazy import lazy_exports as _lazy_exports

if TYPE_CHECKING:  # imported on first use
    from radioloc.io.exporters import EXPORTERS, Exporter, ExportOptions, export_solutions
    from radioloc.io.formats import READERS, Reader, ReadSettings, read_observations, write_observations
    from radioloc.io.frequencies import FrequencyAgreement, read_sites
    from radioloc.io.gis import write_gis
    from radioloc.io.orekit import from_orekit, to_orekit
    from radioloc.io.spice_kernels import write_spice
    from radioloc.io.table import read_table, write_table
    from radioloc.io.tdm import TdmAgreement, read_tdm, write_tdm

__all__ = [
    "EXPORTERS",
    "READERS",
    "ExportOptions",
    "Exporter",
    "FrequencyAgreement",
    "ReadSettings",
    "Reader",
    "TdmAgreement",
    "export_solutions",
    "from_orekit",
    "read_observations",
    "read_sites",
    "read_table",
    "read_tdm",
    "to_orekit",
    "write_gis",
    "write_observations",
    "write_spice",
    "write_table",
    "write_tdm",
]

__getattr__, __dir__ = _lazy_exports(
    __name__,
    {
        "exporters": "EXPORTERS Exporter ExportOptions export_solutions",
        "formats": "READERS Reader ReadSettings read_observations write_observations",
        "frequencies": "FrequencyAgreement read_sites",
        "gis": "write_gis",
        "orekit": "from_orekit to_orekit",
        "spice_kernels": "write_spice",
        "table": "read_table write_table",
        "tdm": "TdmAgreement read_tdm write_tdm",
    },
)
