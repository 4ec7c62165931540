"""List the tests that were skipped and fail on a skip that nobody allowed.

A skipped test looks green. Here each skip is printed, and each needs its reason among `ALLOWED`.

Usage: python scripts/check_skips.py JUNIT.xml
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from importlib.util import find_spec
from pathlib import Path
from shutil import which
from xml.etree import ElementTree


def _namespaces() -> bool:
    """Return whether an ordinary process may have a network of its own here."""
    try:
        command = ["unshare", "--user", "--net", "true"]
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except OSError:
        return False


ALLOWED = {
    # Text in the reason, and whether that reason is true here.
    "TWINPROOF_DATA": not os.environ.get("TWINPROOF_DATA"),
    # 400 MB that only a machine without a C compiler needs.
    "the compiler from PyPI is not installed": find_spec("ziglang") is None,
    "no cc": which("cc") is None,
    "no PostgreSQL server": not any(Path("/usr/lib/postgresql").glob("*/bin/postgres")),
    "no nats-server": which("nats-server") is None,
    "no chromium": which("chromium") is None,
    "no unprivileged network namespaces": not _namespaces(),
}


def skip_reasons(junit: Path) -> Counter[str]:
    """Return how often each reason occurs in pytest's JUnit file, expected failures aside."""
    return Counter(
        skipped.get("message", "no reason given")
        for skipped in ElementTree.parse(junit).getroot().iter("skipped")
        if skipped.get("type") != "pytest.xfail"
    )


def is_allowed(reason: str) -> bool:
    """Return whether a skip with this reason may stay."""
    return any(text in reason and holds for text, holds in ALLOWED.items())


def main(junit: Path) -> int:
    """Print the skips; return 1 if one of them is not allowed, else 0."""
    reasons = skip_reasons(junit)
    print(f"skipped tests: {sum(reasons.values())}")
    for reason, count in reasons.most_common():
        print(f"  {count:4d}  {'allowed' if is_allowed(reason) else 'NOT ALLOWED'}: {reason}")
    return int(not all(map(is_allowed, reasons)))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
