"""Co-simulation of several connected FMUs."""

from fmus.master.system import Component, Connection, System
from fmus.stepping import Method

__all__ = ["Component", "Connection", "Method", "System"]
