"""Regressors derived from the symbolic model, nothing written by hand per plant.

Flat model → equations of motion in measured quantities (`implicit_form`) → lumps times columns
(`base_parameters`) → columns as derivatives of measured signals (`split`) → `Regression`.
"""

from identification.regressors.regression import Column, Regression, derive
from identification.regressors.split import Split

__all__ = ["Column", "Regression", "Split", "derive"]
