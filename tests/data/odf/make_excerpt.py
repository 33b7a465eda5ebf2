"""Cut grail_b_2012-04-10.odf out of GRAIL's file of the day, with headers that count the records that are left.

PYTHONPATH=tests/support python tests/data/odf/make_excerpt.py grblugf2012_101_0350smmmv1.odf
"""

import sys
from pathlib import Path

from odf_files import odf, taken_apart

FIRST_S, LAST_S = 1965223858, 1965224058
orbit, ramps = taken_apart(Path(sys.argv[1]).read_bytes())
orbit = [one for one in orbit if one["receiver"] == 34 and FIRST_S <= one["time_s"] < LAST_S]
ramps = [
    one
    for one in ramps
    if one["station"] == 34 and one["stop_s"] > FIRST_S - 60 and one["start_s"] < LAST_S + 60
]
content = odf(orbit, ramps, label=(181, 1120410, 221935, 19500101, 0))
Path(__file__).with_name("grail_b_2012-04-10.odf").write_bytes(content)
