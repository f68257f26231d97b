"""Digital calibration certificates (PTB's DCC, schema 3, with D-SI units) of artefacts: known distances or places of spheres.

A certificate states a geometry with an uncertainty, not where the artefact stands on the machine. So it ties the places of the targets
to each other (`Artefact.rows`), and their position and orientation together remain unknown. Coordinates (ball plate) are compared with
the places after the best rigid motion; the six directions of that motion are projected out of residuals and covariance, which is the
same as estimating the motion with a flat prior. Distances (ball bar, step gauge) do not depend on it.

Correlation matters: a scale uncertainty common to all distances does not average away. If a certificate states no covariance, its n
variances are multiplied by n. No covariance matrix with these variances exceeds that diagonal (xᵀCx = |Σ Lᵢxᵢ|² ≤ n Σ |Lᵢxᵢ|²), so the
result is never too confident, whatever the correlation. The same holds of n quantities, each with a covariance matrix of its own.

Values hold at 20 °C (ISO 1). At another temperature the artefact is larger by the coefficient of thermal expansion that the certificate
states (`Artefact.at`); the uncertainties of coefficient and temperature act on all lengths alike.
Checked is what is used, in D-SI 2.0 to 2.2: twin has no copy of the schema.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any, Final, NamedTuple, final

import numpy as np
from scipy.linalg import block_diag

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.files import read_text
from twin._common.messages import Message
from twin._common.units import MM, UM, count_with_noun
from twin._common.xml_files import Element, parse_xml
from twin._common.yaml_files import MAX_VALUE
from twin.display.results import Result
from twin.numerics.covariance import inverse_root
from twin.numerics.spatial import rigid_fit, shape_contrasts

DCC: Final = "https://ptb.de/dcc"
SI: Final = "https://ptb.de/si"
MAX_BYTES: Final = 2**25
"""Largest size of a certificate; pictures in it are large."""
ADMINISTRATIVE: Final = ("dccSoftware", "coreData", "items", "calibrationLaboratory", "respPersons", "customer")
"""Mandatory parts of ``administrativeData``."""
CORE: Final = ("countryCodeISO3166_1", "uniqueIdentifier", "beginPerformanceDate", "endPerformanceDate")
"""Parts of ``coreData`` without which a certificate cannot be traced."""
_DECIMAL: Final = re.compile(r"[-+]?(\d*\.\d+|\d+\.\d*|\d+)([Ee][-+]?\d+)?")
_LENGTH_UNIT: Final = re.compile(r"(?:\\([a-z]+))?\\metre")
_AREA_UNIT: Final = re.compile(rf"{_LENGTH_UNIT.pattern}(?:\\tothe\{{2\}}|{_LENGTH_UNIT.pattern})")
_PER_KELVIN: Final = re.compile(
    r"(?:(?:\\([a-z]+))?\\metre(?:\\metre\\tothe\{-1\}|\\per\\metre))?(?:\\kelvin\\tothe\{-1\}|\\per\\kelvin)"
)
PREFIXES: Final = {None: 1.0, "kilo": 1e3, "deci": 0.1, "centi": 1e-2, "milli": MM, "micro": UM, "nano": 1e-9}
_COORDINATE: Final = re.compile(r"(.+?)\s*[ ._:]\s*([xyz])", re.IGNORECASE)
LABELS: Final = (
    "labels such as S1-S2 (a distance) or S1.x, S1.y, S1.z (coordinates), by the names of the table's targets"
)
AGREEMENT: Final = 0.02
"""Relative difference between U/k and the root of the covariance's diagonal that rounding explains."""
CONTRADICTION: Final = 5.0
"""Standard deviations by which two statements of one certificate may differ."""
LEAST_EIGENVALUE: Final = 1e-12
"""Smallest eigenvalue of a covariance relative to its largest; below it, a combination is stated without uncertainty."""
SMALLEST_U_M: Final = 1e-12
"""Standard uncertainty, m, below which none is stated: no laboratory is that good, and weights stay finite."""
REFERENCE_DEGC: Final = 20.0
AT_TEMPERATURE: Final = partial(
    Message,
    "its values are those at {temperature:.4g} °C, by its coefficient of thermal expansion of {alpha:.3g} µm/(m·K), u {u:.2g}",
)
CERTIFICATE: Final = partial(
    Message, "certificate {number} ({item}): {what} of {count} targets known, {correlation}; {temperature}"
)
STATED: Final = Message("with the covariance that it states")
ENLARGED: Final = partial(
    Message, "it states no correlation, so its variances are multiplied by {factor}, which covers any correlation"
)
TEMPERATURE_U_K: Final = 0.2
"""Standard uncertainty of an artefact's temperature: thermometer, and gradients inside the artefact."""
MOST_EXPANSION: Final = 2e-4
"""Largest plausible coefficient of thermal expansion, 1/K: plastics."""


