"""The table of language constructs in docs/language.md, made of the suite itself."""

import re
from pathlib import Path

from conformance.refused import REFUSED

DESCRIPTION = re.compile(r'model \w+ "([^"]*)"')


def table_of(models):
    """Rows: a construct, `works`, the model that shows it; or `refused` and the reason."""
    rows = ["| construct | | shown by, or reason |", "|---|---|---|"]
    for file in sorted(models.glob("*.mo")):
        construct = DESCRIPTION.match(file.read_text(encoding="utf-8"))[1]
        rows.append(f"| {construct} | works | `{file.stem}` |")
    for construct, (_, message) in REFUSED.items():
        reason = message.replace("\\", "")
        rows.append(f"| {construct} | refused | {reason} |")
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    here = Path(__file__).parent
    document = here.parents[2] / "docs" / "language.md"
    before, _, _ = document.read_text(encoding="utf-8").partition("| construct |")
    document.write_text(before + table_of(here / "models"), encoding="utf-8")
