"""Compiled accelerations of a spacecraft about the Moon, and the right-hand side of its variational equations.

Positions are relative to the Moon's centre, ICRF axes, m; times are seconds of TDB from the arc's epoch.
"""

import math

import numpy as np
from numpy.typing import NDArray

from radioloc.compiled import compiled
from radioloc.constants import C_M_S, MEAN_LUNAR_RADIUS_M
from radioloc.dynamics import _force_data as layout
from radioloc.dynamics._force_data import ForceData
from radioloc.dynamics._harmonic_kernels import harmonic_sums
from radioloc.dynamics._vector_kernels import add, cross, dot, minus, times, unit
from radioloc.vectors import Floats

SUN_RADIUS_M = 6.957e8  # IAU 2015 resolution B3, as the Sun's irradiance below
EARTH_RADIUS_M = 6378136.6  # IERS Conventions 2010, table 1.1
SUNLIGHT_N_M2 = 1361.0 / C_M_S
"""Pressure of sunlight on a black surface at one astronomical unit, N/m^2."""
AU_M = 149597870700.0  # IAU 2012 resolution B2
EARTH_J2 = 1.0826359e-3  # IERS Conventions 2010, table 1.1; to the radius above

RING_COUNT = 3
"""Rings of directions in which moonlight is sampled: 1, 6 and 12."""
TERMINATOR_SINE = 0.03
"""Sine of the Sun's height in which day becomes night on the ground; a corner would disturb the step size."""


@compiled()
def quantities(t: float, data: ForceData) -> Floats:
    """Return the quantities of the table at a time, by Clenshaw's recurrence."""
    place = (t - data.start_s) / data.length_s
    segment = min(max(int(place), 0), data.table.shape[0] - 1)
    double_x = 4.0 * (place - segment) - 2.0
    series = data.table[segment]
    out = np.empty(series.shape[0])
    for q in range(series.shape[0]):
        b, previous = 0.0, 0.0
        for k in range(series.shape[1] - 1, 0, -1):
            b, previous = series[q, k] + (double_x * b - previous), b
        out[q] = series[q, 0] + (0.5 * double_x * b - previous)
    return out


@compiled()
def _harmonics(r: Floats, rotation: Floats, data: ForceData) -> Floats:
    """Return the acceleration by the harmonics without the central term, for a GM of 1."""
    p = times(rotation, r)
    sums = harmonic_sums(p[0], p[1], p[2], data.radius_m, data.series, data.recursion)
    out = np.zeros(3)
    for i in range(3):
        add(out, sums[i] / data.radius_m**2, rotation[i])
    return out


@compiled()
def _tensor(sky: Floats, gm: Floats, permanent: Floats) -> Floats:
    """Return the tide-raising tensor of Earth and Sun, sum of GM u u / R^3, less that of the field, ICRF axes."""
    out = np.zeros((3, 3))
    if permanent[0, 0] != 0.0:
        rotation = sky[layout.ROTATION : layout.ROTATION + 9].reshape((3, 3))
        out -= rotation.T @ (permanent @ rotation)
    for body in range(1, 3):
        place = sky[3 * body - 3 : 3 * body]
        square = dot(place, place)
        factor = gm[body] / (square * square * math.sqrt(square))
        for i in range(3):
            for j in range(3):
                out[i, j] += factor * place[i] * place[j]
    return out


@compiled()
def _tides(r: Floats, tensor: Floats, radius_m: float) -> Floats:
    """Return the acceleration by the tidal bulge for k2 = 1: gradient of R^5 (3 r.S r - tr S r^2) / (2 r^5)."""
    square = dot(r, r)
    trace = tensor[0, 0] + tensor[1, 1] + tensor[2, 2]
    pulled = times(tensor, r)
    invariant = 3.0 * dot(r, pulled) - trace * square
    factor = 0.5 * radius_m**5 / (square * square * math.sqrt(square))
    out = np.empty(3)
    for i in range(3):
        out[i] = factor * (6.0 * pulled[i] - 2.0 * trace * r[i] - 5.0 * invariant / square * r[i])
    return out