class _Statement(NamedTuple):
    """One labelled value: metres; ``u``: standard uncertainty, m; NaN if only a covariance is stated."""

    label: str
    value: float
    u: float
    line: int


class _Quantity(NamedTuple):
    """Labelled values with a common uncertainty; ``covariance``: (n, n) m² or None if none is stated."""

    statements: tuple[_Statement, ...]
    covariance: np.ndarray | None
    line: int


class Contrasts(NamedTuple):
    """Whitened differences between a certificate and the places of the targets.

    ``residual``: (r,) certificate minus place; ``derivative``: (r, targets, 3) of the compared values with respect to the places, 1/m.
    """

    residual: np.ndarray
    derivative: np.ndarray


@final
@dataclass(frozen=True, eq=False, repr=False)
class Artefact(Result):
    """Known distances between targets, or their coordinates in the artefact's own frame, from a calibration certificate.

    Attributes:
        source: the file.
        number: unique identifier of the certificate.
        item: name of the calibrated item.
        targets: names of the targets, as in the measurement table.
        pairs: (m, 2) targets of each distance; (0, 2) for coordinates.
        value: (m,) distances or (targets, 3) coordinates, metres.
        covariance: (m, m) or (3·targets, 3·targets), m².
        enlarged: number by which the stated variances are multiplied; 1 if the certificate states the covariance (see the module).
        expansion: coefficient of thermal expansion and its standard uncertainty, 1/K; None if the certificate states none or several.
        temperature_degC: temperature for which the values hold.

    Examples:
        >>> pair, length, variance = np.array([[0, 1]]), np.array([0.3]), np.array([[1e-12]])
        >>> bar = twin.Artefact("bar.xml", "B-1", "ball bar", ("S1", "S2"), pair, length, variance, 1)
        >>> bar.rows(np.array([[0.0, 0.0, 0.0], [0.300002, 0.0, 0.0]])).residual.round(3)  # 2 µm longer than stated, u 1 µm
        array([-2.])
    """

    source: str
    number: str
    item: str
    targets: tuple[str, ...]
    pairs: np.ndarray
    value: np.ndarray
    covariance: np.ndarray
    enlarged: int
    expansion: tuple[float, float] | None = None
    temperature_degC: float = REFERENCE_DEGC

    @classmethod
    def load(cls, path: str | Path, targets: Collection[str]) -> Artefact:
        """Read the certificate of an artefact.

        Args:
            path: XML file of a digital calibration certificate.
            targets: names of the targets that were measured; values of other spheres are not used.

        Raises:
            InputError: with file, element and line: no certificate of schema 3; a mandatory element is missing; a number, unit or
                uncertainty is missing or cannot be read; labels of other spheres; statements that contradict each other.
        """
        return _loaded(Path(path), tuple(dict.fromkeys(targets)))

    @property
    def brief(self) -> Message:
        """The certificate and what is used of it, in one line."""
        what = Message("{count} distances", count=len(self.pairs)) if len(self.pairs) else Message("coordinates")
        correlation = STATED if self.enlarged == 1 else ENLARGED(factor=self.enlarged)
        of = {"correlation": correlation, "temperature": self._temperature_text, "count": len(self.targets)}
        return CERTIFICATE(number=self.number, item=self.item, what=what, **of)

    @property
    def _temperature_text(self) -> Message:
        if self.temperature_degC == REFERENCE_DEGC or self.expansion is None:
            return Message("its values are used as stated, without thermal expansion of the artefact")
        alpha, u = (1e6 * value for value in self.expansion)
        return AT_TEMPERATURE(temperature=self.temperature_degC, alpha=alpha, u=u)

    def at(self, temperature_degC: float, u_K: float = TEMPERATURE_U_K) -> Artefact:
        """Return the artefact at a temperature, whose uncertainty and that of the coefficient are in the covariance.

        Raises `InputError`: the certificate states no coefficient of thermal expansion, and the temperature is not 20 °C.
        """
        away = temperature_degC - self.temperature_degC
        if self.expansion is None:
            if away == 0.0:
                return self
            raise InputError(
                f"the artefact was at {temperature_degC:.4g} °C and its certificate states no coefficient of thermal expansion",
                expected=r"one value with a unit such as \kelvin\tothe{-1} and its uncertainty, or readings at 20 °C",
                file=self.source,
            )
        alpha, u = self.expansion
        value = self.value * (1.0 + alpha * away)
        common = ((u * away) ** 2 + (alpha * u_K) ** 2) * np.outer(value, value)
        covariance = read_only(self.covariance + common)
        return replace(self, value=read_only(value), covariance=covariance, temperature_degC=temperature_degC)

    def among(self, targets: Sequence[str]) -> Artefact | None:
        """Return what is known of some targets, the other values integrated out; None if nothing is."""
        keep = [i for i, name in enumerate(self.targets) if name in targets]
        if len(keep) == len(self.targets):
            return self
        if len(keep) < 2:
            return None
        names = tuple(self.targets[i] for i in keep)
        if not len(self.pairs):
            at = np.array([3 * i + k for i in keep for k in range(3)])
            return self._with(names, self.pairs, self.value[keep], self.covariance[np.ix_(at, at)])
        rows = np.flatnonzero(np.isin(self.pairs, keep).all(axis=1))
        if not len(rows):
            return None
        pairs = np.searchsorted(keep, self.pairs[rows])
        return self._with(names, pairs, self.value[rows], self.covariance[np.ix_(rows, rows)])

    def _with(self, targets: tuple[str, ...], pairs: np.ndarray, value: np.ndarray, covariance: np.ndarray) -> Artefact:
        return replace(self, targets=targets, pairs=pairs, value=value, covariance=read_only(covariance))

    def rows(self, place: np.ndarray) -> Contrasts:
        """Return the whitened difference between certificate and places; ``place``: (targets, 3) metres, in any frame."""
        if not len(self.pairs):
            fitted, turn = rigid_fit(self.value, place)
            shape = shape_contrasts(place)
            turned = np.kron(np.eye(len(place)), turn)
            root = inverse_root(shape.T @ turned @ self.covariance @ turned.T @ shape) @ shape.T
            return Contrasts(root @ (fitted - place).ravel(), root.reshape(len(root), len(place), 3))
        between = place[self.pairs[:, 0]] - place[self.pairs[:, 1]]
        length = np.linalg.norm(between, axis=1)
        unit = between / np.maximum(length, 1e-12)[:, None]
        derivative, rows = np.zeros((len(length), len(place), 3)), np.arange(len(length))
        derivative[rows, self.pairs[:, 0]] += unit
        derivative[rows, self.pairs[:, 1]] -= unit
        root = inverse_root(self.covariance)
        return Contrasts(root @ (self.value - length), np.einsum("rm,mtk->rtk", root, derivative))

    def largest_difference(self, place: np.ndarray) -> float:
        """Return the largest difference between certificate and places after the best rigid motion, metres."""
        if not len(self.pairs):
            return float(np.linalg.norm(rigid_fit(self.value, place)[0] - place, axis=1).max())
        between = place[self.pairs[:, 0]] - place[self.pairs[:, 1]]
        return float(np.abs(self.value - np.linalg.norm(between, axis=1)).max())

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        return {
            "certificate": self.number,
            "item": self.item,
            "file": self.source,
            "targets": list(self.targets),
            "kind": "distances" if len(self.pairs) else "coordinates",
            "variances_multiplied_by": self.enlarged,
            "temperature_degC": self.temperature_degC,
        }


