"""Measured signals: one type, one reader a file format, and public data sets."""

from recordings.channel_map import ChannelMap, ChannelSource, TimeSource, parse_map, read_map
from recordings.datasets import DataSet, fetch, list_sets
from recordings.load import load
from recordings.recording import Channel, Recording, Sensor

__all__ = [
    "Channel",
    "ChannelMap",
    "ChannelSource",
    "DataSet",
    "Recording",
    "Sensor",
    "TimeSource",
    "fetch",
    "list_sets",
    "load",
    "parse_map",
    "read_map",
]
