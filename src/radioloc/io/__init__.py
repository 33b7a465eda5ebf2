"""Observations in and out: tables (CSV, Parquet), laser normal points (CRD, MINI), Tracking Data Messages (TDM)."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from radioloc.io.crd import read_crd
from radioloc.io.detect import READERS, Reader, ReadSettings, read_observations
from radioloc.io.mini import read_mini
from radioloc.io.tdm import TdmAgreement, read_tdm, write_tdm
from radioloc.io.write import write_observations

if TYPE_CHECKING:
    from radioloc.io.parquet import read_parquet, write_parquet
    from radioloc.io.table import read_table, write_table

__all__ = [
    "READERS",
    "ReadSettings",
    "Reader",
    "TdmAgreement",
    "read_crd",
    "read_mini",
    "read_observations",
    "read_parquet",
    "read_table",
    "read_tdm",
    "write_observations",
    "write_parquet",
    "write_table",
    "write_tdm",
]


def __getattr__(name: str) -> Any:
    """Tables are imported when used: Arrow takes a fifth of a second."""
    if name not in ("read_parquet", "read_table", "write_parquet", "write_table"):
        raise AttributeError(f"module 'radioloc.io' has no attribute {name!r}")
    return getattr(import_module(f"radioloc.io.{name.partition('_')[2]}"), name)