@compiled()
def _oblate(r: Floats, gm: float) -> Floats:
    """Return the acceleration by the Earth's J2 at a geocentric position; its axis is the z axis of the ICRF."""
    square = dot(r, r)
    sine2 = r[2] * r[2] / square
    factor = -1.5 * EARTH_J2 * gm * EARTH_RADIUS_M**2 / (square * square * math.sqrt(square))
    out = np.zeros(3)
    add(out, factor * (1.0 - 5.0 * sine2), r)
    out[2] += 2.0 * factor * r[2]
    return out


@compiled()
def _post_newtonian(r: Floats, v: Floats, first: int, places: Floats, speeds: Floats, gm: Floats) -> Floats:
    """Return the post-Newtonian acceleration by Moon, Earth and Sun from index `first` on (Moyer 2003, eq. 4-26)."""
    # Neglected: accelerations of the bodies, below 1e-12 m/s^2; planets, which change the Moon's GM by 1e-11.
    out = np.zeros(3)
    potential = 0.0
    for j in range(first, 3):
        to = minus(places[j], r)
        potential += gm[j] / math.sqrt(dot(to, to))
    for j in range(first, 3):
        to, speed = minus(places[j], r), speeds[j]
        square = dot(to, to)
        distance = math.sqrt(square)
        bracket = -4.0 * potential + dot(v, v) + 2.0 * dot(speed, speed) - 4.0 * dot(v, speed)
        bracket -= 1.5 * dot(to, speed) ** 2 / square
        for k in range(3):
            if k != j:
                separation = minus(places[k], places[j])
                bracket -= gm[k] / math.sqrt(dot(separation, separation))
        factor = gm[j] / (C_M_S**2 * square * distance)
        projection = 0.0
        for i in range(3):
            projection -= to[i] * (4.0 * v[i] - 3.0 * speed[i])
        for i in range(3):
            out[i] += factor * (bracket * to[i] + projection * (v[i] - speed[i]))
    return out


@compiled()
def sunlit(r: Floats, sun: Floats, body: Floats, radius_m: float) -> float:
    """Return the visible fraction of the Sun's disk behind a sphere (Montenbruck and Gill 2000, section 3.4.2)."""
    to_sun, to_body = minus(sun, r), minus(body, r)
    sun_m, body_m = math.sqrt(dot(to_sun, to_sun)), math.sqrt(dot(to_body, to_body))
    if body_m >= sun_m or body_m <= radius_m:
        return 1.0
    a, b = math.asin(SUN_RADIUS_M / sun_m), math.asin(radius_m / body_m)
    c = math.acos(min(1.0, max(-1.0, dot(to_sun, to_body) / (sun_m * body_m))))
    if c >= a + b:
        return 1.0
    if c <= b - a:
        return 0.0
    if c <= a - b:
        return 1.0 - b * b / (a * a)
    x = (c * c + a * a - b * b) / (2.0 * c)
    y = math.sqrt(max(0.0, a * a - x * x))
    covered = a * a * math.acos(x / a) + b * b * math.acos((c - x) / b) - c * y
    return 1.0 - covered / (math.pi * a * a)


@compiled()
def _sunlight(r: Floats, sun: Floats, earth: Floats) -> Floats:
    """Return the acceleration by sunlight for a radiation coefficient of 1 m^2/kg."""
    from_sun = minus(r, sun)
    square = dot(from_sun, from_sun)
    visible = sunlit(r, sun, np.zeros(3), MEAN_LUNAR_RADIUS_M) * sunlit(r, sun, earth, EARTH_RADIUS_M)
    out = np.zeros(3)
    add(out, SUNLIGHT_N_M2 * visible * AU_M**2 / (square * math.sqrt(square)), from_sun)
    return out


