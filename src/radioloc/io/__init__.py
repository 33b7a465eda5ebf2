"""Observations in and out: tables, ramps, laser normal points (CRD, MINI), Tracking Data Messages, orbit data files."""

from radioloc.io.crd import read_crd
from radioloc.io.detect import READERS, Reader, ReadSettings, read_observations
from radioloc.io.mini import read_mini
from radioloc.io.parquet import read_parquet, write_parquet
from radioloc.io.ramp_table import read_ramps, write_ramps
from radioloc.io.table import read_table, write_table
from radioloc.io.tdm import TdmAgreement, read_tdm, write_tdm
from radioloc.io.write import write_observations

__all__ = [
    "READERS",
    "ReadSettings",
    "Reader",
    "TdmAgreement",
    "read_crd",
    "read_mini",
    "read_observations",
    "read_parquet",
    "read_ramps",
    "read_table",
    "read_tdm",
    "write_observations",
    "write_parquet",
    "write_ramps",
    "write_table",
    "write_tdm",
]
