"""`python -m benchmarks.real_data`: write the pages of the measured benchmarks."""

from __future__ import annotations

import sys

from benchmarks import dfki, road_car, silverbox
from benchmarks.real_data.page import write

if __name__ == "__main__":
    for module in (dfki, silverbox, road_car):
        if len(sys.argv) == 1 or module.JOURNEY.name in sys.argv[1:]:
            print(write(module.JOURNEY.walk(), whole=module is road_car), flush=True)
