"""A million records must become observations in less than five seconds; run with ``pytest --benchmark-only``."""

import pytest
from tdm_messages import TWO_WAY, kvn, xml

from radioloc.earth.stations import StationCatalogue
from radioloc.io.tdm import TdmAgreement, read_tdm

RECORDS = 1_000_000
LONGEST_S = 5.0


def records():
    for i in range(RECORDS):
        minutes, second = divmod(i, 60)
        hours, minute = divmod(minutes, 60)
        day, hour = divmod(hours, 24)
        yield f"RANGE = 2021-03-{day + 1:02d}T{hour:02d}:{minute:02d}:{second:02d}.000 {768800.1 + i * 1e-3:.9f}"


@pytest.mark.parametrize(("suffix", "text"), [("kvn", lambda segment: "\n".join(kvn(segment))), ("xml", xml)])
def test_reading_a_million_records(benchmark, suffix, text, tmp_path):
    path = tmp_path / f"a.{suffix}"
    path.write_text(text((TWO_WAY, list(records()))))
    agreement = TdmAgreement(sigma_m={"range": 1.0})
    read = benchmark.pedantic(
        read_tdm, args=(path, agreement), kwargs={"catalogue": StationCatalogue.default()}, rounds=3
    )
    assert len(read) == RECORDS
    assert benchmark.stats.stats.min < LONGEST_S
