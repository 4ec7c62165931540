"""Write the DBC file of every plant of the library; run it after a plant's ports have changed."""

from __future__ import annotations

from fmus.archive import describe
from fmus.package import cached_fmu
from fmus.sources import library_class
from foundation.files import write_text
from hil.bus.dbc import BUNDLED, Port, plant_dbc
from modelica import LIBRARY


def main() -> None:
    """Write them."""
    for path in sorted((LIBRARY / "Plants").glob("[A-Z]*.mo")):
        described = describe(cached_fmu(library_class(f"Twinproof.Plants.{path.stem}")))
        ports = [
            [Port(v.name, v.unit, v.description) for v in group]
            for group in (described.inputs, described.outputs)
        ]
        write_text(BUNDLED / f"{path.stem}.dbc", plant_dbc(*ports))


if __name__ == "__main__":
    main()
