"""What is sent to another process: here nothing that takes long to import."""

import os
import time

from foundation.errors import InputError


def double(value):
    return 2 * value


def refuse():
    raise InputError("nonsense", where="here", remedy="think")


def die():
    os._exit(7)


def sleep():
    time.sleep(600)
