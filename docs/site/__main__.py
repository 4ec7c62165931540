"""Build the documentation into `build/docs`: everything it links to is inside it.

Usage: python -m docs.site [FOLDER]
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from sphinx.cmd.build import main as sphinx

import twinproof
from docs.site.catalogue import write_catalogue

ROOT = Path(__file__).parents[2]
PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "LICENSE")

INDEX = """# twinproof

```{toctree}
:caption: Start
README
docs/tutorial
```

```{toctree}
:caption: How to
docs/how-to/own-model
docs/how-to/own-effect
docs/how-to/can-log
docs/how-to/notebook
docs/how-to/foreign-fmu
docs/how-to/co-simulation
docs/how-to/fleet
docs/how-to/postgresql
docs/how-to/machines
docs/how-to/cluster
docs/hil
docs/twin
```

```{toctree}
:caption: Explanation
docs/explanation
docs/design
```

```{toctree}
:caption: Reference
docs/reference/commands
docs/reference/python
docs/reference/effects
docs/file-formats
docs/language
CHANGELOG
CONTRIBUTING
```

```{toctree}
:caption: Measured
:glob:
docs/benchmarks/*
docs/reproduction/*
```
"""

PYTHON = """# Python

Everything here is a name of `import twinproof`.

```{eval-rst}
.. automodule:: twinproof
   :no-members:

%s
```
"""

COMMANDS = """# Commands

```{eval-rst}
.. click:: twinproof.cli:command
   :prog: twinproof
   :nested: full
```
"""


def gather(source: Path) -> None:
    """Lay out the pages as in the repository, with those that are made from the code."""
    if source.exists():
        shutil.rmtree(source)
    source.mkdir(parents=True)
    for name in PAGES:
        shutil.copy(ROOT / name, source / name)
    ignore = shutil.ignore_patterns("*.py", "__pycache__", "site", "reproduce")
    for folder in ("docs", "examples"):
        shutil.copytree(ROOT / folder, source / folder, ignore=ignore)
    reference = source / "docs" / "reference"
    reference.mkdir()
    write_catalogue(reference)
    (reference / "python.md").write_text(PYTHON % "\n\n".join(map(_documented, _names())))
    (reference / "commands.md").write_text(COMMANDS)
    (source / "index.md").write_text(INDEX + _others(source))
    shutil.copy(ROOT / "docs" / "site" / "conf.py", source / "conf.py")


def _others(source: Path) -> str:
    """Return a list of the pages that the index does not name, so that none is lost."""
    words = set(INDEX.split())
    pages = [p.relative_to(source).with_suffix("").as_posix() for p in source.rglob("*.md")]
    left = [
        p for p in sorted(pages) if p not in words and f"{Path(p).parent.as_posix()}/*" not in words
    ]
    return "\n".join(["", "```{toctree}", ":caption: More", *left, "```", ""]) if left else ""


def _names() -> list[str]:
    return [name for name in twinproof.__all__ if name != "calibration"]


def _documented(name: str) -> str:
    kind = "autoclass" if isinstance(getattr(twinproof, name), type) else "autofunction"
    members = "\n   :members:" if kind == "autoclass" else ""
    return f".. {kind}:: twinproof.{name}{members}"


def open_to_everyone(page: str) -> str:
    """Mend what the theme leaves undone for screen readers and for the keyboard."""
    page = page.replace('role="heading">', 'role="heading" aria-level="2">')
    # Code that is wider than its box can be scrolled without a mouse.
    return page.replace("<pre>", '<pre tabindex="0">')


def main(build: Path) -> int:
    """Build; warnings are errors."""
    source, target = build / "docs-source", build / "docs"
    gather(source)
    status = sphinx(["-W", "--keep-going", "-q", "-E", "-b", "html", str(source), str(target)])
    for path in target.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        path.write_text(open_to_everyone(text), encoding="utf-8")
    if status == 0:
        print(f"documentation: {target / 'index.html'}")
    return status


if __name__ == "__main__":
    sys.exit(main(Path(*sys.argv[1:]) if sys.argv[1:] else Path("build")))
