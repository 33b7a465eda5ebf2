"""Small files of models of the atmosphere: maps of electron content (IONEX), VMF3 and GPT3."""

from collections.abc import Callable

import numpy as np

IONEX_LATITUDES = np.arange(87.5, -87.6, -2.5)
IONEX_LONGITUDES = np.arange(-180.0, 180.1, 5.0)
Field = Callable[[np.ndarray, np.ndarray, float], np.ndarray]


def labelled(content: str, label: str) -> str:
    return f"{content:<60}{label:<20}".rstrip()


def rows_of(value: np.ndarray) -> list[str]:
    fields = [f"{int(v):5d}" for v in value]
    return ["".join(fields[k : k + 16]) for k in range(0, len(fields), 16)]


def ionex_text(
    field: Field, day: int = 15, hours: tuple[float, ...] = (0, 2, 4, 6), exponent: int = -1, rms: bool = True
) -> str:
    """Return an IONEX 1.0 file of a field of latitude, longitude (degrees) and hour since 2019-01-15."""

    def epoch(hour: float) -> str:
        return f"{2019:6d}{1:6d}{day + int(hour) // 24:6d}{int(hour) % 24:6d}{0:6d}{0:6d}"

    lines = [
        labelled(f"{1.0:8.1f}{'':12}I{'':19}GPS", "IONEX VERSION / TYPE"),
        labelled("a test", "PGM / RUN BY / DATE"),
        labelled(epoch(hours[0]), "EPOCH OF FIRST MAP"),
        labelled(epoch(hours[-1]), "EPOCH OF LAST MAP"),
        labelled(f"{7200:6d}", "INTERVAL"),
        labelled(f"{len(hours):6d}", "# OF MAPS IN FILE"),
        labelled("  COSZ", "MAPPING FUNCTION"),
        labelled(f"{10.0:8.1f}", "ELEVATION CUTOFF"),
        labelled("", "OBSERVABLES USED"),
        labelled(f"{6371.0:8.1f}", "BASE RADIUS"),
        labelled(f"{2:6d}", "MAP DIMENSION"),
        labelled(f"  {450.0:6.1f}{450.0:6.1f}{0.0:6.1f}", "HGT1 / HGT2 / DHGT"),
        labelled(f"  {87.5:6.1f}{-87.5:6.1f}{-2.5:6.1f}", "LAT1 / LAT2 / DLAT"),
        labelled(f"  {-180.0:6.1f}{180.0:6.1f}{5.0:6.1f}", "LON1 / LON2 / DLON"),
        labelled(f"{exponent:6d}", "EXPONENT"),
        labelled("a comment", "COMMENT"),
        labelled("DIFFERENTIAL CODE BIASES", "START OF AUX DATA"),
        labelled("    01    -8.1     0.0", "PRN / BIAS / RMS"),
        labelled("DIFFERENTIAL CODE BIASES", "END OF AUX DATA"),
        labelled("", "END OF HEADER"),
    ]
    for kind in ("TEC", "RMS") if rms else ("TEC",):
        for number, hour in enumerate(hours, start=1):
            lines += [
                labelled(f"{number:6d}", f"START OF {kind} MAP"),
                labelled(epoch(hour), "EPOCH OF CURRENT MAP"),
            ]
            for latitude in IONEX_LATITUDES:
                lines.append(
                    labelled(
                        f"  {latitude:6.1f}{-180.0:6.1f}{180.0:6.1f}{5.0:6.1f}{450.0:6.1f}",
                        "LAT/LON1/LON2/DLON/H",
                    )
                )
                values = (
                    field(latitude, IONEX_LONGITUDES, hour + 24.0 * (day - 15))
                    if kind == "TEC"
                    else 0.0 * IONEX_LONGITUDES
                )
                lines += rows_of(np.round(values * 10.0**-exponent))
            lines.append(labelled(f"{number:6d}", f"END OF {kind} MAP"))
    return "\n".join([*lines, labelled("", "END OF FILE"), ""])


VMF3_SITES = """\
# name  mjd  ah  aw  zhd  zwd  p  T  e
GRAZ      60310.00  0.00120480  0.00058178  2.1686  0.1047   951.19   6.89   8.47
WETTZELL  60310.00  0.00120100  0.00057000  2.1500  0.0900   943.00   5.00   8.00
GRAZ      60310.25  0.00119426  0.00052434  2.1723  0.0706   953.07   3.26   6.49
GRAZ      60310.50  0.00119736  0.00043794  2.1776  0.0535   955.28   5.43   6.92
WETTZELL  60310.25  0.00120000  0.00055000  2.1520  0.0800   944.00   4.00   7.00
"""
"""Lines of GRAZ as published on the VMF data server for 2024-01-01."""

