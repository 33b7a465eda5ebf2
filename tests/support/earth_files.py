"""Small files of Earth models: orientation, and the loading of its crust."""

from datetime import date, timedelta

C04 = """# a comment
2020   1   1   0  58849.00    0.076577    0.282336  -0.1771554    0.000101   -0.000108 0 0 0 0
2020   1   2   0  58850.00    0.075350    0.283000  -0.1775000    0.000110   -0.000110 0 0 0 0
"""


def finals_row(mjd, flags="III", x="0.076577", y="0.282336", ut1="-0.1771554", dx="0.101", dy="-0.108"):
    row = [" "] * 187

    def put(first, last, text):
        row[first - 1 : last] = list(f"{text:>{last - first + 1}}")

    day = date(1858, 11, 17) + timedelta(days=int(mjd))
    put(1, 6, f"{day.year % 100:2d}{day.month:2d}{day.day:2d}")
    put(8, 15, f"{mjd:.2f}")
    for column, flag in zip((17, 58, 96), flags, strict=True):
        put(column, column, flag)
    for (first, last), text in zip(
        ((19, 27), (38, 46), (59, 68), (98, 106), (117, 125)), (x, y, ut1, dx, dy), strict=True
    ):
        put(first, last, text)
    return "".join(row)


BLQ_ROWS = """\
  .00352 .00123 .00080 .00032 .00187 .00112 .00063 .00003 .00082 .00044 .00037
  .00144 .00035 .00035 .00008 .00053 .00049 .00018 .00009 .00012 .00005 .00006
  .00086 .00023 .00023 .00006 .00029 .00028 .00010 .00007 .00004 .00002 .00001
   -64.7  -52.0  -96.2  -55.2  -58.8 -151.4  -65.6 -138.1    8.4    5.2    2.1
    85.5  114.5   56.5  113.6   99.4   19.1   94.1  -10.4 -167.4 -170.0 -177.7
   109.5  147.0   92.7  148.8   50.5  -55.1   36.4 -170.4  -15.0    2.3    5.2
"""
BLQ_RECORD = "  ONSALA\n$$ CSR4.0_f_PP ID: 2009-06-25 17:43:24\n$$ Computed by OLMPP\n" + BLQ_ROWS
