"""Digital calibration certificates (PTB's DCC 3.1.2 with D-SI 2.1 units) of a calibration and of an evaluation of standard tests.

The schema demands who calibrated what for whom (entry `dcc` of the job); nothing of it is invented. Results are those of the file that
was read or of the tests that were evaluated, with expanded uncertainties (95 %) and, where it is known, the covariance matrix.
The text is read back before it is returned. It carries no electronic signature, and says so.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Final, NamedTuple, final
from xml.etree import ElementTree

import numpy as np

from twin._common.distributions import chi2_isf
from twin._common.errors import InputError
from twin._common.provenance import SourceWarning, warning_texts
from twin._common.xml_files import parse_xml
from twin.display.numbers import COVERAGE_FACTOR
from twin.display.sheet import CertificateFacts, Contact, Job
from twin.measurement.certificate import DCC, SI
from twin.model.calibration import Calibration
from twin.model.effects import split_name, unit_of
from twin.model.motion_curve import Curve
from twin.standards import EvaluationResult
from twin.standards.iso230_2 import Positioning
from twin.standards.result import StandardTest, StandardValue, ToleranceCheck

VERSION: Final = "3.1.2"
PROBABILITY: Final = 0.95
POSITIONS: Final = 11
"""Number of positions, from end to end, at which an error motion is stated."""
UNITS: Final = {
    "um": r"\micro\metre",
    "urad": r"\micro\radian",
    "mm": r"\milli\metre",
    "deg": r"\degree",
    "K": r"\kelvin",
    "um/K": r"\micro\metre\kelvin\tothe{-1}",
    "urad/K": r"\micro\radian\kelvin\tothe{-1}",
}
"""Units of D-SI."""
UNSIGNED: Final = (
    "This file carries no electronic signature, seal or time stamp. It becomes a certificate when a responsible person signs it; "
    "the program that wrote it certifies nothing."
)
COVERAGE_STATEMENT: Final = (
    f"An expanded uncertainty is the standard uncertainty multiplied by k = {COVERAGE_FACTOR:.2f}, for a normal "
    "distribution a coverage probability of 95 % (JCGM 100). It holds for the conditions and the time of the measurement; "
    "long-term changes are not in it."
)
DECISION: Final = (
    "Decision rule: ISO 14253-1. Conformity is proven if the value enlarged by its expanded uncertainty (95 %) is within the "
    "tolerance, nonconformity if the value diminished by it is outside; between the two, conditionalPass and conditionalFail "
    "say on which side of the tolerance the value itself lies."
)
RANK: Final = 1e-9
"""Eigenvalue of a covariance relative to its largest below which a combination has no variance."""
CONFORMITY: Final[Mapping[tuple[str, bool], str]] = {
    ("conforming", True): "pass",
    ("nonconforming", False): "fail",
    ("neither", True): "conditionalPass",
    ("neither", False): "conditionalFail",
}
"""The schema's words for decisions by ISO 14253-1: conditional where the margin is within U."""


class _Facts(NamedTuple):
    """A job, and the facts in it that the schema demands."""

    job: Job
    dcc: CertificateFacts


def facts_of(job: Job | None, job_file: Path | None) -> _Facts:
    """Return the facts that the schema demands.

    Raises `InputError`: one of them is missing, or they contradict each other.
    """
    if job is None or job.dcc is None:
        raise InputError(
            "a certificate must state who calibrated what for whom: `dcc` is missing",
            expected="a job file with an entry `dcc` (number, country, begin, end, performed_at, manufacturer, laboratory, customer, "
            "responsible)",
            file=job_file,
            setting="job",
        )
    if not job.serial_number:
        raise InputError(
            "`serial_number` is missing",
            expected="the machine's serial number, which identifies the calibrated item",
            file=job_file,
        )
    if job.dcc.end < job.dcc.begin:
        raise InputError(
            "`dcc.end` is before `dcc.begin`", expected=f"{job.dcc.begin} or later", file=job_file, value=job.dcc.end
        )
    if job.customer and job.customer != job.dcc.customer.name:
        raise InputError(
            "`customer` and `dcc.customer.name` differ",
            expected=job.dcc.customer.name,
            file=job_file,
            value=job.customer,
        )
    return _Facts(job, job.dcc)


