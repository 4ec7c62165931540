"""Estimators, one a file, behind one small interface."""
