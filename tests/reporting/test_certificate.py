"""Certificates that twin writes: valid by the published schema, and every number read back by another XML library."""

from __future__ import annotations

import json
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import xmlschema
import yaml
from scipy import stats

from tests.cli.commands import refused, status
from twin._common.errors import InputError
from twin.display.sheet import load_job
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.numerics.covariance import Covariance
from twin.reporting.certificate import calibration_certificate

SCHEMA = Path(__file__).parent / "dcc_schema"
NS = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
JOB = {
    "schema": "twin.job/1",
    "machine": "DMU 50 & friends",
    "serial_number": "1150-07",
    "instrument": "laser <tracker>",
    "instrument_serial": "AT-9",
    "certificate": "T-12/2026",
    "temperature": "20.4 to 20.9 °C",
    "dcc": {
        "number": "M-7/2026",
        "country": "NO",
        "begin": "2026-11-27",
        "end": "2026-11-28",
        "performed_at": "customer",
        "manufacturer": "DMG MORI",
        "laboratory": {
            "name": "Lab",
            "email": "lab@example.org",
            "city": "Trondheim",
            "street": "Gate 1",
            "country": "NO",
        },
        "customer": {"name": "Shop", "email": "shop@example.org", "city": "Oslo", "post_code": "0150"},
        "responsible": [{"name": "A. Person", "role": "head of the laboratory"}],
    },
}


@pytest.fixture(scope="module")
def schema() -> xmlschema.XMLSchema:
    local = {"https://ptb.de/si/v2.1.0/SI_Format.xsd": str(SCHEMA / "SI_Format.xsd")}
    return xmlschema.XMLSchema(SCHEMA / "dcc.xsd", uri_mapper=lambda uri: local.get(uri, uri), allow="local")


@pytest.fixture
def job(tmp_path: Path) -> Path:
    (tmp_path / "job.yaml").write_text(yaml.safe_dump(JOB, allow_unicode=True), encoding="utf-8")
    return tmp_path / "job.yaml"


def quantities(path: Path) -> list[dict[str, Any]]:
    """Return every list of values of a certificate: labels, values, units, u and covariance."""
    found = []
    for quantity in ElementTree.parse(path).getroot().iterfind(".//dcc:result//dcc:quantity", NS):
        listed = quantity.find("si:realListXMLList", NS)
        assert listed is not None

        def words(name: str, of: ElementTree.Element = listed) -> list[str]:
            return (of.findtext(f".//si:{name}XMLList", "", NS)).split()

        k = np.array(words("coverageFactor"), dtype=float)
        columns = listed.findall(".//si:column", NS)
        found.append(
            {
                "name": quantity.findtext("dcc:name/dcc:content", "", NS),
                "labels": words("label"),
                "values": np.array(words("value"), dtype=float),
                "units": words("unit"),
                "u": np.array(words("uncertainty"), dtype=float) / k if len(k) else np.zeros(0),
                "covariance": np.array(
                    [[float(v.text or "") for v in c.iterfind("si:covariance/si:value", NS)] for c in columns]
                ),
                "covariance units": [[v.text for v in c.iterfind("si:covariance/si:unit", NS)] for c in columns],
            }
        )
    return found


def declarations(path: Path) -> str:
    root = ElementTree.parse(path).getroot()
    return "\n".join(e.text or "" for e in root.iterfind(".//dcc:statement/dcc:declaration/dcc:content", NS))


MINE = """schema: twin.calibration/1
machine: DMU 50 eVolution
source: identified by twin from measured.csv
simulated: true
curves:
  E_XX: {unit: um, domain: [0, 500], basis: power, coefficients: [1.0, 11.4, 2.0]}
  E_CB: {unit: urad, domain: [0, 180], basis: power, coefficients: [0.0, 3.5]}
squareness: {E_C0Y: 41.5, E_B0Z: -3.25}
location: {E_X0C: 12.0}
not_identifiable: [{name: E_X0B, why: B's own place}]
"""
NAMES = ("E_XX[0]", "E_XX[1]", "E_XX[2]", "E_C0Y", "E_X0C")
ROOT = np.random.default_rng(1).normal(0.0, 0.3, (5, 5))