# --- Writing ---------------------------------------------------------------------------------------


def _element(parent: ElementTree.Element, name: str, text: str = "") -> ElementTree.Element:
    element = ElementTree.SubElement(parent, name)
    if text:
        element.text = text
    return element


def _content(parent: ElementTree.Element, name: str, *texts: str) -> None:
    element = _element(parent, name)
    for text in texts:
        _element(element, "dcc:content", text).set("lang", "en")


def _number(value: float) -> str:
    return f"{value:.12g}"


def _standard(covariance: np.ndarray) -> np.ndarray:
    """Return (n,) standard uncertainties; rounding may leave a variance of zero below it."""
    return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)))


def _numbers(values: np.ndarray) -> str:
    return " ".join(_number(float(value)) for value in values)


@final
@dataclass(frozen=True)
class CertifiedValues:
    """A list of values of one quantity.

    Attributes:
        name: what they are, in words.
        labels: (n,) name of each, without blanks.
        values: (n,).
        units: (n,) ``um``, ``urad``, ``mm`` or ``deg``.
        u: (n,) standard uncertainties, all known; empty if unknown.
        covariance: (n, n); None if unknown.
    """

    name: str
    labels: tuple[str, ...]
    values: np.ndarray
    units: tuple[str, ...]
    u: np.ndarray
    covariance: np.ndarray | None = None

    def write(self, parent: ElementTree.Element) -> ElementTree.Element:
        """Append the quantity to an element, and return it."""
        quantity = _element(parent, "dcc:quantity")
        _content(quantity, "dcc:name", self.name)
        listed = _element(quantity, "si:realListXMLList")
        _element(listed, "si:labelXMLList", " ".join(self.labels))
        _element(listed, "si:valueXMLList", _numbers(self.values))
        _element(listed, "si:unitXMLList", " ".join(UNITS[unit] for unit in self.units))
        if len(self.u):
            uncertainty = _element(listed, "si:expandedUncXMLList")
            _element(uncertainty, "si:uncertaintyXMLList", _numbers(COVERAGE_FACTOR * self.u))
            _element(uncertainty, "si:coverageFactorXMLList", " ".join([_number(COVERAGE_FACTOR)] * len(self.u)))
            _element(uncertainty, "si:coverageProbabilityXMLList", " ".join([_number(PROBABILITY)] * len(self.u)))
        if self.covariance is not None and len(self.values) > 1:
            self._write_covariance(listed, self.covariance)
        return quantity

    def _write_covariance(self, listed: ElementTree.Element, covariance: np.ndarray) -> None:
        region = _element(listed, "si:ellipsoidalRegionXMLList")
        matrix = _element(region, "si:covarianceMatrix")
        for j, second in enumerate(self.units):
            column = _element(matrix, "si:column")
            for i, first in enumerate(self.units):
                entry = _element(column, "si:covariance")
                _element(entry, "si:value", _number(float(covariance[i, j])))
                square = UNITS[first] + r"\tothe{2}" if first == second else UNITS[first] + UNITS[second]
                _element(entry, "si:unit", square)
        # A region of as many dimensions as combinations with variance: a curve at 11 positions has those of its coefficients.
        size = np.where(_standard(covariance) > 0.0, _standard(covariance), 1.0)
        strength = np.linalg.eigvalsh(covariance / np.outer(size, size))
        rank = max(int(np.count_nonzero(strength > RANK * strength[-1])), 1)
        _element(region, "si:coverageFactor", _number(float(np.sqrt(chi2_isf(1.0 - PROBABILITY, rank)))))
        _element(region, "si:coverageProbability", _number(PROBABILITY))


@final
@dataclass(frozen=True)
class CertifiedResult:
    """One result: a title, remarks, its values, and decisions on conformity.

    ``checks``: tolerances that were asked for, with the decision.
    """

    name: str
    remarks: tuple[str, ...]
    values: tuple[CertifiedValues, ...]
    checks: tuple[ToleranceCheck, ...] = ()

    def write(self, parent: ElementTree.Element) -> None:
        """Append the result to an element."""
        result = _element(parent, "dcc:result")
        _content(result, "dcc:name", self.name)
        if self.remarks:
            _content(result, "dcc:description", *self.remarks)
        data = _element(result, "dcc:data")
        for values in self.values:
            quantity = values.write(data)
            checks = [check for check in self.checks if check.value is not None and check.value.key in values.labels]
            if checks:
                about = _element(quantity, "dcc:measurementMetaData")
                for check in checks:
                    _write_check(about, check)


