"""The Modelica library `Twinproof`: all physics of the toolkit lives here, and nowhere else."""

from __future__ import annotations

from pathlib import Path

LIBRARY = Path(__file__).parent / "Twinproof"
"""Folder of the bundled library; its parent is a Modelica path."""
