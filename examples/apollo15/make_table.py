"""Make the tables of light times that the examples start from, out of the files as they are published.

    python make_table.py DIRECTORY

DIRECTORY holds APOLLO's public release of 2006 to 2007 in the MINI layout (*.mini.np) and the ILRS's normal
points of spring 2024 in CRD (*.np2). The tables that ship beside this script, in ../reflectors/2006-2007 and
in ../reflectors/2024 were made so; it is kept to show where they come from, and needs no running.
"""

import sys
from pathlib import Path

from radioloc.io.formats import read_observations
from radioloc.io.table import read_table, write_table

EXAMPLES = Path(__file__).resolve().parent.parent
APOLLO = """\
Round-trip light times to {target}, {first} to {last}.
Source: Apache Point Observatory Lunar Laser-ranging Operation (APOLLO), public release, normal points of
station 70610 / 7045. Times of flight, uncertainties and weather as published; only the layout is other."""
ILRS = """\
Round-trip light times to {target}, {first} to {last}.
Source: International Laser Ranging Service, normal points (CRD version 2), by way of the EUROLAS Data Center.
Stations: {stations}.
Times of flight as published; uncertainty: RMS of the bin divided by the square root of its number of ranges;
weather interpolated between the records of the pass."""
STATIONS = {"APOLLO": "Apache Point (7045)", "GRASSE": "Grasse (7845)", "MATERA": "Matera (7941)"}


def write_by_target(observations, directory, name, source):
    """One table per target; answers how many rows they have together."""
    rows = 0
    for target in sorted({link.target for link in observations.links}):
        chosen = observations.select([observations.links[i].target == target for i in observations.link])
        days = sorted(chosen.epoch.day_strings().tolist())
        stations = sorted({link.receiver for link in (chosen.links[i] for i in chosen.link)})
        text = source.format(
            target=target,
            first=days[0],
            last=days[-1],
            stations=", ".join(STATIONS[station] for station in stations),
        )
        shared = (target, name) != ("apollo15", "apollo_2006-2007")
        folder = EXAMPLES / (directory if shared else "apollo15")
        folder.mkdir(exist_ok=True)
        file = folder / f"{target}_{name}.csv"
        write_table(file, chosen, light_time=True, comments=[text])
        again = read_table(file)
        assert (again.value_m == chosen.value_m).all()
        assert (again.epoch.fraction == chosen.epoch.fraction).all()
        rows += len(again)
    return rows


def main(source):
    early = read_observations(sorted(source.glob("*.mini.np")))
    late = read_observations(sorted(source.glob("*.np2")))
    assert write_by_target(early, "reflectors/2006-2007", "apollo_2006-2007", APOLLO) == len(early)
    assert write_by_target(late, "reflectors/2024", "2024", ILRS) == len(late)
    print(f"{len(early)} + {len(late)} light times written")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