def _write_check(parent: ElementTree.Element, check: ToleranceCheck) -> None:
    about = _element(parent, "dcc:metaData")
    _element(about, "dcc:norm", "ISO 14253-1")
    _content(about, "dcc:declaration", check.text)
    conformity = CONFORMITY.get((check.conformity, check.met))
    if conformity is not None:
        _element(about, "dcc:conformity", conformity)


def calibration_certificate(calibration: Calibration, job: Job | None, job_file: Path | None) -> str:
    """Return the certificate of a calibration, XML.

    ``job``: facts of the test, read from ``job_file``.

    Raises `InputError`: a calibration that is not measured or not settled; a fact that the schema demands is missing.
    """
    facts = facts_of(job, job_file)
    if calibration.illustrative:
        raise InputError(
            "an illustrative calibration has no certificate: its numbers were not measured",
            expected="a calibration that twin identify wrote",
            file=calibration.path,
        )
    calibration.check_settled()
    results = tuple(_results_of(calibration))
    if not results:
        raise InputError("no error to certify", expected="a calibration with errors", file=calibration.path)
    method = (
        "Geometric errors by ISO 230-1 names, identified by least squares from measured points",
        calibration.source,
        f"datum: {calibration.datum}",
        *([calibration.misfit.says] if calibration.misfit is not None else []),
    )
    absent = [
        f"{error.name} was not determined by the measurement: {error.text}" for error in calibration.not_identifiable
    ]
    extra = [effect.name for effect in calibration.extra]
    absent += [f"Not in this certificate, but in the calibration: {', '.join(extra)}"] if extra else []
    absent += ["Covariances between different error motions are in the calibration file, not in this certificate."]
    statements = (*_warnings(calibration.warnings), *absent)
    instruments = calibration.instruments
    return _certificate(facts, calibration.machine.name, ("ISO 230-1", method), statements, results, instruments)


def evaluation_certificate(evaluation: EvaluationResult, job: Job | None, job_file: Path | None) -> str:
    """Return the certificate of an evaluation of standard tests, XML.

    ``job``: facts of the test, read from ``job_file``.

    Raises `InputError`: no test was evaluated; a fact that the schema demands is missing.
    """
    facts = facts_of(job, job_file)
    results = tuple(_result_of(test, evaluation.checks) for test in evaluation.tests)
    results = tuple(result for result in results if result.values)
    if not results:
        raise InputError(
            "no test to certify", expected="a table with the runs of a standard test", file=evaluation.data.source
        )
    uncertainty = (
        f"Uncertainty: {evaluation.uncertainty}; that of the readings alone"
        if evaluation.uncertainty
        else "The uncertainty of the readings is unknown: no value has an uncertainty, and conformity is not proven"
    )
    statements = (
        *_warnings(evaluation.warnings),
        uncertainty,
        *evaluation.assumptions,
        *(f"Not evaluated: {one.test}: {one.why}" for one in evaluation.not_evaluated),
        *(check.text for check in evaluation.checks if check.value is None),
    )
    if evaluation.checks:
        statements = (DECISION, *statements)
    method = "ISO 230", ("Standard tests evaluated from a table of readings", evaluation.data.source)
    return _certificate(facts, evaluation.machine, method, statements, results, ())


def _warnings(warnings: Sequence[SourceWarning]) -> tuple[str, ...]:
    return warning_texts(warnings)


def _results_of(calibration: Calibration) -> Iterator[CertifiedResult]:
    constants = {**calibration.squareness, **calibration.location}
    known = tuple(name for name in constants if name in calibration.covariance.names)
    unknown = tuple(name for name in constants if name not in known)
    quantities = []
    if known:
        covariance = calibration.covariance.of(list(known)).matrix
        quantities.append(_constants("squareness and locations", known, constants, covariance))
    if unknown:
        quantities.append(_constants("squareness and locations, uncertainty unknown", unknown, constants, None))
    if quantities:
        yield CertifiedResult("Squareness errors and locations of rotary axes", (), tuple(quantities))
    for curve in calibration.curves.values():
        yield CertifiedResult(f"Error motion {curve.name}", (f"{curve.brief}",), _curve(calibration, curve))