@pytest.fixture
def mine(tmp_path: Path, dmu50: Machine) -> Path:
    """A calibration in which E_CB and E_B0Z have no uncertainty."""
    path = tmp_path / "mine.yaml"
    path.write_text(MINE)
    replace(Calibration.load(path, dmu50), joint=Covariance(NAMES, ROOT @ ROOT.T)).save(path)
    return path


@pytest.fixture
def out(tmp_path: Path, mine: Path, job: Path, dmu50: Machine) -> Path:
    """The certificate of that calibration."""
    path = tmp_path / "mine.xml"
    path.write_text(calibration_certificate(Calibration.load(mine, dmu50), load_job(job), job), encoding="utf-8")
    return path


FURTHER = {
    "model": "eVolution",
    "inventory_number": "M-17",
    "order_number": "4500123",
    "received": "2026-11-26",
    "accreditation": "D-K-15018-01-00",
    "traceability": "PTB length standards through T-12/2026",
    "conditions": {"air_temperature_degC": [20.4, 20.9], "humidity_percent": [38, 41.5], "pressure_hPa": [1002, 1004]},
}


def test_what_a_laboratory_must_state(tmp_path: Path, mine: Path, dmu50: Machine, schema: xmlschema.XMLSchema) -> None:
    """Item, order, place, operator, conditions, accreditation and traceability stand where the schema has a place for them."""
    job = tmp_path / "full.yaml"
    facts = {**JOB, "place": "hall 3", "operator": "M. Muster", "dcc": {**JOB["dcc"], **FURTHER}}  # type: ignore[dict-item]
    job.write_text(yaml.safe_dump(facts, allow_unicode=True), encoding="utf-8")
    path = tmp_path / "full.xml"
    path.write_text(calibration_certificate(Calibration.load(mine, dmu50), load_job(job), job), encoding="utf-8")
    schema.validate(path)
    root = ElementTree.parse(path).getroot()

    def text(where: str) -> str | None:
        return root.findtext(f".//{where}", None, NS)

    core = "dcc:coreData/"
    assert (
        text(f"{core}dcc:receiptDate") == "2026-11-26" and text(f"{core}dcc:identifications/*/dcc:value") == "4500123"
    )
    assert text("dcc:item/dcc:model") == "eVolution" and text("dcc:item/dcc:description/dcc:content") == "place: hall 3"
    item = [
        (one.findtext("dcc:issuer", "", NS), one.findtext("dcc:value", "", NS))
        for one in root.iterfind(".//dcc:item/dcc:identifications/dcc:identification", NS)
    ]
    assert item == [("manufacturer", "1150-07"), ("customer", "M-17")]
    conditions = {
        one.findtext("dcc:name/dcc:content", "", NS): [
            (real.findtext("si:value", "", NS), real.findtext("si:unit", "", NS))
            for real in one.iterfind(".//si:real", NS)
        ]
        for one in root.iterfind(".//dcc:influenceCondition", NS)
    }
    assert conditions["air temperature"] == [("20.4", r"\degreecelsius"), ("20.9", r"\degreecelsius")]
    assert conditions["relative humidity of the air"] == [("38", r"\percent"), ("41.5", r"\percent")]
    assert conditions["air pressure"] == [("1002", r"\hecto\pascal"), ("1004", r"\hecto\pascal")]
    assert conditions["temperature and conditions, as stated"] == []
    assert text("dcc:statement[dcc:norm='ISO/IEC 17025']/dcc:reference") == "D-K-15018-01-00"
    traced = text("dcc:statement[dcc:traceable='true']/dcc:declaration/dcc:content")
    assert traced == "traceability, as stated: PTB length standards through T-12/2026"
    said = declarations(path)
    assert "measured by M. Muster" in said and "k = 1.96" in said


