r"""Media calibrations of the Deep Space Network: TRO and ION files of cards in the language CSP (TRK-2-23).

A card is the one-way delay of the data of a complex or an antenna as a function of UTC, metres:

    ADJUST(DOPRNG) BY NRMPOW(1.4304, -0.2192, 3.2505) MODEL(CHPART)
      FROM(07/12/01,11:36) TO(07/12/01,20:47) DSN(C60) SCID(236).

=================  ====================================================================================
``CONST(a)``       a; also ``CNSTNT``
``NRMPOW(c...)``   c0 + c1 x + c2 x^2 + ..., where x goes from -1 at FROM to 1 at TO
``TRIG(P, c...)``  c0 + c1 cos x + c2 sin x + c3 cos 2x + c4 sin 2x + ..., x = 2 pi (t - FROM) / P, P in seconds
=================  ====================================================================================

``DRY NUPART`` and ``WET NUPART`` are delays at the zenith: cards by TRIG are the seasonal model, the others its
corrections. Without seasonal cards the model of Estefan and Sovers (1994) is used. ``CHPART`` is the delay of a code by
charged particles along the ray to a spacecraft at 2295 MHz. It is proportional to the inverse square of the frequency;
the phase is advanced by as much (Moyer 2003, section 10.2.2). Cards of VLBI and of quasars are ignored.
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
from radioloc.text_files import ANY_BYTE, parse_numbers, read_text
from radioloc.time import Epochs, epochs_from_strings, to_scale, utc_strings
from radioloc.vectors import Floats

REFERENCE_HZ = 2295e6
"""Frequency of the delays by charged particles, Hz."""

DRY, WET, CHARGED = "DRY NUPART", "WET NUPART", "CHPART"
_MODELS = (DRY, WET, CHARGED)
_CODE, _PHASE = ("ALL", "DOPRNG", "RANGE"), ("ALL", "DOPRNG", "DOPPLER")
_DATA = {*_CODE, *_PHASE, "VLBI", "NBVLBI", "WBVLBI"}
_SHAPES = ("CONST", "NRMPOW", "TRIG")
_COMPLEXES = {"C10": "Goldstone", "C40": "Canberra", "C60": "Madrid"}
_ITEM = re.compile(r"\s*([A-Z][A-Z\s]*?)\s*\(([^()]*)\)\s*(\.?)")
_EPOCH = re.compile(r"(\d\d)/(\d\d)/(\d\d)\s*,\s*(\d\d:\d\d(?::\d\d(?:\.\d{1,9})?)?)", re.ASCII)
_INCOMPLETE = "expected KEYWORD(...), or the full stop that ends a card; it may have been cut"
_ROUNDING_D = 1.0 / SECONDS_PER_DAY  # cards follow each other with gaps of milliseconds, or to the minute
_MAX_DELAY_M = {DRY: 3.0, WET: 1.0, CHARGED: 1000.0}  # larger ones are in another unit


@dataclass(frozen=True, slots=True)
class Card:
    """Card of a delay; its span is MJD of UTC, without an end infinite."""

    model: str
    data: str
    shape: str
    coefficients: tuple[float, ...]
    start_mjd: float
    stop_mjd: float
    stations: tuple[str, ...]
    scid: int | None

    def delay_and_rate(self, mjd_utc: Floats) -> Floats:
        """Return the delay (m) and its rate (m/s), shape (2, n)."""
        elapsed_s = (mjd_utc - self.start_mjd) * SECONDS_PER_DAY
        if self.shape == "TRIG":
            period_s, mean, *terms = self.coefficients
            cosines, sines = np.reshape(terms, (-1, 2)).T
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
    """Cards of TRO and ION files; of several valid ones the last counts."""

    cards: tuple[Card, ...]
    paths: tuple[Path, ...]

    def has_cards(self, station: Station, model: str) -> bool:
        """Return whether a station has cards of a model."""
        return any(True for _ in self._cards_of(station, model))

    def zenith_m(self, station: Station, epochs: Epochs, model: str, phase: bool) -> Floats | None:
        """Return the zenith delay by dry or wet air, m, shape (n,); ``None`` for a station without cards."""
        if not self.has_cards(station, model):
            return None
        cards = list(self._cards_of(station, model, phase))
        seasonal = [card for card in cards if card.shape == "TRIG"] or [
            card for card in _seasonal() if card.model == model and _names(station) & set(card.stations)
        ]
        corrections = [card for card in cards if card.shape != "TRIG"]
        total_m, _ = self._evaluate(seasonal, station, epochs, model)
        if corrections or not cards:
            total_m = total_m + self._evaluate(corrections, station, epochs, model)[0]
        return np.asarray(total_m)

    def charged_delay(self, station: Station, epochs: Epochs, phase: bool) -> Floats | None:
        """Return the delay of a code at 2295 MHz (m) and its rate (m/s), shape (2, n), or ``None`` as `zenith_m`."""
        if not self.has_cards(station, CHARGED):
            return None
        return self._evaluate(list(self._cards_of(station, CHARGED, phase)), station, epochs, CHARGED)

    def _cards_of(self, station: Station, model: str, phase: bool | None = None) -> Iterator[Card]:
        data = {None: {*_CODE, *_PHASE}, True: _PHASE, False: _CODE}[phase]
        names = _names(station)
        return (c for c in self.cards if c.model == model and c.data in data and names & set(c.stations))

    def _evaluate(self, cards: list[Card], station: Station, epochs: Epochs, model: str) -> Floats:
        mjd_utc = to_scale(epochs, "UTC").mjd
        order = np.argsort(mjd_utc, kind="stable")
        rising = mjd_utc[order]
        delay_and_rate = np.full((2, len(mjd_utc)), np.nan)
        for card in cards:
            first, end = np.searchsorted(
                rising, [card.start_mjd - _ROUNDING_D, card.stop_mjd + _ROUNDING_D], side="left"
            )
            rows = order[first:end]
            if len(rows):
                delay_and_rate[:, rows] = card.delay_and_rate(mjd_utc[rows])
        if len(lacking := np.flatnonzero(np.isnan(delay_and_rate[0]))):
            start = min((card.start_mjd for card in cards), default=np.nan)
            stop = max((card.stop_mjd for card in cards), default=np.nan)
            first_mjd, last_mjd = mjd_utc[lacking].min(), mjd_utc[lacking].max()
            gaps = ", which has gaps," if start < last_mjd and first_mjd < stop else ""
            raise CoverageError(
                f"{', '.join(path.name for path in self.paths)}: MODEL({model}) for {station.name}{gaps}",
                (_second(start), _second(stop)),
                (_second(first_mjd), _second(last_mjd)),
                "read the files of this time, too, or exclude these observations",
            )
        return delay_and_rate


def read_csp(paths: str | Path | Sequence[str | Path], scid: int | None = None) -> MediaCalibrations:
    r"""Read TRO and ION files of the Deep Space Network.

    Parameters
    ----------
    paths : path-like or sequence of path-like
        The files, of either kind, plain or gzip.
    scid : int, optional
        Number of the spacecraft at the Deep Space Network; required if the files have cards of several.

    Raises
    ------
    FileFormatError
        A file cannot be read, or a card is incomplete or not of media calibrations.
    InputError
        The cards are of several spacecraft and `scid` is missing, or they are of another spacecraft.

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
    >>> read_csp(path).charged_delay(station, epochs, phase=False)[0].round(3).tolist()
    [2.25]
    """
    names = [Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths]
    if not names:
        raise InputError("expected one or more files of media calibrations, got none")
    cards = [card for path in names for card in _cards(path)]
    spacecraft = {card.scid for card in cards if card.scid is not None}
    if (scid is None and len(spacecraft) > 1) or (scid is not None and spacecraft and scid not in spacecraft):
        choices = " or ".join(map(str, sorted(spacecraft)))
        raise InputError(f"{names[0]}: csp_scid: expected {choices}, as the cards state, got {scid}")
    numbers = (None, *spacecraft) if scid is None else (None, scid)
    return MediaCalibrations(tuple(card for card in cards if card.scid in numbers), tuple(names))


@cache
def _seasonal() -> tuple[Card, ...]:
    with as_file(files("radioloc.media") / "data" / "dsn_seasonal.csp") as path:
        return tuple(_cards(path))


def _names(station: Station) -> set[str]:
    """Return the names of a station in cards: the numbers of its antenna, and its complex."""
    numbers = (re.fullmatch(r"DSS[- ]?0*(\d+)", name.upper()) for name in (station.name, *station.aliases))
    complexes = (code for code, place in _COMPLEXES.items() if station.complex.startswith(place))
    return {match[1] for match in numbers if match} | set(complexes)


def _second(mjd_utc: float) -> str:
    epoch = Epochs.from_jd(MJD_ZERO_JD, mjd_utc, "UTC") if np.isfinite(mjd_utc) else None
    return "no epoch" if epoch is None else str(utc_strings(epoch, 0)[0])


def _cards(path: Path) -> Iterator[Card]:
    """Yield the cards of a file, without those of VLBI and quasars; a label may precede the first."""
    text = re.sub(r"#.*", "", read_text(path, encoding=ANY_BYTE)).rstrip()
    begin = re.search(r"^\s*ADJUST\b", text, re.MULTILINE)
    if begin is None:
        raise FileFormatError(path, "expected cards ADJUST(...) of media calibrations, got none")
    place, line, items = 0, 1, _Items(path)
    begins = begin.start()
    while begins < len(text):
        item = _ITEM.match(text, begins)
        start = begins if item is None else item.start(1)
        place, line = start, line + text.count("\n", place, start)
        if item is None:
            raise FileFormatError(path, _INCOMPLETE, line)
        items.add(" ".join(item[1].split()), " ".join(item[2].split()), line)
        begins = item.end()
        if item[3]:
            card, items = items.card(), _Items(path)
            if card is not None:
                yield card
    if items.lines:
        raise items.error(_INCOMPLETE)


class _Items:
    """Items of a card by their keywords, and their lines."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.items: dict[str, str] = {}
        self.lines: dict[str, int] = {}

    def error(self, problem: str, keyword: str = "") -> FileFormatError:
        """Return an error about a keyword, or about the end of the card."""
        return FileFormatError(self.path, problem, self.lines.get(keyword, max(self.lines.values())))

    def add(self, keyword: str, text: str, line: int) -> None:
        if keyword in self.items:
            raise FileFormatError(self.path, f"{keyword} is duplicated in the card", line)
        self.items[keyword], self.lines[keyword] = text, line

    def card(self) -> Card | None:
        """Return the card, or ``None`` for cards of VLBI and quasars."""
        by = next((keyword for keyword in self.items if keyword.startswith("BY ")), "BY")
        data, model = self._choice("ADJUST", _DATA), self._choice("MODEL", _MODELS)
        shape = by.removeprefix("BY ").removeprefix("D").replace("CNSTNT", "CONST")
        if shape not in _SHAPES:
            raise self.error(f"expected BY {', BY '.join(_SHAPES)}, got {by}", by)
        coefficients = tuple(parse_numbers(self.path, self.lines.get(by), self._words(by), "a coefficient"))
        stations = tuple(self._words("DSN"))
        quasar, scid = self.items.pop("QUASAR", None), self.items.pop("SCID", None)
        start, stop = self._mjd_utc("FROM"), self._mjd_utc("TO") if "TO" in self.items else np.inf
        if self.items:
            keyword = next(iter(self.items))
            raise self.error(f"unsupported keyword {keyword}", keyword)
        if not start < stop or (shape == "NRMPOW" and np.isinf(stop)):
            raise self.error("TO must follow FROM; only TRIG and CONST can omit TO", "FROM")
        if (shape == "TRIG" and (len(coefficients) % 2 or coefficients[0] <= 0.0)) or (
            shape == "CONST" and len(coefficients) != 1
        ):
            raise self.error(
                "CONST has one number, TRIG a period above zero, a mean, and pairs for cosine and sine", by
            )
        mean_m = coefficients[shape == "TRIG"]
        if abs(mean_m) > _MAX_DELAY_M[model]:
            raise self.error(
                f"{model}: expected a delay of up to {_MAX_DELAY_M[model]:g} m, got {mean_m:g}; correct the unit",
                by,
            )
        if scid is not None and not re.fullmatch("[0-9]{1,6}", scid):
            raise self.error(f"SCID: expected the number of a spacecraft, got {scid!r}", "SCID")
        if quasar is not None or data not in {*_CODE, *_PHASE}:
            return None
        number = None if scid is None else int(scid)
        return Card(model, data, shape, coefficients, start, stop, stations, number)

    def _take(self, keyword: str) -> str:
        if keyword not in self.items:
            raise self.error(f"the card that ends in this line lacks {keyword}(...)")
        return self.items.pop(keyword)

    def _words(self, keyword: str) -> list[str]:
        return [word.strip() for word in self._take(keyword).split(",")]

    def _choice(self, keyword: str, choices: Collection[str]) -> str:
        word = self._take(keyword)
        if word not in choices:
            raise self.error(f"{keyword}: expected {', '.join(sorted(choices))}, got {word}", keyword)
        return word

    def _mjd_utc(self, keyword: str) -> float:
        text = self._take(keyword)
        match = _EPOCH.fullmatch(text)
        try:
            if match is None:
                raise ValueError
            century = "20" if int(match[1]) < 69 else "19"
            ends_day = re.fullmatch(r"24:00(:00(\.0+)?)?", match[4]) is not None
            time = "00:00" if ends_day else match[4]
            utc = epochs_from_strings(f"{century}{match[1]}-{match[2]}-{match[3]}T{time}", "UTC")
            return float(utc.mjd[0]) + ends_day
        except ValueError:
            raise self.error(
                f"{keyword}: expected an epoch such as 20/12/02,15:30:00, got {text}", keyword
            ) from None