def _constants(
    name: str, names: tuple[str, ...], values: Mapping[str, float], covariance: np.ndarray | None
) -> CertifiedValues:
    return CertifiedValues(
        name,
        names,
        np.array([values[one] for one in names]),
        tuple(unit_of(one) for one in names),
        np.zeros(0) if covariance is None else _standard(covariance),
        covariance,
    )


def _curve(calibration: Calibration, curve: Curve) -> tuple[CertifiedValues, CertifiedValues]:
    """Return the positions of an error motion, and its values there."""
    positions = np.linspace(*curve.domain, POSITIONS)
    axis = calibration.machine.by_name[split_name(curve.name)[2]]
    count = len(curve.coefficients)
    names = [f"{curve.name}[{k}]" for k in range(count)]
    covariance = None
    if set(names) <= set(calibration.covariance.names):
        unit = np.eye(count)
        matrix = np.stack([curve.family.value(positions, curve.domain, tuple(row)) for row in unit], axis=1)
        covariance = matrix @ calibration.covariance.of(names).matrix @ matrix.T
    at = tuple(f"{curve.name}@{k + 1}" for k in range(POSITIONS))
    where = ("mm" if axis.linear else "deg",) * POSITIONS
    u = np.zeros(0) if covariance is None else _standard(covariance)
    values = CertifiedValues(curve.name, at, curve(positions), (curve.unit,) * POSITIONS, u, covariance)
    return CertifiedValues(f"position of {axis.name}", at, positions, where, np.zeros(0)), values


def _result_of(test: StandardTest, checks: Sequence[ToleranceCheck]) -> CertifiedResult:
    known = [value for value in test.values if np.isfinite(value.value)]
    quantities = tuple(
        _standard_values(name, [value for value in known if bool(np.isfinite(value.u)) == with_u])
        for name, with_u in (("values", True), ("values, uncertainty unknown", False))
        if any(bool(np.isfinite(value.u)) == with_u for value in known)
    )
    if isinstance(test.detail, Positioning):
        quantities += _targets(test.detail)
    title = f"{test.title} ({test.place})" if test.place else test.title
    own = tuple(check for check in checks if check.test == title)
    meanings = (f"{value.key}: {value.meaning}" for value in known)
    return CertifiedResult(title, (test.standard, *meanings, *test.remarks), quantities, own)


def _standard_values(name: str, values: Sequence[StandardValue]) -> CertifiedValues:
    u = np.array([value.u for value in values])
    return CertifiedValues(
        name,
        tuple(value.key for value in values),
        np.array([value.value for value in values]),
        tuple(value.unit for value in values),
        u if np.isfinite(u).all() else np.zeros(0),
    )


def _targets(test: Positioning) -> tuple[CertifiedValues, ...]:
    """Return the table of a positioning test by target: ISO 230-2, 3.10 to 3.15."""
    count = len(test.target)
    at = tuple(f"P{i + 1}" for i in range(count))
    columns = {
        "mean unidirectional deviation, positive approach": test.mean_forward,
        "mean unidirectional deviation, negative approach": test.mean_backward,
        "reversal error": test.B_i,
        "estimator s, positive approach": test.s_i_forward,
        "estimator s, negative approach": test.s_i_backward,
    }
    places = CertifiedValues("target position", at, test.target, (test.target_unit,) * count, np.zeros(0))
    return (
        places,
        *(
            CertifiedValues(name, at, values, (test.unit,) * count, np.zeros(0))
            for name, values in columns.items()
            if np.isfinite(values).all()
        ),
    )