@compiled()
def _moonlight(r: Floats, sun: Floats) -> Floats:
    """Return the acceleration by light and heat from the Moon, for a radiation coefficient of 1 m^2/kg."""
    # The ground returns all sunlight, reflected or as heat, at once and evenly (Lambert). The radiance is summed over
    # directions of equal solid angle, a middle and rings (Knocke et al. 1988, AIAA 88-4292).
    distance = math.sqrt(dot(r, r))
    sun_m = math.sqrt(dot(sun, sun))
    up, to_sun = unit(r), unit(sun)
    # Directions are symmetric about the plane of the Sun.
    side = to_sun.copy()
    add(side, -dot(to_sun, up), up)
    if dot(side, side) < 1e-12:
        side = np.array([-up[1], up[0], 0.0]) if abs(up[2]) < 0.9 else np.array([0.0, -up[2], up[1]])
    side = unit(side)
    across = cross(up, side)
    limb = math.sqrt(1.0 - min(1.0, (MEAN_LUNAR_RADIUS_M / distance) ** 2))
    count = 1 + 3 * RING_COUNT * (RING_COUNT - 1)
    down, ground, summed, out = np.empty(3), np.empty(3), np.zeros(3), np.zeros(3)
    inner_count = 0
    for ring in range(RING_COUNT):
        members = max(1, 6 * ring)
        cosine = 1.0 - (1.0 - limb) * (inner_count + 0.5 * members) / count if ring else 1.0
        sine = math.sqrt(1.0 - cosine * cosine)
        inner_count += members
        root = MEAN_LUNAR_RADIUS_M**2 - (distance * sine) ** 2
        reach = distance * cosine - math.sqrt(max(0.0, root))
        for k in range(members):
            angle = 2.0 * math.pi * (k + 0.5) / members
            cosine_k, sine_k = math.cos(angle), math.sin(angle)
            for i in range(3):
                down[i] = -cosine * up[i] + sine * (cosine_k * side[i] + sine_k * across[i])
                ground[i] = (r[i] + reach * down[i]) / MEAN_LUNAR_RADIUS_M
            height = dot(ground, to_sun)
            add(
                summed, -0.5 * (height + math.sqrt(height * height + TERMINATOR_SINE * TERMINATOR_SINE)), down
            )
    # Radiance = irradiance / pi; each direction stands for this solid angle.
    solid = 2.0 * math.pi * (1.0 - limb) / count
    add(out, SUNLIGHT_N_M2 * (AU_M / sun_m) ** 2 * solid / math.pi, summed)
    return out


@compiled()
def axes(r: Floats, v: Floats) -> Floats:
    """Return radial, transverse and normal unit vectors as rows."""
    radial, normal = unit(r), unit(cross(r, v))
    transverse = cross(normal, radial)
    out = np.empty((3, 3))
    for i in range(3):
        out[0, i], out[1, i], out[2, i] = radial[i], transverse[i], normal[i]
    return out


@compiled()
def unit_components(r: Floats, v: Floats, columns: Floats, phase: Floats) -> Floats:
    """Return empirical accelerations for each component at 1 m/s^2, shape (COMPONENT_COUNT, 3)."""
    out = np.empty((layout.COMPONENT_COUNT, 3))
    base = np.zeros((3, 3))
    for k in range(3):
        base[k, k] = 1.0
    if columns[layout.IS_RTN] > 0.0:
        normal = columns[layout.PLANE_NORMAL : layout.PLANE_NORMAL + 3]
        base = axes(r, cross(normal, r) if dot(normal, normal) > 0.0 else v)
    angle = math.atan2(dot(r, phase[1]), dot(r, phase[0]))
    cosine, sine = math.cos(angle), math.sin(angle)
    for k in range(3):
        for i in range(3):
            out[k, i], out[3 + k, i], out[6 + k, i] = base[k, i], cosine * base[k, i], sine * base[k, i]
    return out


@compiled()
def _empirical(r: Floats, v: Floats, empirical: Floats, phase: Floats) -> Floats:
    """Return the sum of the active empirical accelerations."""
    out = np.zeros(3)
    for i in range(len(empirical)):
        columns = empirical[i]
        if columns[layout.IS_ACTIVE] > 0.0:
            units = unit_components(r, v, columns, phase)
            for k in range(layout.COMPONENT_COUNT):
                add(out, columns[layout.FIRST_COMPONENT + k], units[k])
    return out


