"""Verdicts as JUnit XML, which every CI system reads: one test case a criterion."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

from foundation.files import write_bytes
from hil.criteria import Verdict


def write_junit(path: Path, name: str, verdicts: Sequence[Verdict], seconds: float) -> None:
    """Write the verdicts of a scenario, whole or not at all.

    Args:
        path: The file.
        name: Of the scenario.
        verdicts: Of its criteria.
        seconds: That the run took.

    Raises:
        OSError: The file cannot be written.
    """
    failed = sum(not v.passed for v in verdicts)
    suites = ET.Element("testsuites")
    suite = ET.SubElement(
        suites,
        "testsuite",
        name=name,
        tests=str(len(verdicts)),
        failures=str(failed),
        errors="0",
        time=f"{seconds:.3f}",
    )
    for verdict in verdicts:
        case = ET.SubElement(suite, "testcase", classname=name, name=verdict.name, time="0")
        if not verdict.passed:
            text = f"{verdict.detail}; limit {verdict.limit:g}"
            ET.SubElement(case, "failure", message=text, type=verdict.kind).text = text
    ET.indent(suites)
    write_bytes(path, ET.tostring(suites, encoding="utf-8", xml_declaration=True) + b"\n")
