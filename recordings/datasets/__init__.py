"""Public measured data: what there is, where it comes from, and the files, checked by SHA-256."""

from recordings.datasets.files import DataFiles, fetch
from recordings.datasets.registry import DataFile, DataSet, find, list_sets

__all__ = ["DataFile", "DataFiles", "DataSet", "fetch", "find", "list_sets"]
