"""What is sent to another process: here nothing that takes long to import."""

import os
import subprocess
import time
from pathlib import Path

from foundation.errors import InputError


def double(value):
    return 2 * value


def refuse():
    raise InputError("nonsense", where="here", remedy="think")


def die():
    os._exit(7)


def sleep():
    time.sleep(600)


def have_another_sleep(file):
    """Start a process, as one that compiles does, and say which."""
    with subprocess.Popen(["sleep", "600"]) as process:
        Path(file).write_text(str(process.pid))
        process.wait()
