# The binding has no types of its own that hold: expressions are typed where they leave our modules.
from typing import Any

def __getattr__(name: str) -> Any: ...
