"""Design of experiments: what one can tell (`bound`), and a better one (`suggestion`)."""

from identification.design.bound import (
    Bound,
    Criterion,
    bound_of_plan,
    bound_of_record,
    plan,
)
from identification.design.suggestion import Limits, Suggestion, suggest

__all__ = [
    "Bound",
    "Criterion",
    "Limits",
    "Suggestion",
    "bound_of_plan",
    "bound_of_record",
    "plan",
    "suggest",
]