def test_a_span_of_conditions_is_in_order(tmp_path: Path) -> None:
    conditions = {"air_temperature_degC": [21.0, 20.0]}
    path = tmp_path / "job.yaml"
    path.write_text(yaml.safe_dump({**JOB, "dcc": {**JOB["dcc"], "conditions": conditions}}))  # type: ignore[dict-item]
    with pytest.raises(InputError, match="lowest and the highest") as raised:
        load_job(path)
    assert raised.value.file == str(path)


@pytest.mark.slow
def test_report_writes_the_certificate(
    tmp_path: Path, mine: Path, job: Path, out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    written = tmp_path / "written.xml"
    assert status("report", "-o", tmp_path / "r.html", "-c", mine, "--job", job, "--dcc", written) == 0
    assert "the certificate is not signed" in capsys.readouterr().out
    assert written.read_text(encoding="utf-8") == out.read_text(encoding="utf-8")


def test_a_calibration_has_a_certificate(out: Path, schema: xmlschema.XMLSchema) -> None:
    """Every number is that of the calibration file, which this test evaluates by itself."""
    schema.validate(out)
    known, unknown, *curves = quantities(out)
    covariance = ROOT @ ROOT.T
    assert known["labels"] == ["E_C0Y", "E_X0C"] and known["units"] == [r"\micro\radian", r"\micro\metre"]
    assert np.allclose(known["values"], [41.5, 12.0]) and np.allclose(known["u"], np.sqrt(np.diag(covariance)[3:]))
    assert np.allclose(known["covariance"], covariance[3:, 3:])
    assert known["covariance units"] == [
        [r"\micro\radian\tothe{2}", r"\micro\metre\micro\radian"],
        [r"\micro\radian\micro\metre", r"\micro\metre\tothe{2}"],
    ]
    assert unknown["labels"] == ["E_B0Z"] and not len(unknown["u"]) and "uncertainty unknown" in unknown["name"]
    x, of_x, b, of_b = curves
    assert x["units"] == [r"\milli\metre"] * 11 and np.allclose(x["values"], np.linspace(0.0, 500.0, 11))
    u = np.linspace(-1.0, 1.0, 11)
    powers = np.stack([u**0, u, u**2], axis=1)
    assert np.allclose(of_x["values"], powers @ [1.0, 11.4, 2.0])
    assert np.allclose(of_x["covariance"], powers @ covariance[:3, :3] @ powers.T)
    assert np.allclose(of_x["u"], np.sqrt(np.diag(of_x["covariance"])))
    assert b["units"] == [r"\degree"] * 11 and not len(of_b["u"]) and np.allclose(of_b["values"], 3.5 * u)
    # Three coefficients: the region has three dimensions.
    region = ElementTree.parse(out).getroot().findall(".//si:ellipsoidalRegionXMLList", NS)
    factors = [float(one.findtext("si:coverageFactor", "", NS)) for one in region]
    assert np.allclose(factors, np.sqrt(stats.chi2.ppf(0.95, [2, 3])))
    text = declarations(out)
    assert "no electronic signature" in text and "SIMULATED" in text and "E_X0B was not determined" in text


def test_an_error_known_exactly_has_a_u_of_zero(
    tmp_path: Path, mine: Path, job: Path, dmu50: Machine, schema: xmlschema.XMLSchema
) -> None:
    exact = replace(Calibration.load(mine, dmu50), joint=Covariance(NAMES, np.diag([0.0, 0.0, 0.0, 0.0, 1.0])))
    path = tmp_path / "exact.xml"
    path.write_text(calibration_certificate(exact, load_job(job), job), encoding="utf-8")
    schema.validate(path)
    known, _, _, of_x, *_ = quantities(path)
    assert known["u"].tolist() == [0.0, 1.0] and not np.any(of_x["u"])


def test_who_and_what_are_those_of_the_job(out: Path) -> None:
    root = ElementTree.parse(out).getroot()
    for place, text in {
        "coreData/uniqueIdentifier": "M-7/2026",
        "coreData/countryCodeISO3166_1": "NO",
        "coreData/beginPerformanceDate": "2026-11-27",
        "coreData/endPerformanceDate": "2026-11-28",
        "coreData/performanceLocation": "customer",
        "items/item/name/content": "DMU 50 & friends",
        "items/item/manufacturer/name/content": "DMG MORI",
        "items/item/identifications/identification/value": "1150-07",
        "calibrationLaboratory/contact/eMail": "lab@example.org",
        "calibrationLaboratory/contact/location/street": "Gate 1",
        "respPersons/respPerson/person/name/content": "A. Person",
        "respPersons/respPerson/cryptElectronicSignature": "false",
        "customer/name/content": "Shop",
        "customer/location/postCode": "0150",
    }.items():
        path = "/".join(f"dcc:{part}" for part in ("administrativeData", *place.split("/")))
        assert root.findtext(path, "", NS) == text
    assert root.findtext(".//dcc:measuringEquipment/dcc:name/dcc:content", "", NS) == "laser <tracker>"
    assert root.findtext(".//dcc:influenceCondition//dcc:noQuantity/dcc:content", "", NS) == "20.4 to 20.9 °C"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda job: job.pop("dcc"), "`dcc` is missing"),
        (lambda job: job.pop("serial_number"), "`serial_number` is missing"),
        (lambda job: job["dcc"].pop("number"), "`dcc.number` is missing"),
        (lambda job: job["dcc"].pop("customer"), "`dcc.customer` is missing"),
        (lambda job: job["dcc"]["laboratory"].pop("email"), "`dcc.laboratory.email` is missing"),
        (lambda job: job["dcc"].update(responsible=[]), "`dcc.responsible` is invalid"),
        (lambda job: job["dcc"].update(country="Norway"), "`dcc.country` is invalid: 'Norway'"),
        (
            lambda job: job["dcc"].update(country=False),
            "`dcc.country` is invalid: 'False'; expected two capital letters of ISO",
        ),
        (lambda job: job["dcc"].update(begin="27.11.2026"), "`dcc.begin` is invalid: '27.11.2026'"),
        (lambda job: job["dcc"].update(end="2026-11-01"), "`dcc.end` is before `dcc.begin`"),
        (lambda job: job["dcc"].update(performed_at="shop"), "`dcc.performed_at` is invalid"),
        (lambda job: job.update(customer="Another"), "`customer` and `dcc.customer.name` differ"),
    ],
)
def test_a_missing_fact_is_named_and_nothing_is_written(
    tmp_path: Path,
    mine: Path,
    capsys: pytest.CaptureFixture[str],
    change: Callable[[dict[str, Any]], object],
    message: str,
) -> None:
    facts = deepcopy(JOB)
    change(facts)
    job, page, out = tmp_path / "job.yaml", tmp_path / "r.html", tmp_path / "mine.xml"
    job.write_text(yaml.safe_dump(facts, allow_unicode=True), encoding="utf-8")
    error = refused(capsys, "report", "-o", page, "-c", mine, "--job", job, "--dcc", out)
    assert message in error and "job.yaml" in error
    assert not page.exists() and not out.exists()