def _certificate(
    facts: _Facts,
    machine: str,
    method: tuple[str, Sequence[str]],
    statements: Sequence[str],
    results: Sequence[CertifiedResult],
    instruments: Sequence[str],
) -> str:
    root = ElementTree.Element("dcc:digitalCalibrationCertificate")
    root.attrib |= {"xmlns:dcc": DCC, "xmlns:si": SI, "schemaVersion": VERSION}
    _administrative(_element(root, "dcc:administrativeData"), facts, machine, statements)
    measured = _element(_element(root, "dcc:measurementResults"), "dcc:measurementResult")
    _content(measured, "dcc:name", "Geometric accuracy of a machine tool")
    norm, texts = method
    used = _element(_element(measured, "dcc:usedMethods"), "dcc:usedMethod")
    _content(used, "dcc:name", texts[0])
    _content(used, "dcc:description", *texts[1:])
    _element(used, "dcc:norm", norm)
    _equipment(measured, facts.job, instruments)
    _conditions(measured, facts)
    listed = _element(measured, "dcc:results")
    for result in results:
        result.write(listed)
    ElementTree.indent(root, space="  ")
    text = '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
    _check_copy(text, results)
    return text


CONDITIONS: Final[Mapping[str, tuple[str, str]]] = {
    "air_temperature_degC": ("air temperature", r"\degreecelsius"),
    "machine_temperature_degC": ("temperature of the machine", r"\degreecelsius"),
    "humidity_percent": ("relative humidity of the air", r"\percent"),
    "pressure_hPa": ("air pressure", r"\hecto\pascal"),
}
"""Name and D-SI unit of each entry of `AmbientConditions`."""


def _conditions(measured: ElementTree.Element, facts: _Facts) -> None:
    """Append the conditions of the measurement: the stated text, and lowest and highest value of each stated quantity."""
    spans = {name: span for name, span in facts.dcc.conditions.model_dump().items() if span is not None}
    if not (facts.job.temperature or spans):
        return
    listed = _element(measured, "dcc:influenceConditions")
    if facts.job.temperature:
        condition = _element(listed, "dcc:influenceCondition")
        _content(condition, "dcc:name", "temperature and conditions, as stated")
        quantity = _element(_element(condition, "dcc:data"), "dcc:quantity")
        _content(quantity, "dcc:noQuantity", facts.job.temperature)
    for name, span in spans.items():
        condition = _element(listed, "dcc:influenceCondition")
        words, unit = CONDITIONS[name]
        _content(condition, "dcc:name", words)
        data = _element(condition, "dcc:data")
        for which, value in zip(("lowest", "highest"), span, strict=True):
            quantity = _element(data, "dcc:quantity")
            _content(quantity, "dcc:name", which)
            real = _element(quantity, "si:real")
            _element(real, "si:value", _number(value))
            _element(real, "si:unit", unit)


def _administrative(about: ElementTree.Element, facts: _Facts, machine: str, statements: Sequence[str]) -> None:
    dcc, job = facts.dcc, facts.job
    software = _element(_element(about, "dcc:dccSoftware"), "dcc:software")
    _content(software, "dcc:name", "twin")
    _element(software, "dcc:release", metadata.version("twin"))
    _core_data(about, dcc)
    _item(about, facts, machine)
    _contact(_element(_element(about, "dcc:calibrationLaboratory"), "dcc:contact"), dcc.laboratory)
    persons = _element(about, "dcc:respPersons")
    for person in dcc.responsible:
        entry = _element(persons, "dcc:respPerson")
        _content(_element(entry, "dcc:person"), "dcc:name", person.name)
        if person.role:
            _element(entry, "dcc:role", person.role)
        _element(entry, "dcc:cryptElectronicSignature", "false")
    _contact(_element(about, "dcc:customer"), dcc.customer)
    measured_by = [f"measured by {job.operator}"] if job.operator else []
    _statements(about, dcc, (UNSIGNED, COVERAGE_STATEMENT, *measured_by, *statements))


def _core_data(about: ElementTree.Element, dcc: CertificateFacts) -> None:
    core = _element(about, "dcc:coreData")
    for name, text in (
        ("countryCodeISO3166_1", dcc.country),
        ("usedLangCodeISO639_1", "en"),
        ("mandatoryLangCodeISO639_1", "en"),
        ("uniqueIdentifier", dcc.number),
        *([("identifications", dcc.order_number)] if dcc.order_number else []),
        *([("receiptDate", dcc.received.isoformat())] if dcc.received else []),
        ("beginPerformanceDate", dcc.begin.isoformat()),
        ("endPerformanceDate", dcc.end.isoformat()),
        ("performanceLocation", dcc.performed_at),
    ):
        if name == "identifications":
            _identification(core, text, "customer", "order number")
        else:
            _element(core, f"dcc:{name}", text)