@compiled()
def accelerations(r: Floats, v: Floats, sky: Floats, data: ForceData) -> Floats:
    """Return each of PARTS for a scale of 1, m/s^2, shape (len(PARTS), 3); zeros for parts switched off."""
    out = np.zeros((len(layout.PARTS), 3))
    square = dot(r, r)
    earth, sun = sky[:3], sky[3:6]
    rotation = sky[layout.ROTATION : layout.ROTATION + 9].reshape((3, 3))  # from the ICRF to the field's axes
    gm, on = data.gm, data.on
    add(out[layout.CENTRAL], -gm[0] / (square * math.sqrt(square)), r)
    if on[layout.HARMONICS]:
        add(out[layout.HARMONICS], gm[0], _harmonics(r, rotation, data))
    if on[layout.TIDES]:
        add(out[layout.TIDES], 1.0, _tides(r, _tensor(sky, data.gm, data.permanent), data.radius_m))
    for body in range(1, len(gm)):
        if on[layout.EARTH + body - 1]:
            place = sky[3 * body - 3 : 3 * body]
            to = minus(place, r)
            square_to, square_place = dot(to, to), dot(place, place)
            for i in range(3):
                direct = to[i] / (square_to * math.sqrt(square_to))
                indirect = place[i] / (square_place * math.sqrt(square_place))
                out[layout.EARTH + body - 1, i] = gm[body] * (direct - indirect)
    if on[layout.FIGURES]:
        add(out[layout.FIGURES], 1.0, _oblate(minus(r, earth), gm[1]))
        # Less that at the Moon, whose position is -earth.
        add(out[layout.FIGURES], 1.0, _oblate(earth, gm[1]))
        # The pull of the Earth at the Moon's figure is opposite to that of the figure at the Earth.
        add(out[layout.FIGURES], gm[1], _harmonics(earth, rotation, data))
    if on[layout.RELATIVITY]:
        places, speeds = np.zeros((3, 3)), np.zeros((3, 3))
        moon_speed = sky[layout.MOON_VELOCITY : layout.MOON_VELOCITY + 3]
        for i in range(3):
            places[1, i], places[2, i] = earth[i], sun[i]
            speeds[0, i] = moon_speed[i]
            speeds[1, i] = moon_speed[i] + sky[layout.EARTH_VELOCITY + i]
            speeds[2, i] = moon_speed[i] + sky[layout.SUN_VELOCITY + i]
        speed = moon_speed.copy()
        add(speed, 1.0, v)
        add(out[layout.RELATIVITY], 1.0, _post_newtonian(r, speed, 0, places, speeds, gm))
        add(out[layout.RELATIVITY], -1.0, _post_newtonian(places[0], moon_speed, 1, places, speeds, gm))
    if on[layout.SUNLIGHT]:
        add(out[layout.SUNLIGHT], 1.0, _sunlight(r, sun, earth))
    if on[layout.MOONLIGHT]:
        add(out[layout.MOONLIGHT], 1.0, _moonlight(r, sun))
    add(out[layout.EMPIRICAL], 1.0, _empirical(r, v, data.empirical, data.phase))
    return out


@compiled()
def _add_point_mass(out: Floats, to: Floats, gm: float) -> None:
    """Add the partials of the acceleration by a point mass."""
    square = dot(to, to)
    scale = gm / (square * math.sqrt(square))
    for i in range(3):
        for j in range(3):
            diagonal = scale if i == j else 0.0
            out[i, j] += 3.0 * scale * to[i] * to[j] / square - diagonal