def test_numbers_that_were_not_measured_have_no_certificate(
    tmp_path: Path, job: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "mine.xml"
    assert "illustrative" in refused(capsys, "report", "-o", tmp_path / "r.html", "--job", job, "--dcc", out)
    assert "--job" in refused(capsys, "report", "-o", tmp_path / "r.html", "--dcc", out)


def positioning(path: Path, seed: int) -> Path:
    """Write a table of five cycles of X at eleven targets, bidirectional, with uncertainties of the readings."""
    rng = np.random.default_rng(seed)
    rows = ["X_mm,Y_mm,Z_mm,B_deg,C_deg,target,carrier,x_mm,y_mm,z_mm,u_x_mm,approach_X"]
    targets = np.linspace(10.0, 490.0, 11)
    for _ in range(5):
        for side in (1, -1):
            for x in targets[::side]:
                read = x + 1e-3 * (0.02 * x + 1.5 * side + rng.normal(0.0, 0.8))
                rows.append(f"{x:g},225,-200,0,0,R,tool,{read:.5f},,,0.0005,{side}")
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("tolerance", [("A=40", "B=1"), ()])
def test_an_evaluation_by_iso_230_2_has_a_certificate(
    tmp_path: Path, schema: xmlschema.XMLSchema, job: Path, tolerance: tuple[str, ...]
) -> None:
    """Values, uncertainties and the table by target are those of the evaluation's JSON."""
    table, out, page = positioning(tmp_path / "x.csv", 1), tmp_path / "x.xml", tmp_path / "x.json"
    limits = ["--tolerance", *tolerance] if tolerance else []
    assert status("evaluate", table, "--job", job, "--dcc", out, "--json", page, *limits) == (3 if tolerance else 0)
    schema.validate(out)
    test = next(one for one in json.loads(page.read_text())["tests"] if one["test"] == "positioning")
    values, places, *columns = quantities(out)[:7]
    assert values["labels"] == [key.rpartition("_")[0] for key in test["values"]]
    assert np.allclose(values["values"], list(test["values"].values()), rtol=1e-11)
    assert np.allclose(values["u"], list(test["u"].values()), rtol=1e-11) and set(values["units"]) == {r"\micro\metre"}
    assert np.allclose(places["values"], np.linspace(10.0, 490.0, 11)) and set(places["units"]) == {r"\milli\metre"}
    for column, name in zip(
        columns, ("mean_forward", "mean_backward", "B_i", "s_i_forward", "s_i_backward"), strict=True
    ):
        assert np.allclose(column["values"], test["detail"][name], rtol=1e-11)
    found = [one.text for one in ElementTree.parse(out).getroot().iterfind(".//dcc:conformity", NS)]
    assert found == (["pass", "fail"] if tolerance else [])


def test_a_drift_test_has_a_certificate(tmp_path: Path, schema: xmlschema.XMLSchema, job: Path) -> None:
    """Values in µm, µm per kelvin and kelvin."""
    record, out, page = tmp_path / "record.csv", tmp_path / "drift.xml", tmp_path / "drift.json"
    rows = [f"{60 * k},{3.0 * np.sin(k / 20):.3f},{20.0 + 0.5 * np.sin(k / 20):.3f}" for k in range(120)]
    record.write_text("\n".join(["time_s,d1_um,T_t5_degC", *rows]) + "\n")
    arguments = (
        "evaluate",
        record,
        "--iso230-3",
        "--sensors",
        "d1=X",
        "t5=ambient",
        "--job",
        job,
        "--dcc",
        out,
        "--json",
        page,
    )
    assert status(*arguments) == 0
    schema.validate(out)
    units = {label: unit for one in quantities(out) for label, unit in zip(one["labels"], one["units"], strict=True)}
    assert units["ETVE_X"] == r"\micro\metre" and units["T_ambient"] == r"\kelvin"
    assert units["ETVE_X_per_K"] == r"\micro\metre\kelvin\tothe{-1}"


def test_an_evaluation_without_uncertainty_says_so(tmp_path: Path, schema: xmlschema.XMLSchema, job: Path) -> None:
    table, out = positioning(tmp_path / "x.csv", 1), tmp_path / "x.xml"
    table.write_text(table.read_text().replace("0.0005", ""))
    assert status("evaluate", table, "--job", job, "--dcc", out, "--tolerance", "A=40") == 0
    schema.validate(out)
    assert "uncertainty of the readings is unknown" in declarations(out)
    assert not any(len(one["u"]) for one in quantities(out))
    assert not ElementTree.parse(out).getroot().findall(".//dcc:conformity", NS)
