"""Models are compiled in several threads at once: the library for expressions must bear it."""

import subprocess
import sys

# Expressions share nodes, and with them reference counts, also those of constants.
_PROGRAM = """
import threading, time
import casadi as ca

x, end = ca.SX.sym("x", 6), time.monotonic() + 10

def work():
    while time.monotonic() < end:
        y = ca.SX.sym("y", 4)
        f = [ca.sin(2.5 * x[i]) + 1.0 * x[(i + 1) % 6] ** 2 / 3 + 0.5 * y[i % 4] for i in range(6)]
        value = ca.vertcat(*f)
        slope = ca.densify(ca.jacobian(value, x))
        ca.Function("f", [x, y], [value, slope], {"cse": True})
        ca.substitute(value, x, ca.SX([1, 2, 3, 4, 5, 6]))

threads = [threading.Thread(target=work) for _ in range(2)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
print("whole")
"""


def test_two_threads_may_build_expressions_at_once():
    """With casadi 3.8.2 two of three such runs ended in a segmentation fault."""
    found = subprocess.run(
        [sys.executable, "-c", _PROGRAM], check=False, capture_output=True, text=True
    )
    assert (found.returncode, found.stdout) == (0, "whole\n"), found.stderr
