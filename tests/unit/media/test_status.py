import numpy as np

from radioloc.media.medium import Status, describe


def codes(*rows):
    return np.array(rows, dtype=np.int8)


def test_text_of_the_first_failed_end():
    status = codes(
        [0, 0], [Status.BELOW_HORIZON, Status.TOO_LOW], [0, Status.BELOW_HORIZON], [0, Status.BEHIND_MOON]
    )
    # The sign remains just below the horizon.
    elevation_rad = np.radians([[5.0, 6.0], [-0.01, 1.0], [40.0, -12.04], [3.0, 4.0]])
    ends = np.array([[0, 1], [0, 1], [1, 0], [0, 1]], dtype=np.int32)
    code, text = describe(status, elevation_rad, ("HERE", "THERE"), ends)
    assert code.tolist() == [0, Status.BELOW_HORIZON, Status.BELOW_HORIZON, Status.BEHIND_MOON]
    assert text.tolist() == [
        "",
        "below the horizon (-0.0 deg)",
        "below the horizon (-12.0 deg)",
        "behind the Moon as seen from THERE",
    ]