@compiled()
def _gradient(r: Floats, sky: Floats, data: ForceData) -> Floats:
    """Return partials of the acceleration with respect to position: central term, harmonics, tides and point masses."""
    # Neglected: light, relativity and the figures, below 1e-7 of the central term.
    out = np.zeros((3, 3))
    _add_point_mass(out, r, data.gm[0])
    if data.on[layout.HARMONICS]:
        rotation = sky[layout.ROTATION : layout.ROTATION + 9].reshape((3, 3))
        p = times(rotation, r)
        s = harmonic_sums(p[0], p[1], p[2], data.radius_m, data.gradient_series, data.recursion)
        s *= data.gm[0] / data.radius_m**3
        in_field_axes = np.array([[s[0], s[1], s[2]], [s[1], s[3], s[4]], [s[2], s[4], -s[0] - s[3]]])
        out += rotation.T @ (in_field_axes @ rotation)
    if data.on[layout.TIDES]:
        tensor, square = _tensor(sky, data.gm, data.permanent), dot(r, r)
        trace = tensor[0, 0] + tensor[1, 1] + tensor[2, 2]
        pulled = times(tensor, r)
        invariant = 3.0 * dot(r, pulled) - trace * square
        slope = np.empty(3)
        for i in range(3):
            slope[i] = 6.0 * pulled[i] - 2.0 * trace * r[i]
        factor = data.scales[layout.TIDES] * 0.5 * data.radius_m**5 / (square * square * math.sqrt(square))
        for i in range(3):
            out[i, i] -= factor * (2.0 * trace + 5.0 * invariant / square)
            for j in range(3):
                mixed = slope[i] * r[j] + r[i] * slope[j] - 7.0 * invariant * r[i] * r[j] / square
                out[i, j] += factor * (6.0 * tensor[i, j] - 5.0 * mixed / square)
    for body in range(1, len(data.gm)):
        if data.on[layout.EARTH + body - 1]:
            _add_point_mass(out, minus(sky[3 * body - 3 : 3 * body], r), data.gm[body])
    return out


@compiled(error_model="numpy")
def _empirical_gradient(y: Floats, empirical: Floats, phase: Floats) -> Floats:
    """Return partials of empirical accelerations with respect to the state, (3, 6), by central differences."""
    out = np.empty((3, 6))
    for k in range(6):
        begin = k // 3 * 3
        of_same = y[begin : begin + 3]
        step = 1e-5 * math.sqrt(dot(of_same, of_same))
        ahead, behind = y.copy(), y.copy()
        ahead[k] += step
        behind[k] -= step
        change = _empirical(ahead[:3], ahead[3:], empirical, phase)
        add(change, -1.0, _empirical(behind[:3], behind[3:], empirical, phase))
        for i in range(3):
            out[i, k] = change[i] / (2.0 * step)
    return out


@compiled()
def _depends_on_state(empirical: Floats) -> bool:
    """Return whether an active empirical acceleration depends on the state."""
    for i in range(empirical.shape[0]):
        if empirical[i, layout.IS_ACTIVE] > 0.0:
            if empirical[i, layout.IS_RTN] > 0.0:
                return True
            for k in range(layout.FIRST_COMPONENT + 3, layout.FIRST_COMPONENT + layout.COMPONENT_COUNT):
                if empirical[i, k] != 0.0:
                    return True
    return False


@compiled()
def variations(
    y: Floats, sky: Floats, parts: Floats, columns: NDArray[np.int64], data: ForceData
) -> tuple[Floats, Floats]:
    """Return partials of the acceleration with respect to the state, (3, 6), and to parameters, (n_columns, 3)."""
    # `parts`: the accelerations at y; `columns`: for each parameter the part that it scales, or -1 for the state at an
    # epoch, and for empirical accelerations row * COMPONENT_COUNT + component.
    r, v = y[:3], y[3:]
    by_state = np.zeros((3, 6))
    if _depends_on_state(data.empirical):
        by_state = _empirical_gradient(y, data.empirical, data.phase)
    gradient = _gradient(r, sky, data)
    for i in range(3):
        for k in range(3):
            by_state[i, k] += gradient[i, k]
    by_parameters = np.zeros((len(columns), 3))
    for j in range(len(columns)):
        part, index = columns[j, 0], columns[j, 1]
        if part == layout.CENTRAL:
            for i in range(3):
                by_parameters[j, i] = (parts[layout.CENTRAL, i] + parts[layout.HARMONICS, i]) / data.gm[0]
        elif part == layout.SUNLIGHT:
            add(by_parameters[j], 1.0, parts[layout.SUNLIGHT])
            add(by_parameters[j], 1.0, parts[layout.MOONLIGHT])
        elif part == layout.EMPIRICAL:
            empirical = data.empirical[index // layout.COMPONENT_COUNT]
            if empirical[layout.IS_ACTIVE] > 0.0:
                units = unit_components(r, v, empirical, data.phase)
                add(by_parameters[j], 1.0, units[index % layout.COMPONENT_COUNT])
        elif part >= 0:
            add(by_parameters[j], 1.0, parts[part])
    return by_state, by_parameters