def _item(about: ElementTree.Element, facts: _Facts, machine: str) -> None:
    dcc, job = facts.dcc, facts.job
    item = _element(_element(about, "dcc:items"), "dcc:item")
    _content(item, "dcc:name", job.machine or machine)
    if job.place:
        _content(item, "dcc:description", f"place: {job.place}")
    _content(_element(item, "dcc:manufacturer"), "dcc:name", dcc.manufacturer)
    if dcc.model:
        _element(item, "dcc:model", dcc.model)
    identified = _identification(item, job.serial_number)
    if dcc.inventory_number:
        _identification(item, dcc.inventory_number, "customer", "inventory number", identified)


def _statements(about: ElementTree.Element, dcc: CertificateFacts, texts: Sequence[str]) -> None:
    stated = _element(about, "dcc:statements")
    if dcc.accreditation:
        statement = _element(stated, "dcc:statement")
        _element(statement, "dcc:norm", "ISO/IEC 17025")
        _element(statement, "dcc:reference", dcc.accreditation)
        _content(statement, "dcc:declaration", f"accreditation of the laboratory, as stated: {dcc.accreditation}")
    if dcc.traceability:
        statement = _element(stated, "dcc:statement")
        _element(statement, "dcc:traceable", "true")
        _content(statement, "dcc:declaration", f"traceability, as stated: {dcc.traceability}")
    for text in texts:
        _content(_element(stated, "dcc:statement"), "dcc:declaration", text)


def _identification(
    parent: ElementTree.Element,
    number: str,
    issuer: str = "manufacturer",
    name: str = "serial number",
    listed: ElementTree.Element | None = None,
) -> ElementTree.Element:
    """Append an identification to a list of them, a new one unless given; return the list."""
    listed = _element(parent, "dcc:identifications") if listed is None else listed
    one = _element(listed, "dcc:identification")
    _element(one, "dcc:issuer", issuer)
    _element(one, "dcc:value", number)
    _content(one, "dcc:name", name)
    return listed


def _contact(contact: ElementTree.Element, of: Contact) -> None:
    _content(contact, "dcc:name", of.name)
    _element(contact, "dcc:eMail", of.email)
    location = _element(contact, "dcc:location")
    for name, text in (
        ("street", of.street),
        ("postCode", of.post_code),
        ("city", of.city),
        ("countryCode", of.country),
    ):
        if text:
            _element(location, f"dcc:{name}", text)


def _equipment(measured: ElementTree.Element, job: Job, instruments: Sequence[str]) -> None:
    names = (job.instrument,) if job.instrument else tuple(instruments)
    if not names:
        return
    listed = _element(measured, "dcc:measuringEquipments")
    for name in names:
        equipment = _element(listed, "dcc:measuringEquipment")
        _content(equipment, "dcc:name", name)
        if job.instrument and job.certificate:
            _content(equipment, "dcc:description", f"calibration certificate, as stated: {job.certificate}")
        if job.instrument and job.instrument_serial:
            _identification(equipment, job.instrument_serial)


def _check_copy(text: str, results: Sequence[CertifiedResult]) -> None:
    """Raise `InputError` unless the text is XML with every number that was meant to be in it."""
    root = parse_xml(text, Path("certificate"), "a certificate", namespaces=True)
    found = [
        [float(word) for word in element.text.split()]
        for element in root.within()
        if element.name in (f"{SI} valueXMLList", f"{SI} uncertaintyXMLList")
    ]
    meant: list[np.ndarray] = []
    for values in (values for result in results for values in result.values):
        meant += [values.values, *([COVERAGE_FACTOR * values.u] if len(values.u) else [])]
    same = len(found) == len(meant) and all(
        len(a) == len(b) and np.allclose(a, b, rtol=1e-11, atol=0.0) for a, b in zip(found, meant, strict=True)
    )
    if not same:
        raise InputError(
            "the certificate could not be read back", expected="a certificate with the numbers of its results"
        )