# --- Reading ---------------------------------------------------------------------------------------


def _local(element: Element) -> str:
    return element.name.rpartition(" ")[2]


def _child(element: Element, *names: str) -> Element | None:
    """Return the first child with one of these names, of either namespace."""
    return next((child for child in element.children if _local(child) in names), None)


@final
class _Reader:
    """Reads the elements of one file; errors name the element and its line."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.root = parse_xml(
            read_text(path, most_bytes=MAX_BYTES), path, "a digital calibration certificate (XML)", namespaces=True
        )
        self._check_certificate()

    def error(self, what: str, expected: str, element: Element, value: object = None) -> InputError:
        return InputError(
            f"element {_local(element)}: {what}", expected=expected, file=self.path, line=element.line, value=value
        )

    def need(self, parent: Element, *names: str) -> Element:
        found = _child(parent, *names)
        if found is None:
            raise self.error(f"{names[0]} is missing", f"{' or '.join(names)} in {_local(parent)}", parent)
        return found

    def text(self, parent: Element, name: str) -> str:
        found = self.need(parent, name)
        if not found.text:
            raise self.error("is empty", "text", found)
        return found.text

    def _check_certificate(self) -> None:
        root = self.root
        version = root.attributes.get("schemaVersion", "")
        if root.name != f"{DCC} digitalCalibrationCertificate":
            raise self.error("not a digital calibration certificate", f"digitalCalibrationCertificate of {DCC}", root)
        if not version.startswith("3."):
            raise self.error("another version of the schema", "schemaVersion 3.x", root, version)
        about = self.need(root, "administrativeData")
        for name in ADMINISTRATIVE:
            self.need(about, name)
        for name in CORE:
            self.text(self.need(about, "coreData"), name)
        self.need(root, "measurementResults")

    @property
    def number(self) -> str:
        return self.text(self.need(self.need(self.root, "administrativeData"), "coreData"), "uniqueIdentifier")

    @property
    def item(self) -> str:
        items = self.need(self.need(self.root, "administrativeData"), "items")
        return self.text(self.need(self.need(items, "item"), "name"), "content")

    def number_of(self, element: Element, *, least: float = -np.inf) -> float:
        return self.numbers_of(element, 1, least=least)[0]

    def numbers_of(self, element: Element, count: int | None, *, least: float = -np.inf) -> list[float]:
        """Return the numbers in an element; ``count``: that many, or one for all; any number if None."""
        words = element.text.split()
        for word in words:
            if not _DECIMAL.fullmatch(word) or abs(float(word)) > MAX_VALUE:
                raise self.error(
                    "not a number of D-SI", "decimal digits with a point, such as 12.5 or 1e-3", element, word
                )
            if float(word) < least:
                raise self.error("the number is too small", f"at least {least:g}", element, word)
        if not words or (count is not None and len(words) not in (1, count)):
            raise self.error(
                f"{count_with_noun(len(words), 'number')} for {count_with_noun(count or 1, 'value')}",
                "one for each value, or one for all",
                element,
            )
        numbers = [float(word) for word in words]
        return numbers * (count or 1) if len(numbers) == 1 and count else numbers

    def length_unit(self, element: Element, text: str) -> float:
        match = _LENGTH_UNIT.fullmatch(text)
        if match is None or match[1] not in PREFIXES:
            raise self.error("the unit is no length of D-SI", r"\metre, \milli\metre or \micro\metre", element, text)
        return PREFIXES[match[1]]

    def area_unit(self, element: Element) -> float:
        match = _AREA_UNIT.fullmatch(element.text)
        if match is None or any(prefix not in PREFIXES for prefix in match.groups()):
            raise self.error("the unit is no square of a length", r"\milli\metre\tothe{2}", element, element.text)
        square = element.text.endswith("}")
        return PREFIXES[match[1]] * PREFIXES[match[1] if square else match[2]]

    def expansion(self) -> tuple[float, float] | None:
        """Return the coefficient of thermal expansion and its standard uncertainty, 1/K.

        None unless exactly one plausible value per kelvin is stated with an uncertainty.
        """
        found = set()
        for real in self.root.within():
            unit = _child(real, "unit") if _local(real) == "real" else None
            match = None if unit is None else _PER_KELVIN.fullmatch("".join(unit.text.split()))
            if match is None or match[1] not in PREFIXES:
                continue
            value, *u = (
                PREFIXES[match[1]] * one
                for one in (self.number_of(self.need(real, "value")), *self._uncertainties(real, 1))
            )
            if abs(value) <= MOST_EXPANSION:
                found.add((value, u[0] if u else 0.0))
        return found.pop() if len(found) == 1 and all(u > 0.0 for _, u in found) else None

    # Quantities

    def quantities(self) -> Iterator[Element]:
        """Yield the quantities of the results; those of conditions and equipment are no results."""
        for measured in self.need(self.root, "measurementResults").each(f"{DCC} measurementResult"):
            for result in self.need(measured, "results").each(f"{DCC} result"):
                waiting = [self.need(result, "data")]
                while waiting:
                    element = waiting.pop(0)
                    yield from element.each(f"{DCC} quantity")
                    waiting[:0] = element.each(f"{DCC} list")

    def read(self, quantity: Element, wanted: Collection[str]) -> _Quantity | None:
        """Return the values of a quantity with labels that name targets; None if it has none."""
        kind = _child(quantity, "realListXMLList", "real", "list", "hybrid")
        if kind is None:
            return None
        name = _local(kind)
        if name == "hybrid":
            kind = _child(kind, "realListXMLList", "real", "list") or kind
            name = _local(kind)
        if name == "list":
            kind = _child(kind, "realList")
            return None if kind is None else self._real_list(kind, wanted)
        if name == "real":
            called = _child(quantity, "name")
            default = "" if called is None else (_child(called, "content") or called).text
            return self._listed([kind], [default], kind, wanted)
        return self._xml_list(kind, wanted)

    def _real_list(self, listed: Element, wanted: Collection[str]) -> _Quantity | None:
        common = _child(listed, "listUnit"), _child(listed, "listUnivariateUnc")
        reals = listed.each(f"{SI} real")
        return self._listed(reals, [""] * len(reals), listed, wanted, *common)

    def _listed(
        self,
        reals: Sequence[Element],
        names: Sequence[str],
        whole: Element,
        wanted: Collection[str],
        unit: Element | None = None,
        uncertainty: Element | None = None,
    ) -> _Quantity | None:
        labels = [
            (_child(real, "label") or Element("", {}, 0)).text or name for real, name in zip(reals, names, strict=True)
        ]
        if not any(targets_of(label, wanted) for label in labels):
            return None
        statements = []
        covariance = None if whole in reals else self._covariance(whole, len(reals))
        for real, label in zip(reals, labels, strict=True):
            own = _child(real, "unit") or unit
            if own is None:
                raise self.error("unit is missing", r"a unit such as \milli\metre", real)
            scale = self.length_unit(own, own.text)
            u = self._uncertainties(real, 1) or ([] if uncertainty is None else self._uncertainties(uncertainty, 1))
            self._need_uncertainty(u, covariance, real)
            value = self.number_of(self.need(real, "value"))
            statements.append(_Statement(label, value * scale, u[0] * scale if u else np.nan, real.line))
        return _Quantity(tuple(statements), covariance, whole.line)

    def _xml_list(self, listed: Element, wanted: Collection[str]) -> _Quantity | None:
        labelled = _child(listed, "labelXMLList")
        labels = [] if labelled is None else labelled.text.split()
        if not any(targets_of(label, wanted) for label in labels):
            return None
        values = self.numbers_of(self.need(listed, "valueXMLList"), None)
        if len(values) != len(labels):
            raise self.error(
                f"{count_with_noun(len(values), 'value')} for {count_with_noun(len(labels), 'label')}",
                "one value for each label",
                self.need(listed, "valueXMLList"),
            )
        unit = self.need(listed, "unitXMLList")
        units = unit.text.split()
        if len(units) not in (1, len(values)):
            raise self.error(f"{len(units)} units for {len(values)} values", "one for each, or one for all", unit)
        scales = [self.length_unit(unit, text) for text in units] * (len(values) if len(units) == 1 else 1)
        u, covariance = self._uncertainties(listed, len(values)), self._covariance(listed, len(values))
        self._need_uncertainty(u, covariance, listed)
        statements = [
            _Statement(label, value * scale, own * scale, listed.line)
            for label, value, scale, own in zip(labels, values, scales, u or [np.nan] * len(values), strict=True)
        ]
        return _Quantity(tuple(statements), covariance, listed.line)

    def _need_uncertainty(self, u: Sequence[float], covariance: np.ndarray | None, element: Element) -> None:
        if not u and covariance is None:
            raise self.error(
                "states no uncertainty", "an expanded or standard uncertainty, or a covariance matrix", element
            )

    def _uncertainties(self, parent: Element, count: int) -> list[float]:
        """Return the standard uncertainties that stand in an element, in its unit; empty if it states none."""
        for child in parent.children:
            name = _local(child).removesuffix("XMLList")
            if name == "measurementUncertaintyUnivariate":
                return self._uncertainties(child, count)
            if name in ("expandedUnc", "expandedMU"):
                expanded = self._part(child, ("uncertainty", "valueExpandedMU"), count, 0.0)
                factor = self._part(child, ("coverageFactor",), count, 1.0)
                return [one / k for one, k in zip(expanded, factor, strict=True)]
            if name in ("coverageInterval", "standardMU", "coverageIntervalMU"):
                return self._part(child, ("standardUnc", "valueStandardMU"), count, 0.0)
        return []

    def _part(self, parent: Element, names: Sequence[str], count: int, least: float) -> list[float]:
        found = self.need(parent, *names, *(f"{name}XMLList" for name in names))
        return self.numbers_of(found, count, least=least)

    def _covariance(self, parent: Element, count: int) -> np.ndarray | None:
        """Return the (count, count) covariance matrix that stands in an element, m²; None if it states none."""
        region = next((c for c in parent.children if "Region" in _local(c) or "Multivariate" in _local(c)), None)
        if region is None:
            return None
        matrix = next((one for one in region.within() if _local(one) == "covarianceMatrix"), None)
        if matrix is None:
            raise self.error("covarianceMatrix is missing", "the covariance matrix of the region", region)
        columns = []
        for column in matrix.each(f"{SI} column"):
            entries = column.each(f"{SI} covariance")
            columns.append(
                [self.number_of(self.need(one, "value")) * self.area_unit(self.need(one, "unit")) for one in entries]
            )
        if {len(columns), *map(len, columns)} != {count}:
            raise self.error("the matrix has another size", f"{count} columns of {count} entries", matrix)
        covariance = np.array(columns)
        size = np.sqrt(np.abs(np.diag(covariance)))
        if np.any(np.abs(covariance - covariance.T) > 1e-6 * np.outer(size, size) + 1e-30):
            raise self.error("the matrix is not symmetric", "a symmetric covariance matrix", matrix)
        values = np.linalg.eigvalsh(covariance)
        if values[0] < -1e-9 * max(values[-1], 0.0) or values[-1] <= 0.0:
            raise self.error(
                "the matrix is no covariance: a combination has a negative variance", "a positive matrix", matrix
            )
        return covariance


def targets_of(label: str, targets: Collection[str]) -> tuple[str, str, str] | None:
    """Return the two targets of a distance and an empty text, or the target of a coordinate, an empty text and its letter.

    None if the label names none of the targets, or a single one of a distance.
    """
    for i, sign in enumerate(label):
        first, second = label[:i].strip(), label[i + 1 :].strip()
        if sign in "-–—/" and first != second and first in targets and second in targets:
            return first, second, ""
    match = _COORDINATE.fullmatch(label)
    if match is not None and match[1] in targets:
        return match[1], "", match[2].lower()
    return None


class _Used(NamedTuple):
    """The statements that are used, their covariance, m², and the number by which variances were multiplied."""

    statements: tuple[_Statement, ...]
    named: tuple[tuple[str, str, str], ...]
    covariance: np.ndarray
    enlarged: int


def _loaded(path: Path, targets: tuple[str, ...]) -> Artefact:
    reader = _Reader(path)
    read = [one for one in (reader.read(quantity, targets) for quantity in reader.quantities()) if one is not None]
    coordinates, distances = (_used(reader, read, targets, letters) for letters in ("xyz", ""))
    if coordinates.statements:
        artefact = _coordinates(reader, coordinates)
        _check_distances(reader, artefact, distances)
        return artefact
    if distances.statements:
        return _distances(reader, distances)
    results = reader.need(reader.root, "measurementResults")
    raise reader.error("no result names two of the table's targets", LABELS, results)


def _used(reader: _Reader, read: Sequence[_Quantity], targets: Collection[str], letters: str) -> _Used:
    """Return the statements of coordinates (``letters``: ``xyz``) or of distances (empty)."""
    statements: list[_Statement] = []
    named: list[tuple[str, str, str]] = []
    blocks: list[np.ndarray] = []
    for quantity in read:
        of = [targets_of(one.label, targets) for one in quantity.statements]
        keep = [i for i, one in enumerate(of) if one is not None and bool(one[2]) == bool(letters)]
        kept = [quantity.statements[i] for i in keep]
        u = np.array([one.u for one in kept])
        stated = quantity.covariance is not None
        block = quantity.covariance[np.ix_(keep, keep)] if quantity.covariance is not None else np.diag(u**2)
        for one, variance in zip(kept, np.diag(block), strict=True):
            _check_uncertainty(reader, one, float(np.sqrt(max(variance, 0.0))))
        statements += kept
        named += [ends for i in keep if (ends := of[i]) is not None]
        blocks += [block] if stated and len(block) else [np.array([[v]]) for v in np.diag(block)]
    _check_once(reader, statements, [frozenset(one) for one in named])
    enlarged = max(sum(bool(np.any(block)) for block in blocks), 1)
    return _Used(tuple(statements), tuple(named), block_diag(*blocks) * enlarged, enlarged)


def _check_uncertainty(reader: _Reader, one: _Statement, u: float) -> None:
    """Raise `InputError` for a value without uncertainty, or one that contradicts the covariance matrix.

    A zero that is exact by definition (the origin of the coordinates) needs none.
    """
    if np.isfinite(one.u) and abs(u - one.u) > AGREEMENT * one.u + SMALLEST_U_M:
        raise InputError(
            f"the uncertainty of {one.label} contradicts the covariance matrix",
            expected=f"the same standard uncertainty, not {one.u / UM:.4g} and {u / UM:.4g} µm",
            file=reader.path,
            line=one.line,
        )
    if u <= SMALLEST_U_M and one.value != 0.0:
        raise InputError(
            f"{one.label} has no uncertainty", expected="an uncertainty above zero", file=reader.path, line=one.line
        )


def _check_once(reader: _Reader, statements: Sequence[_Statement], keys: Sequence[object]) -> None:
    seen: dict[object, _Statement] = {}
    for key, one in zip(keys, statements, strict=True):
        if key in seen:
            raise InputError(
                f"{one.label} is stated twice: {seen[key].value / MM:.6f} mm in line {seen[key].line} and {one.value / MM:.6f} mm",
                expected="one value; their correlation would not be known",
                file=reader.path,
                line=one.line,
            )
        seen[key] = one


def _coordinates(reader: _Reader, used: _Used) -> Artefact:
    at = {(name, letter): i for i, (name, _, letter) in enumerate(used.named)}
    names = tuple(dict.fromkeys(name for name, _ in at))
    for name in names:
        missing = [letter for letter in "xyz" if (name, letter) not in at]
        if missing:
            one = used.statements[next(i for (other, _), i in at.items() if other == name)]
            raise InputError(
                f"sphere {name} has no {' and no '.join(missing)}",
                expected="x, y and z",
                file=reader.path,
                line=one.line,
            )
    rows = [at[name, letter] for name in names for letter in "xyz"]
    value = np.array([used.statements[i].value for i in rows]).reshape(-1, 3)
    line = used.statements[0].line
    if len(names) < 2 or np.linalg.norm(value - value[0], axis=1).max() == 0.0:
        raise InputError(
            "no two spheres of the certificate are in the table", expected=LABELS, file=reader.path, line=line
        )
    covariance = used.covariance[np.ix_(rows, rows)]
    shape = shape_contrasts(value)
    _check_certain(reader, shape.T @ covariance @ shape, line)
    pairs = read_only(np.zeros((0, 2), dtype=int))
    return _artefact(reader, used, names, pairs, read_only(value), read_only(covariance))


def _artefact(
    reader: _Reader, used: _Used, names: tuple[str, ...], pairs: np.ndarray, value: np.ndarray, covariance: np.ndarray
) -> Artefact:
    of = str(reader.path), reader.number, reader.item
    return Artefact(*of, names, pairs, value, covariance, used.enlarged, reader.expansion())


def _distances(reader: _Reader, used: _Used) -> Artefact:
    for one in used.statements:
        if one.value <= 0.0:
            raise InputError(
                f"the distance {one.label} is not positive",
                expected="a length",
                file=reader.path,
                line=one.line,
                value=one.value / MM,
            )
    names = tuple(dict.fromkeys(name for first, second, _ in used.named for name in (first, second)))
    pairs = np.array([[names.index(first), names.index(second)] for first, second, _ in used.named])
    _check_certain(reader, used.covariance, used.statements[0].line)
    _check_triangles(reader, used, pairs)
    value = read_only(np.array([one.value for one in used.statements]))
    return _artefact(reader, used, names, read_only(pairs), value, read_only(used.covariance))


def _check_certain(reader: _Reader, covariance: np.ndarray, line: int) -> None:
    values = np.linalg.eigvalsh(covariance)
    if values[0] <= LEAST_EIGENVALUE * values[-1]:
        raise InputError(
            "the covariance matrix is singular: a combination of the values is stated without uncertainty",
            expected="a covariance matrix of full rank",
            file=reader.path,
            line=line,
        )


def _check_triangles(reader: _Reader, used: _Used, pairs: np.ndarray) -> None:
    """Raise `InputError` for a distance that is longer than the way over a third sphere."""
    at = {frozenset(pair): i for i, pair in enumerate(pairs.tolist())}
    for names in combinations(range(int(pairs.max()) + 1), 3):
        rows = [i for i in (at.get(frozenset(pair)) for pair in combinations(names, 2)) if i is not None]
        for long in range(3) if len(rows) == 3 else ():
            sign = np.where(np.arange(3) == long, 1.0, -1.0)
            excess = float(sign @ [used.statements[i].value for i in rows])
            if excess > CONTRADICTION * np.sqrt(sign @ used.covariance[np.ix_(rows, rows)] @ sign):
                one = used.statements[rows[long]]
                raise InputError(
                    f"distances contradict each other: {one.label} is {excess / MM:.6f} mm longer than the way over the third sphere",
                    expected="distances that a triangle can have",
                    file=reader.path,
                    line=one.line,
                )


def _check_distances(reader: _Reader, artefact: Artefact, distances: _Used) -> None:
    """Raise `InputError` if a distance contradicts the coordinates; distances are not used beside these."""
    for k, (one, (first, second, _)) in enumerate(zip(distances.statements, distances.named, strict=True)):
        if first not in artefact.targets or second not in artefact.targets:
            continue
        i, j = artefact.targets.index(first), artefact.targets.index(second)
        between = artefact.value[i] - artefact.value[j]
        length = float(np.linalg.norm(between))
        by = np.zeros(artefact.value.size)
        by[3 * i : 3 * i + 3], by[3 * j : 3 * j + 3] = between / length, -between / length
        if abs(one.value - length) > CONTRADICTION * np.sqrt(
            by @ artefact.covariance @ by + distances.covariance[k, k]
        ):
            raise InputError(
                f"the distance {one.label} contradicts the coordinates: {one.value / MM:.6f} and {length / MM:.6f} mm",
                expected="the same distance",
                file=reader.path,
                line=one.line,
            )
