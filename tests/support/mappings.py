"""Mapping functions of radio waves from their coefficients, and the continued fraction by elevation."""

import numpy as np

from radioloc.media import mapping_functions as radio


def niell(elevation_rad, latitude_rad, height_m, day_of_year):
    """Return the mapping factors of Niell (1996)."""
    return radio.mapping_factors(
        elevation_rad, height_m, *radio.niell_coefficients(latitude_rad, day_of_year)
    )


def vmf3(elevation_rad, hydrostatic_a, wet_a, latitude_rad, longitude_rad, day_of_year, mapping_height_m):
    """Return the mapping factors of VMF3 from its coefficients a."""
    b_h, b_w, c_h, c_w = radio.vmf3_bc(latitude_rad, longitude_rad, day_of_year)
    return radio.mapping_factors(
        elevation_rad, mapping_height_m, (hydrostatic_a, b_h, c_h), (wet_a, b_w, c_w)
    )


def continued_fraction(elevation_rad, a, b, c):
    """Return the fraction and its derivative."""
    return radio.continued_fraction(np.sin(elevation_rad), np.cos(elevation_rad), a, b, c)


def height_correction(elevation_rad, height_m):
    """Return the correction of the hydrostatic function and its derivative."""
    return radio.height_correction(np.sin(elevation_rad), np.cos(elevation_rad), height_m)
