r"""Media calibrations of the Deep Space Network: TRO and ION files of cards in the language CSP (TRK-2-23).

A card is the delay of data of a complex or an antenna as a function of UTC, one way, metres:

    ADJUST(DOPRNG) BY NRMPOW(1.4304, -0.2192, 3.2505) MODEL(CHPART)
      FROM(07/12/01,11:36) TO(07/12/01,20:47) DSN(C60) SCID(236).

=================  ====================================================================================
``CONST(a)``       a; also ``CNSTNT``
``NRMPOW(c...)``   c0 + c1 x + c2 x^2 + ..., where x goes from -1 at FROM to 1 at TO
``TRIG(P, c...)``  c0 + c1 cos x + c2 sin x + c3 cos 2x + c4 sin 2x + ..., x = 2 pi (t - FROM) / P, P in seconds
=================  ====================================================================================

``DRY NUPART`` and ``WET NUPART`` are delays at the zenith: cards by TRIG are the seasonal model, others what is added.
Where the files have no seasonal model, that of Estefan and Sovers (1994) is taken. ``CHPART`` is the delay of a code by
charged particles along the ray to a spacecraft at 2295 MHz; it goes with the inverse square of the frequency, and the
phase is advanced by as much (Moyer 2003, section 10.2.2). Cards of VLBI and of quasars are left aside.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np

from radioloc.constants import MJD_ZERO_JD, SECONDS_PER_DAY
from radioloc.earth.stations import Station
from radioloc.errors import CoverageError, FileFormatError, InputError
from radioloc.text_files import ANY_BYTE, numbers_of, read_text
from radioloc.time import Epochs, epochs_from_strings, to_scale, utc_strings
from radioloc.vectors import Floats

REFERENCE_HZ = 2295e6
"""Frequency of the delays by charged particles."""

DRY, WET, CHARGED = "DRY NUPART", "WET NUPART", "CHPART"
_MODELS = (DRY, WET, CHARGED)
_CODE, _PHASE = ("ALL", "DOPRNG", "RANGE"), ("ALL", "DOPRNG", "DOPPLER")
_DATA = {*_CODE, *_PHASE, "VLBI", "NBVLBI", "WBVLBI"}
_SHAPES = ("CONST", "NRMPOW", "TRIG")
_COMPLEXES = {"C10": "Goldstone", "C40": "Canberra", "C60": "Madrid"}
_ITEM = re.compile(r"\s*([A-Z][A-Z\s]*?)\s*\(([^()]*)\)\s*(\.?)")
_MOMENT = re.compile(r"(\d\d)/(\d\d)/(\d\d)\s*,\s*(\d\d:\d\d(?::\d\d(?:\.\d{1,9})?)?)", re.ASCII)
_ROUNDING_D = 1.0 / SECONDS_PER_DAY  # cards follow each other with gaps of milliseconds, or to the minute
_LARGEST_M = {DRY: 3.0, WET: 1.0, CHARGED: 1000.0}


@dataclass(frozen=True, slots=True)
class Card:
    """One card; spans are MJD of UTC, without an end infinite."""

    model: str
    data: str
    shape: str
    coefficients: tuple[float, ...]
    start_mjd: float
    stop_mjd: float
    stations: tuple[str, ...]
    scid: int | None

    def at(self, mjd_utc: Floats) -> Floats:
        """Delay (m) and its rate (m/s), shape (2, n)."""
        elapsed_s = (mjd_utc - self.start_mjd) * SECONDS_PER_DAY
        if self.shape == "TRIG":
            period_s, mean, *rest = self.coefficients
            cosines, sines = np.reshape(rest, (-1, 2)).T
            order = np.arange(1, len(cosines) + 1)
            turn = 2.0 * np.pi / period_s
            cos, sin = np.cos(np.outer(turn * elapsed_s, order)), np.sin(np.outer(turn * elapsed_s, order))
            rate = (sines * order) @ cos.T - (cosines * order) @ sin.T
            return np.stack([mean + cos @ cosines + sin @ sines, turn * rate])
        if self.shape == "CONST":
            return np.stack([np.full(len(mjd_utc), self.coefficients[0]), np.zeros(len(mjd_utc))])
        half_s = 0.5 * (self.stop_mjd - self.start_mjd) * SECONDS_PER_DAY
        power = np.polynomial.Polynomial(self.coefficients)
        x = elapsed_s / half_s - 1.0
        return np.stack([power(x), power.deriv()(x) / half_s])


@dataclass(frozen=True, slots=True, eq=False)
class MediaCalibrations:
    """Cards of TRO and ION files; where several hold, the later file or the one further down counts."""

    cards: tuple[Card, ...]
    paths: tuple[Path, ...]

    def serves(self, station: Station, model: str) -> bool:
        """Determine whether there are cards of a model for a station."""
        return any(True for _ in self._of(station, model))

    def zenith_m(self, station: Station, epochs: Epochs, model: str, phase: bool) -> Floats | None:
        """Delay at the zenith by the dry or the wet air, m, shape (n,); ``None`` for a station without cards."""
        if not self.serves(station, model):
            return None
        mine = list(self._of(station, model, phase))
        seasonal = [card for card in mine if card.shape == "TRIG"] or [
            card for card in _seasonal() if card.model == model and _names(station) & set(card.stations)
        ]
        corrections = [card for card in mine if card.shape != "TRIG"]
        total_m, _ = self._evaluated(seasonal, station, epochs, model)
        if corrections or not mine:
            total_m = total_m + self._evaluated(corrections, station, epochs, model)[0]
        return np.asarray(total_m)

    def charged(self, station: Station, epochs: Epochs, phase: bool) -> Floats | None:
        """Delay of a code along the ray at 2295 MHz (m) and its rate (m/s), shape (2, n); as :meth:`zenith_m`."""
        if not self.serves(station, CHARGED):
            return None
        return self._evaluated(list(self._of(station, CHARGED, phase)), station, epochs, CHARGED)

    def _of(self, station: Station, model: str, phase: bool | None = None) -> Iterator[Card]:
        data = {None: {*_CODE, *_PHASE}, True: _PHASE, False: _CODE}[phase]
        names = _names(station)
        return (c for c in self.cards if c.model == model and c.data in data and names & set(c.stations))

    def _evaluated(self, cards: list[Card], station: Station, epochs: Epochs, model: str) -> Floats:
        mjd_utc = to_scale(epochs, "UTC").mjd
        order = np.argsort(mjd_utc, kind="stable")
        rising = mjd_utc[order]
        found = np.full((2, len(mjd_utc)), np.nan)
        for card in cards:
            first, end = np.searchsorted(
                rising, [card.start_mjd - _ROUNDING_D, card.stop_mjd + _ROUNDING_D], side="left"
            )
            rows = order[first:end]
            if len(rows):
                found[:, rows] = card.at(mjd_utc[rows])
        if len(lacking := np.flatnonzero(np.isnan(found[0]))):
            start = min((card.start_mjd for card in cards), default=np.nan)
            stop = max((card.stop_mjd for card in cards), default=np.nan)
            asked = mjd_utc[lacking].min(), mjd_utc[lacking].max()
            gaps = ", which has gaps," if start < asked[1] and asked[0] < stop else ""
            raise CoverageError(
                f"{', '.join(path.name for path in self.paths)}: MODEL({model}) for {station.name}{gaps}",
                (_second(start), _second(stop)),
                (_second(asked[0]), _second(asked[1])),
                "read the files of this time too, or leave these observations out",
            )
        return found


def read_csp(paths: str | Path | Sequence[str | Path], scid: int | None = None) -> MediaCalibrations:
    r"""Read TRO and ION files of the Deep Space Network.

    Parameters
    ----------
    paths : path-like or sequence of path-like
        The files, of either kind, plain or gzip.
    scid : int, optional
        Number of the spacecraft at the Deep Space Network, where the files have cards of several.

    Raises
    ------
    FileFormatError
        A file cannot be read, a card is cut, or has what no card of media calibrations has.
    InputError
        The cards are of several spacecraft and `scid` does not say which, or of another one.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from radioloc.earth import StationCatalogue
    >>> from radioloc.media import read_csp
    >>> from radioloc.time import epochs_from_strings
    >>> path = pathlib.Path(tempfile.mkdtemp(), "a.ion")
    >>> span = "FROM(20/12/02,00:00) TO(20/12/02,08:00) DSN(C10) SCID(177)."
    >>> _ = path.write_text(f"ADJUST(DOPRNG) BY NRMPOW(2.0, 0.5) MODEL(CHPART) {span}")
    >>> station, epochs = StationCatalogue.default().get("DSS-24"), epochs_from_strings("2020-12-02T06:00:00", "UTC")
    >>> read_csp(path).charged(station, epochs, phase=False)[0].round(3).tolist()
    [2.25]
    """
    names = [Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths]
    if not names:
        raise InputError("no file of media calibrations is given")
    cards = [card for path in names for card in _cards(path)]
    of = {card.scid for card in cards if card.scid is not None}
    named = ", ".join(map(str, sorted(of)))
    if scid is None and len(of) > 1:
        raise InputError(f"{names[0]}: the cards are of the spacecraft {named}; say which, [model] csp_scid")
    if scid is not None and of and scid not in of:
        raise InputError(
            f"{names[0]}: the cards are of the spacecraft {named}, not of {scid}; correct csp_scid"
        )
    wanted = (None, *of) if scid is None else (None, scid)
    return MediaCalibrations(tuple(card for card in cards if card.scid in wanted), tuple(names))


@cache
def _seasonal() -> tuple[Card, ...]:
    with as_file(files("radioloc.media") / "data" / "dsn_seasonal.csp") as path:
        return tuple(_cards(path))


def _names(station: Station) -> set[str]:
    """Names of a station in cards: the numbers of its antenna, and its complex."""
    numbers = (re.fullmatch(r"DSS[- ]?0*(\d+)", name.upper()) for name in (station.name, *station.aliases))
    complexes = (code for code, place in _COMPLEXES.items() if station.complex.startswith(place))
    return {found[1] for found in numbers if found} | set(complexes)


def _second(mjd_utc: float) -> str:
    epoch = Epochs.from_jd(MJD_ZERO_JD, mjd_utc, "UTC") if np.isfinite(mjd_utc) else None
    return "no epoch" if epoch is None else str(utc_strings(epoch, 0)[0])


def _cards(path: Path) -> Iterator[Card]:
    """Read the cards of a file, without those of VLBI and quasars; a label may precede the first."""
    text = re.sub(r"#.*", "", read_text(path, encoding=ANY_BYTE)).rstrip()
    begin = re.search(r"^\s*ADJUST\b", text, re.MULTILINE)
    if begin is None:
        raise FileFormatError(path, "there is no card ADJUST(...), as media calibrations of the DSN have")
    place, line, items = 0, 1, _Items(path)
    begins = begin.start()
    while begins < len(text):
        item = _ITEM.match(text, begins)
        here = begins if item is None else item.start(1)
        place, line = here, line + text.count("\n", place, here)
        if item is None:
            problem = "KEYWORD(...) is wanted, or the full stop that ends a card; it may have been cut"
            raise FileFormatError(path, problem, line)
        items.add(" ".join(item[1].split()), " ".join(item[2].split()), line)
        begins = item.end()
        if item[3]:
            card, items = items.card(), _Items(path)
            if card is not None:
                yield card
    if items.lines:
        raise items.fail("KEYWORD(...) is wanted, or the full stop that ends a card; it may have been cut")


class _Items:
    """The items of one card by their keywords, and their lines."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.items: dict[str, str] = {}
        self.lines: dict[str, int] = {}

    def fail(self, problem: str, keyword: str = "") -> FileFormatError:
        """Error about a keyword, or about the end of the card."""
        return FileFormatError(self.path, problem, self.lines.get(keyword, max(self.lines.values())))

    def add(self, keyword: str, text: str, line: int) -> None:
        if keyword in self.items:
            raise FileFormatError(self.path, f"{keyword} comes twice in a card", line)
        self.items[keyword], self.lines[keyword] = text, line

    def card(self) -> Card | None:
        """Return the card, or ``None`` if it is of VLBI or quasars."""
        by = next((keyword for keyword in self.items if keyword.startswith("BY ")), "BY")
        data, model = self._one_of("ADJUST", _DATA), self._one_of("MODEL", _MODELS)
        shape = by.removeprefix("BY ").removeprefix("D").replace("CNSTNT", "CONST")
        if shape not in _SHAPES:
            raise self.fail(f"{by} is none of BY {', BY '.join(_SHAPES)}", by)
        coefficients = tuple(numbers_of(self.path, self.lines.get(by), self._words(by), "a coefficient"))
        stations = tuple(self._words("DSN"))
        quasar, scid = self.items.pop("QUASAR", None), self.items.pop("SCID", None)
        start, stop = self._moment("FROM"), self._moment("TO") if "TO" in self.items else np.inf
        if self.items:
            keyword = next(iter(self.items))
            raise self.fail(f"{keyword} is not known in media calibrations", keyword)
        if not start < stop or (shape == "NRMPOW" and np.isinf(stop)):
            raise self.fail("TO must follow FROM; only TRIG and CONST do without TO", "FROM")
        if (shape == "TRIG" and (len(coefficients) % 2 or coefficients[0] <= 0.0)) or (
            shape == "CONST" and len(coefficients) != 1
        ):
            raise self.fail(
                "CONST has one number, TRIG a period above zero, a mean, and pairs for cosine and sine", by
            )
        mean_m = coefficients[shape == "TRIG"]
        if abs(mean_m) > _LARGEST_M[model]:
            raise self.fail(f"a delay of {mean_m:g} m is none of {model}; metres are wanted", by)
        if scid is not None and not re.fullmatch("[0-9]{1,6}", scid):
            raise self.fail(f"SCID({scid}) is no number of a spacecraft", "SCID")
        if quasar is not None or data not in {*_CODE, *_PHASE}:
            return None
        number = None if scid is None else int(scid)
        return Card(model, data, shape, coefficients, start, stop, stations, number)

    def _take(self, keyword: str) -> str:
        if keyword not in self.items:
            raise self.fail(f"the card that ends here lacks {keyword}(...)")
        return self.items.pop(keyword)

    def _words(self, keyword: str) -> list[str]:
        return [word.strip() for word in self._take(keyword).split(",")]

    def _one_of(self, keyword: str, known: Collection[str]) -> str:
        word = self._take(keyword)
        if word not in known:
            raise self.fail(f"{keyword}({word}) is none of {', '.join(sorted(known))}", keyword)
        return word

    def _moment(self, keyword: str) -> float:
        given = self._take(keyword)
        found = _MOMENT.fullmatch(given)
        try:
            if found is None:
                raise ValueError
            century = "20" if int(found[1]) < 69 else "19"
            ends_day = re.fullmatch(r"24:00(:00(\.0+)?)?", found[4]) is not None
            time = "00:00" if ends_day else found[4]
            utc = epochs_from_strings(f"{century}{found[1]}-{found[2]}-{found[3]}T{time}", "UTC")
            return float(utc.mjd[0]) + ends_day
        except ValueError:
            raise self.fail(f"{keyword}({given}) is no epoch such as 20/12/02,15:30:00", keyword) from None
