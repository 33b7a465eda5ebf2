"""Small Tracking Data Messages from metadata and records."""

import numpy as np

from radioloc.constants import C_M_S
from radioloc.time import epochs_from_strings, utc_to_tai

TWO_WAY = {
    "TIME_SYSTEM": "UTC",
    "PARTICIPANT_1": "KASHI",
    "PARTICIPANT_2": "lander",
    "MODE": "SEQUENTIAL",
    "PATH": "1,2,1",
}
THREE_WAY = TWO_WAY | {"PARTICIPANT_3": "JIAMUSI", "PATH": "1,2,3"}
DELAY = {
    "TIME_SYSTEM": "UTC",
    "PARTICIPANT_1": "lander",
    "PARTICIPANT_2": "SESHAN25",
    "PARTICIPANT_3": "KUNMING",
    "MODE": "SINGLE_DIFF",
    "PATH_1": "1,2",
    "PATH_2": "1,3",
}
HEADER = {"CCSDS_TDM_VERS": "2.0", "CREATION_DATE": "2021-03-29T00:00:00", "ORIGINATOR": "TEST"}
RANGES = ["RANGE = 2021-03-28T14:00:00.250 768800.1234567", "RANGE = 2021-03-28T14:01:00 768801.5"]


def growth_m(observations, start, sent_from_s, sent_to_s):
    """Return the growth of paths from cycles of a ramped uplink sent between two times, in s since a date (UTC)."""
    [name] = {observations.links[k].transmitter for k in observations.link}
    frequency, f0_hz = observations.ramps.of_station(name), observations.uplink_hz
    since_s = utc_to_tai(epochs_from_strings(start, "UTC")).seconds_since(frequency.origin)
    ends = [
        frequency.frequency_and_cycles(np.asarray(t) + since_s, since_s, f0_hz)[1]
        for t in (sent_from_s, sent_to_s)
    ]
    return observations.value_m + C_M_S / f0_hz * (ends[1] - ends[0])


def lines_of(fields):
    """Return lines keyword = value, without fields of None."""
    return [f"{keyword} = {value}" for keyword, value in fields.items() if value is not None]


def kvn(*segments, header=None):
    """Return KVN lines of a message of segments, each a pair of metadata and record lines."""
    lines = lines_of(HEADER | (header or {}))
    for metadata, records in segments:
        lines += ["META_START", *lines_of(metadata), "META_STOP", "DATA_START", *records, "DATA_STOP"]
    return lines


def xml(*segments, prefix="", newline="\n"):
    """Return the XML text of the same message."""

    def element(name, content):
        return f"<{prefix}{name}>{content}</{prefix}{name}>"

    body = []
    for metadata, records in segments:
        fields = newline.join(element(k, v) for k, v in metadata.items() if v is not None)
        observations = []
        for record in records:
            keyword, _, fields_text = record.partition("=")
            epoch, value = fields_text.split()
            content = f"{newline}{element('EPOCH', epoch)}{newline}{element(keyword.strip(), value)}{newline}"
            observations.append(element("observation", content))
        data = element("data", newline + newline.join(observations) + newline)
        body.append(
            element("segment", newline + element("metadata", newline + fields + newline) + newline + data)
        )
    names = {k: v for k, v in HEADER.items() if k != "CCSDS_TDM_VERS"}
    header = element("header", "".join(element(k, v) for k, v in names.items()))
    space = ' xmlns:ndm="urn:ccsds:schema:ndmxml"' if prefix else ""
    start = f'<?xml version="1.0" encoding="UTF-8"?>{newline}<{prefix}tdm{space} id="CCSDS_TDM_VERS" version="2.0">'
    return f"{start}{newline}{header}{newline}{element('body', newline.join(body))}{newline}</{prefix}tdm>{newline}"
