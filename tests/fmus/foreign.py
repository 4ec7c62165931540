"""FMUs that we did not make: written by hand in C, and by pythonfmu."""

import zipfile
from pathlib import Path

from fmus.compiler import compile_library

DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Foreign" guid="{1}"
    numberOfEventIndicators="0"><CoSimulation modelIdentifier="Foreign"
    canHandleVariableCommunicationStepSize="true" canGetAndSetFMUstate="true"/>
<ModelVariables>
<ScalarVariable name="u" valueReference="0" causality="input" variability="continuous"><Real
    start="0"/></ScalarVariable>
<ScalarVariable name="y" valueReference="1" causality="output" variability="continuous"
    initial="exact"><Real start="0"/></ScalarVariable>
<ScalarVariable name="misdeed" valueReference="2" causality="parameter" variability="tunable"><Real
    start="0"/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="2" dependencies=""/></Outputs></ModelStructure>
</fmiModelDescription>"""


def hand_written(folder, description=DESCRIPTION):
    """Write an FMU whose C source stands beside this file."""
    library = Path(folder) / "Foreign.so"
    if not library.exists():
        compile_library([Path(__file__).parent / "foreign.c"], library, flags=["-O1", "-w"])
    path = Path(folder) / "Foreign.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", description)
        archive.write(library, "binaries/linux64/Foreign.so")
    return path


PYTHON_SLAVE = """
from {package} import {base}
class Lag({base}):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.time = 0.0
        self.u = 0.0
        self.y = 1.0
        self.rate = 2.0
        for name, causality in (("u", "input"), ("y", "output")):
            self.register_variable({type}(name, causality={causality}[causality]))
        self.register_variable(
            {type}("rate", causality={causality}.parameter, variability={variability}.tunable)
        )
{independent}
    def do_step(self, current_time, step_size):
        self.time = current_time + step_size
        self.y += step_size * self.rate * (self.u - self.y)
        return {done}
"""


def by_pythonfmu(folder):
    """Build an FMI 2 FMU with pythonfmu."""
    from pythonfmu.builder import FmuBuilder

    text = PYTHON_SLAVE.format(
        package="pythonfmu",
        base="Fmi2Slave",
        type="Real",
        causality="Fmi2Causality",
        variability="Fmi2Variability",
        independent="",
        done="True",
    ).replace("import Fmi2Slave", "import Fmi2Slave, Real, Fmi2Causality, Fmi2Variability")
    script = Path(folder) / "lag2.py"
    script.write_text(text)
    return Path(FmuBuilder.build_FMU(str(script), dest=str(folder)))


def by_pythonfmu3(folder):
    """Build an FMI 3 FMU with pythonfmu3."""
    from pythonfmu3.builder import FmuBuilder

    text = PYTHON_SLAVE.format(
        package="pythonfmu3",
        base="Fmi3Slave",
        type="Float64",
        causality="Fmi3Causality",
        variability="Fmi3Variability",
        independent='        self.register_variable(Float64("time", '
        "causality=Fmi3Causality.independent, variability=Fmi3Variability.continuous))",
        done="Fmi3StepResult()",
    ).replace(
        "import Fmi3Slave",
        "import Fmi3Slave, Float64, Fmi3Causality, Fmi3Variability, Fmi3StepResult",
    )
    script = Path(folder) / "lag3.py"
    script.write_text(text)
    return Path(FmuBuilder.build_FMU(str(script), dest=str(folder)))


DESCRIPTION1 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="1.0" modelName="Foreign1" modelIdentifier="Foreign1" guid="{{1}}"
    variableNamingConvention="flat" numberOfContinuousStates="1" numberOfEventIndicators="0">
<ModelVariables>
<ScalarVariable name="u" valueReference="0" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="y" valueReference="1" causality="output"><Real/></ScalarVariable>
<ScalarVariable name="rate" valueReference="2" variability="parameter"><Real start="2" min="0"
    unit="1/s"/></ScalarVariable>
<ScalarVariable name="steps" valueReference="3" variability="discrete" causality="output"><Integer
    /></ScalarVariable>
<ScalarVariable name="slope" valueReference="4"><Real/></ScalarVariable>
</ModelVariables>
{implementation}</fmiModelDescription>"""
STAND_ALONE = """<Implementation><CoSimulation_StandAlone><Capabilities
    canHandleVariableCommunicationStepSize="true"/></CoSimulation_StandAlone></Implementation>
"""


def version_1(folder, *, co_simulation=True):
    """Write an FMI 1.0 FMU; that version has one kind a file."""
    library = Path(folder) / "Foreign1.so"
    if not library.exists():
        compile_library([Path(__file__).parent / "foreign1.c"], library, flags=["-O1", "-w"])
    path = Path(folder) / f"Foreign1{'C' if co_simulation else 'M'}.fmu"
    text = DESCRIPTION1.format(implementation=STAND_ALONE if co_simulation else "")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", text)
        archive.write(library, "binaries/linux64/Foreign1.so")
    return path
