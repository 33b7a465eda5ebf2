"""Files of any known format, joined; what is not known is said to be so."""

import gzip

import pytest

from radioloc.earth import StationCatalogue
from radioloc.errors import DataQualityWarning, FileFormatError
from radioloc.io.formats import read_observations


def test_all_formats_together(crd_lines, mini_lines, table_lines, tmp_path):
    files = []
    for name, lines in {"c": crd_lines, "m": mini_lines, "t": table_lines[:3]}.items():
        file = tmp_path / name
        file.write_bytes(
            gzip.compress("\n".join(lines).encode()) if name == "c" else "\n".join(lines).encode()
        )
        files.append(file)
    files[2].write_text("\n".join([*table_lines[:3], ""]))
    # The table's only row is the first of the MINI file.
    with pytest.warns(DataQualityWarning, match=r"3:.*m.*1"):
        assert len(read_observations(files)) == 6
    read = read_observations(files[:2])
    assert len(read) == 6
    assert read.files == (str(files[0]), str(files[1]))
    assert read.origin(3) == f"{files[1]}, line 1"
    assert read.paths()[0] == "GRASSE>apollo15>GRASSE"
    assert len(read_observations(str(files[2]))) == 1
    assert read_observations(files[:2], catalogue=StationCatalogue([])).paths()[0] == "7845>apollo15>7845"


@pytest.mark.parametrize(
    "text", ["hello\n", "CCSDS_OEM_VERS = 2.0\n", "51\n", "H1 CPF 2\n", "# only a comment\n"]
)
def test_unknown_formats_list_the_known_ones(text, tmp_path):
    file = tmp_path / "a"
    file.write_text(text)
    with pytest.raises(FileFormatError, match=r"starts with .*CRD.*MINI.*table"):
        read_observations(file)
