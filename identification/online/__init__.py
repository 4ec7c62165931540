"""Estimators that take one sample after another, in constant memory.

Both have `update(inputs, outputs) -> OnlineEstimate`: `RecursiveFilter` (output filter and least
squares in square-root form) and `OnlineKalman` (states, parameters and disturbances together).
"""

from identification.online.base import OnlineEstimate, OnlineEstimator
from identification.online.filtered_rows import StreamingRows
from identification.online.kalman import OnlineKalman
from identification.online.recursive_filter import RecursiveFilter
from identification.online.triangles import Triangles

__all__ = [
    "OnlineEstimate",
    "OnlineEstimator",
    "OnlineKalman",
    "RecursiveFilter",
    "StreamingRows",
    "Triangles",
]
