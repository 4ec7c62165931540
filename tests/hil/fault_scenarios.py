"""One scenario for each class of fault, and the reaction that is expected of the rig.

All are the wheeled pendulum under the paper's PID; what differs is the fault and what must hold.
"""

from pathlib import Path

from hil.scenario import scenario_of
from hil.settings import parse_toml

BASE = """
[plant]
model = "Twinproof.Plants.WheeledPendulum"
[plant.sensors.theta_p]
sd = "0.1 deg"
[controller]
kind = "pid"
measured = ["theta_p"]
commanded = ["V"]
period = "1 ms"
proportional = -168.0
integral = -800.0
derivative = -8.8
[references.theta_p]
kind = "sines"
amplitudes = ["5 deg"]
frequencies = [2.0]
[run]
duration = 4.0
seed = 3
"""
UPRIGHT = """
[[criteria]]
kind = "limit"
signal = "theta_p"
low = "-10 deg"
high = "10 deg"
"""
NEVER_SAFE = """
[[criteria]]
kind = "safe-state"
"""
# Silence is noticed after 20 ms, at the next cycle; one cycle more until good commands act again.
SAFE_AND_BACK = """
[[criteria]]
kind = "safe-state"
after = 2.0
until = 2.05
within = "22 ms"
back = "3 ms"
"""

SCENARIOS = {
    "drop": f"""
[[faults]]
kind = "drop"
on = "actuators"
probability = 0.2
{UPRIGHT}{NEVER_SAFE}""",
    "delay": f"""
[[faults]]
kind = "delay"
on = "sensors"
by = "2 ms"
start = 1.0
{UPRIGHT}{NEVER_SAFE}""",
    "duplicate": f"""
[[faults]]
kind = "duplicate"
probability = 0.3
{UPRIGHT}{NEVER_SAFE}""",
    "reorder": f"""
[[faults]]
kind = "reorder"
probability = 0.1
{UPRIGHT}{NEVER_SAFE}""",
    "corrupt": f"""
[[faults]]
kind = "corrupt"
probability = 0.2
bits = 1
{UPRIGHT}{NEVER_SAFE}""",
    "bus-off": f"""
[[faults]]
kind = "bus-off"
start = 2.0
stop = 2.05
{UPRIGHT}{SAFE_AND_BACK}""",
    "stuck": f"""
[[faults]]
kind = "stuck"
signal = "theta_p"
start = 2.0
{UPRIGHT}{NEVER_SAFE}""",
    "bias": f"""
[[faults]]
kind = "bias"
signal = "theta_p"
by = "3 deg"
start = 1.0
[[criteria]]
kind = "rms"
signal = "theta_p"
after = 2.0
most = "1 deg"
{UPRIGHT}""",
    "late-controller": f"""
[[faults]]
kind = "late-controller"
by = "40 ms"
start = 2.0
stop = 2.05
{UPRIGHT}
[[criteria]]
kind = "safe-state"
after = 2.0
until = 2.05
within = "22 ms"
""",
    "dead-controller": """
[[faults]]
kind = "dead-controller"
start = 2.0
[[criteria]]
kind = "safe-state"
after = 2.0
within = "22 ms"
[[criteria]]
kind = "limit"
signal = "V"
after = 2.023
low = -0.001
high = 0.001
""",
    "motor-failure": f"""
[[faults]]
kind = "motor-failure"
signal = "V"
start = 2.0
{UPRIGHT}{NEVER_SAFE}""",
    "supply-sag": f"""
[[faults]]
kind = "supply-sag"
signal = "V"
gain = 0.7
start = 1.0
{UPRIGHT}{NEVER_SAFE}""",
    "parameter-change": f"""
[[faults]]
kind = "parameter-change"
parameter = "X6"
to = 1.2
start = 1.0
stop = 2.0
{UPRIGHT}{NEVER_SAFE}""",
}


def scenario(text: str, path: Path):
    """Return the scenario of the base and some more tables."""
    return scenario_of(parse_toml(BASE + text, path))
