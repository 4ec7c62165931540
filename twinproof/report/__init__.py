"""Reports: one self-contained HTML file each, that opens anywhere, on screen and on paper."""

from twinproof.report.comparison import write_comparison
from twinproof.report.diagnosis import write_diagnosis
from twinproof.report.hil import write_hil
from twinproof.report.identification import write_identification
from twinproof.report.improvement import write_improvement
from twinproof.report.whatif import write_whatif

__all__ = [
    "write_comparison",
    "write_diagnosis",
    "write_hil",
    "write_identification",
    "write_improvement",
    "write_whatif",
]