VMF3_LATITUDES = np.arange(87.5, -88.0, -5.0)
VMF3_LONGITUDES = np.arange(2.5, 360.0, 5.0)


def vmf3_map_text(hour: int, kind: str = "VMF3", shift: float = 0.0, tail: str = "") -> str:
    """Return a map with values linear in latitude and time, at one height along a parallel."""
    lines = [
        "! Version:            1.0",
        f"! Data_types:         {kind} (lat lon ah aw zhd zwd)",
        f"! Epoch:              2024 01 01 {hour:02d} 00  0.0",
        "! Scale_factor:       1.e+00",
        "! Range/resolution:   -87.5 87.5 2.5 357.5 5 5",
        "! Comment:            a test",
    ]
    for latitude in VMF3_LATITUDES:
        for longitude in VMF3_LONGITUDES:
            a_h = 1.2e-3 + 1e-6 * latitude + 1e-6 * hour
            wet = 0.1 + shift * np.cos(np.deg2rad(longitude))
            lines.append(f"{latitude:5.1f} {longitude:5.1f} {a_h:.8f} 0.00055000 2.2000 {wet:.6f}{tail}")
    return "\n".join(lines) + "\n"


def orography_text(height_m: float = 300.0) -> str:
    return f"{height_m:.2f}\n" * (len(VMF3_LATITUDES) * len(VMF3_LONGITUDES))


GPT3_CORNERS = """\
% lat lon p T Q dT undu Hs a_h a_w lambda Tm Gn_h Ge_h Gn_w Ge_w
  47.5   12.5  89942  -161 -172   56   16 281.0  -8.4 -3.1  0.1  0.1  5.13 -2.91 -1.20  0.34  0.34  -6.5   0.6 -0.2 \
 0.2 -0.1   47.30  1024.64  1.23150 -0.02207 -0.01128  0.00094  0.00117  0.52028 -0.00629 -0.01043  0.00399  0.00109 \
2.7298 -0.1177  0.0419 -0.0809  0.0315 270.2  -7.1 -3.1  0.2  0.1  -19.32  -2.57   0.36  -0.79  -0.44  -4.78  -3.43 \
 -1.22  -0.74  -1.67 -10.46   9.84   2.57  -1.57  -1.27  -0.75  -0.44   0.20   0.46   0.59
  47.5   17.5  99762   183  -97   41   -6 284.8 -10.5 -2.7 -0.3  0.1  6.21 -3.28 -1.34  0.41  0.22  -5.4   1.6 -0.0 \
 0.0  0.1   44.86   160.75  1.23260 -0.02330 -0.01094  0.00076  0.00085  0.55990 -0.00898 -0.00981  0.00444  0.00265 \
2.6067 -0.1332  0.0308 -0.0796 -0.0208 273.9  -7.8 -3.0  0.1 -0.1  -18.61  -3.39   0.19  -0.53  -0.20  -6.21  -1.92 \
 -2.05  -0.80  -2.00  -4.88   1.04   0.16   1.44   0.43  -1.97   2.79   0.96  -0.35  -0.80
  42.5   12.5  95267   -27 -113   37   -3 286.9  -8.0 -3.5  0.4  0.4  7.07 -2.46 -1.62  0.07  0.23  -5.6   0.7 -0.2 \
 0.4 -0.1   48.13   538.45  1.24106 -0.02108 -0.01120  0.00139  0.00170  0.53180 -0.01361 -0.00929  0.00104 -0.00214 \
3.3387  0.1132  0.0503 -0.0240  0.0831 275.9  -6.6 -3.4  0.5  0.5  -19.13  -0.67   0.41   0.05  -1.33  -3.34  -0.87 \
 -1.44  -1.20  -2.47   2.13  -5.54  -0.31   2.87   1.42   6.52  -6.08  -0.68   2.43   1.65
  42.5   17.5 100596   176  -52    9  -49 290.0  -7.6 -3.6  0.4  0.6  8.42 -3.57 -1.86  0.31  0.44  -6.1  -1.4  0.0 \
 0.2 -0.1   43.23    75.92  1.24073 -0.02182 -0.01135  0.00123  0.00143  0.55628 -0.01250 -0.00849  0.00018 -0.00217 \
3.3502 -0.2126 -0.0046 -0.0141  0.0751 278.1  -7.1 -3.4  0.5  0.4  -12.32  -1.84   0.40   0.03  -0.97  -5.56   0.93 \
 -0.88  -1.23  -2.34   6.63 -11.67  -0.46   3.29   1.77   5.45  -4.04  -0.49   1.18   0.30
"""
"""The four points of gpt3_5.grd (TU Wien) around Graz."""
