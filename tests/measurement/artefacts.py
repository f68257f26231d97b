"""Certificates of artefacts as a laboratory writes them (DCC 3.1.2, D-SI 2.1), as text; validated against the published schema."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

PERSON = "<dcc:name><dcc:content>A. Person</dcc:content></dcc:name>"
CONTACT = (
    "<dcc:name><dcc:content>Lab</dcc:content></dcc:name><dcc:eMail>lab@example.org</dcc:eMail>"
    "<dcc:location><dcc:city>Trondheim</dcc:city></dcc:location>"
)
HEAD = f"""<?xml version="1.0" encoding="UTF-8"?>
<dcc:digitalCalibrationCertificate xmlns:dcc="https://ptb.de/dcc" xmlns:si="https://ptb.de/si" schemaVersion="3.1.2">
<dcc:administrativeData>
<dcc:dccSoftware><dcc:software><dcc:name><dcc:content>by hand</dcc:content></dcc:name><dcc:release>1</dcc:release>
</dcc:software></dcc:dccSoftware>
<dcc:coreData>
<dcc:countryCodeISO3166_1>NO</dcc:countryCodeISO3166_1>
<dcc:usedLangCodeISO639_1>en</dcc:usedLangCodeISO639_1>
<dcc:mandatoryLangCodeISO639_1>en</dcc:mandatoryLangCodeISO639_1>
<dcc:uniqueIdentifier>BP-7/2026</dcc:uniqueIdentifier>
<dcc:beginPerformanceDate>2026-11-02</dcc:beginPerformanceDate>
<dcc:endPerformanceDate>2026-11-03</dcc:endPerformanceDate>
<dcc:performanceLocation>laboratory</dcc:performanceLocation>
</dcc:coreData>
<dcc:items><dcc:item><dcc:name><dcc:content>ball plate</dcc:content></dcc:name>
<dcc:manufacturer>{PERSON}</dcc:manufacturer>
<dcc:identifications><dcc:identification><dcc:issuer>manufacturer</dcc:issuer><dcc:value>7</dcc:value></dcc:identification></dcc:identifications>
</dcc:item></dcc:items>
<dcc:calibrationLaboratory><dcc:contact>{CONTACT}</dcc:contact></dcc:calibrationLaboratory>
<dcc:respPersons><dcc:respPerson><dcc:person>{PERSON}</dcc:person></dcc:respPerson></dcc:respPersons>
<dcc:customer>{CONTACT}</dcc:customer>
</dcc:administrativeData>
<dcc:measurementResults><dcc:measurementResult><dcc:name><dcc:content>geometry</dcc:content></dcc:name>
<dcc:results><dcc:result><dcc:name><dcc:content>geometry at 20 degrees Celsius</dcc:content></dcc:name><dcc:data>
"""
TAIL = "</dcc:data></dcc:result></dcc:results></dcc:measurementResult></dcc:measurementResults></dcc:digitalCalibrationCertificate>\n"


def certificate(*quantities: str) -> str:
    """Return a certificate with these quantities."""
    return HEAD + "".join(f"<dcc:quantity>\n{one}\n</dcc:quantity>\n" for one in quantities) + TAIL


def listed(
    labels: Sequence[str],
    values_mm: np.ndarray,
    *,
    u_um: np.ndarray | None = None,
    covariance_um2: np.ndarray | None = None,
    unit: str = r"\milli\metre",
) -> str:
    """Return a list of values with expanded uncertainties (k = 2), a covariance matrix, or both."""
    if u_um is None:
        u_um = np.zeros(0) if covariance_um2 is None else np.sqrt(np.diag(covariance_um2))
    text = f"<si:realListXMLList>\n<si:labelXMLList>{' '.join(labels)}</si:labelXMLList>\n"
    text += f"<si:valueXMLList>{' '.join(f'{v:.9f}' for v in values_mm)}</si:valueXMLList>\n<si:unitXMLList>{unit}</si:unitXMLList>\n"
    if len(u_um):
        text += (
            f"<si:expandedUncXMLList>\n<si:uncertaintyXMLList>{' '.join(f'{2e-3 * u:.12g}' for u in u_um)}</si:uncertaintyXMLList>\n"
            "<si:coverageFactorXMLList>2</si:coverageFactorXMLList>\n"
            "<si:coverageProbabilityXMLList>0.95</si:coverageProbabilityXMLList>\n</si:expandedUncXMLList>\n"
        )
    if covariance_um2 is not None:
        text += "<si:ellipsoidalRegionXMLList><si:covarianceMatrix>\n"
        for column in covariance_um2.T:
            entries = (
                f"<si:covariance><si:value>{v:.15g}</si:value><si:unit>\\micro\\metre\\tothe{{2}}</si:unit></si:covariance>"
                for v in column
            )
            text += f"<si:column>{''.join(entries)}</si:column>\n"
        text += (
            "</si:covarianceMatrix><si:coverageFactor>2.5</si:coverageFactor>"
            "<si:coverageProbability>0.95</si:coverageProbability></si:ellipsoidalRegionXMLList>\n"
        )
    return text + "</si:realListXMLList>"


def real(label: str, value: str, unit: str, uncertainty: str) -> str:
    """Return one value."""
    return f"<si:real><si:label>{label}</si:label><si:value>{value}</si:value><si:unit>{unit}</si:unit>{uncertainty}</si:real>"


def expanded(value: str, factor: str = "2") -> str:
    """Return an expanded uncertainty."""
    return (
        f"<si:expandedUnc><si:uncertainty>{value}</si:uncertainty><si:coverageFactor>{factor}</si:coverageFactor>"
        "<si:coverageProbability>0.95</si:coverageProbability></si:expandedUnc>"
    )
