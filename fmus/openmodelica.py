"""OpenModelica's compiler `omc`, for those who have it: another way from Modelica to an FMU."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from fmus.sources import ModelicaSource, library_roots
from foundation.errors import CompilerError, InputError, ModelicaError
from foundation.files import write_bytes

_TIMEOUT = 1800.0  # [s]


def export_with_omc(source: ModelicaSource, path: Path, fmi: str) -> None:
    """Let OpenModelica write an FMU, Co-Simulation and Model Exchange in one, for this machine.

    Args:
        source: Text, class and libraries.
        path: The file to write; whole or not at all.
        fmi: Version of the standard, "2" or "3".

    Raises:
        InputError: There is no `omc` on the path.
        CompilerError: It does not end.
        ModelicaError: It refused the model.
    """
    omc = shutil.which("omc")
    if omc is None:
        raise InputError(
            "there is no OpenModelica compiler",
            where="omc",
            remedy="install OpenModelica and put omc on the PATH, or use --compiler own",
        )
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "model.mo").write_text(source.text, encoding="utf-8")
        (Path(folder) / "export.mos").write_text(_script(source, fmi), encoding="utf-8")
        try:
            done = subprocess.run(
                [omc, "export.mos"],
                cwd=folder,
                capture_output=True,
                text=True,
                timeout=_TIMEOUT,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise CompilerError(f"OpenModelica did not end: {error}", where=omc) from error
        written = Path(folder) / f"{source.short_name}.fmu"
        if not written.is_file():
            raise ModelicaError(
                f"OpenModelica refused the model: {_first_error(done.stdout + done.stderr)}",
                where=source.file_name,
                remedy="correct the model, or try --compiler own",
            )
        write_bytes(path, written.read_bytes())


def _script(source: ModelicaSource, fmi: str) -> str:
    roots = [Path(root) for root in library_roots(source)]
    packages = [
        package
        for root in roots
        for package in ([root / "package.mo"] if (root / "package.mo").is_file() else _below(root))
    ]
    loads = [f'loadFile("{package.as_posix()}");' for package in packages]
    return "\n".join(
        [
            *loads,
            'loadFile("model.mo");',
            f'buildModelFMU({source.class_name}, version="{fmi}.0", fmuType="me_cs",'
            f' fileNamePrefix="{source.short_name}");',
            "getErrorString();",
        ]
    )


def _below(root: Path) -> list[Path]:
    return sorted(root.glob("*/package.mo"))


def _first_error(output: str) -> str:
    lines = [line.strip().strip('"') for line in output.splitlines() if "rror" in line]
    return next(iter(lines), "it gave no reason")
