"""Observations in and out: tables, ramps, laser normal points, messages, orbit data files, received frequencies."""

from radioloc.io.crd import read_crd
from radioloc.io.formats import READERS, Reader, ReadSettings, read_observations, write_observations
from radioloc.io.frequencies import FrequencyAgreement, read_fdets, read_sites, read_strf
from radioloc.io.mini import read_mini
from radioloc.io.odf import read_odf
from radioloc.io.table import read_parquet, read_ramps, read_table, write_parquet, write_ramps, write_table
from radioloc.io.tdm import TdmAgreement, read_tdm, write_tdm

__all__ = [
    "READERS",
    "FrequencyAgreement",
    "ReadSettings",
    "Reader",
    "TdmAgreement",
    "read_crd",
    "read_fdets",
    "read_mini",
    "read_observations",
    "read_odf",
    "read_parquet",
    "read_ramps",
    "read_sites",
    "read_strf",
    "read_table",
    "read_tdm",
    "write_observations",
    "write_parquet",
    "write_ramps",
    "write_table",
    "write_tdm",
]
