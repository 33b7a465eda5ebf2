"""Grey images as files: values that increase with brightness, and conversion to eight bits."""

from __future__ import annotations

from contextlib import ExitStack
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError
from radioloc.lunar.map_files import open_dataset
from radioloc.vectors import Mask

Image = NDArray[np.uint8]

_GDAL_TYPES = {
    "uint8": "Byte", "int8": "Int8", "uint16": "UInt16", "int16": "Int16", "uint32": "UInt32", "int32": "Int32",
    "float32": "Float32", "float64": "Float64",
}  # fmt: skip
_STRETCHED_PERCENTILES = (0.1, 99.9)  # beyond them are glints, dead pixels and shadows


def open_grey(path: Path, *, overview: int | None = None, first_column: int = 0) -> Any:
    """Open an image by rasterio with values that increase with brightness; a global map may begin at any column."""
    # A virtual dataset of GDAL applies bit depth, MINISWHITE and palette, whose colours become luma (ITU-R BT.601).
    options = {} if overview is None else {"overview_level": overview}
    with ExitStack() as closing:
        dataset = closing.enter_context(open_dataset(path, **options))
        source = _as_shown(path, dataset)
        if source == _Source() and not first_column:
            closing.pop_all()
            return dataset
        kind, change, nodata = source.kind or dataset.dtypes[0], source.change, source.nodata
        if source.kind is None:
            nodata = dataset.nodata
        file = f'<SourceFilename relativeToVRT="0">{escape(str(path.resolve()))}</SourceFilename>'
        if overview is not None:
            file += f'<OpenOptions><OOI key="OVERVIEW_LEVEL">{overview}</OOI></OpenOptions>'
        width, height = dataset.width, dataset.height

        def sources(element: str, band: str, change: str = "") -> str:
            parts = ((first_column, width, 0), (0, first_column, width - first_column))
            return "".join(
                f"<{element}>{file}<SourceBand>{band}</SourceBand>"
                f'<SrcRect xOff="{first}" yOff="0" xSize="{last - first}" ySize="{height}"/>'
                f'<DstRect xOff="{at}" yOff="0" xSize="{last - first}" ySize="{height}"/>{change}</{element}>'
                for first, last, at in parts
                if last > first
            )

        georeference = "" if dataset.crs is None else f"<SRS>{escape(dataset.crs.to_wkt())}</SRS>"
        numbers = ",".join(map(repr, dataset.transform.to_gdal()))
        content = f"<ColorInterp>Gray</ColorInterp>{sources('ComplexSource', '1', change)}"
        if nodata is not None:
            content = f"<NoDataValue>{nodata!r}</NoDataValue>{content}"
        band = f'<VRTRasterBand dataType="{_GDAL_TYPES[kind]}" band="1">{content}</VRTRasterBand>'
        if "per_dataset" in {flag.name for flag in dataset.mask_flag_enums[0]}:
            mask = f'<VRTRasterBand dataType="Byte">{sources("SimpleSource", "mask,1")}</VRTRasterBand>'
            band += f"<MaskBand>{mask}</MaskBand>"
    size = f'rasterXSize="{width}" rasterYSize="{height}"'
    return open_dataset(
        f"<VRTDataset {size}>{georeference}<GeoTransform>{numbers}</GeoTransform>{band}</VRTDataset>"
    )


class _Source(NamedTuple):
    """Conversion from values of a file to grey values; by default none."""

    kind: str | None = None
    change: str = ""  # of GDAL's ComplexSource
    nodata: float | None = None


def _as_shown(path: Path, dataset: Any) -> _Source:
    """Return the change of values by which viewers show an image of one band."""
    kind = np.dtype(dataset.dtypes[0])
    white_is_0 = dataset.tags(ns="IMAGE_STRUCTURE").get("MINISWHITE") == "YES"
    bits = int(dataset.tags(1, ns="IMAGE_STRUCTURE").get("NBITS", 8 * kind.itemsize))
    palette = dataset.colorinterp[0].name == "palette"
    narrow = kind.kind == "u" and bits < 8 * kind.itemsize
    if dataset.count != 1 or not (palette or white_is_0 or narrow):
        return _Source()
    if kind.kind != "u":
        raise FileFormatError(
            path, f"expected unsigned integers for a palette or MINISWHITE, got {kind}; convert the image"
        )
    nodata, full = dataset.nodata, int(np.iinfo(kind).max)
    if palette:
        table = dataset.colormap(1)
        grey = {key: round((299 * r + 587 * g + 114 * b) / 1000) for key, (r, g, b, _) in table.items()}
        void = {key for key, colour in table.items() if colour[3] == 0 or key == nodata}
        if void:  # 0 is kept for them
            grey = {key: 0 if key in void else max(1, value) for key, value in grey.items()}
        table_text = ",".join(f"{key}:{value}" for key, value in grey.items())
        return _Source("uint8", f"<LUT>{table_text}</LUT>", 0 if void else None)
    ratio, offset = full / (2**bits - 1) * (-1.0 if white_is_0 else 1.0), full * white_is_0
    change = f"<ScaleOffset>{offset}</ScaleOffset><ScaleRatio>{ratio!r}</ScaleRatio>"
    if nodata is None:
        return _Source(kind.name, change)
    return _Source(kind.name, f"{change}<NODATA>{nodata!r}</NODATA>", round(ratio * nodata + offset))


def eight_bit(values: Any) -> tuple[Image, Mask]:
    """Return a masked array as eight bits, black where it is masked, and the mask of its valid values."""
    valid = ~np.ma.getmaskarray(values)
    numbers = np.ma.getdata(values)
    if numbers.dtype == np.uint8:
        return np.where(valid, numbers, np.uint8(0)), valid
    valid &= np.isfinite(numbers)
    if not valid.any():
        return np.zeros(numbers.shape, np.uint8), valid
    low, high = np.percentile(numbers[valid], _STRETCHED_PERCENTILES)
    scale = 255.0 / (high - low) if high > low else 0.0
    grey = np.clip((np.where(valid, numbers, low) - low) * scale, 0.0, 255.0)
    return np.rint(grey).astype(np.uint8), valid
