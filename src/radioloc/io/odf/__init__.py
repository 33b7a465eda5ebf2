"""Orbit data files (ODF, TRK-2-18) of the Deep Space Network: Doppler, ranges and the transmitted frequencies."""

from radioloc.io.odf.observations import odf_observations, read_odf
from radioloc.io.odf.records import OdfFile, looks_like_odf, read_odf_file

__all__ = ["OdfFile", "looks_like_odf", "odf_observations", "read_odf", "read_odf_file"]
