"""Measured signals: one type, one reader a file format, and public data sets."""

from recordings.channel_map import ChannelMap, ChannelSource, TimeSource, parse_map, read_map
from recordings.datasets import DataSet, fetch, list_sets
from recordings.load import load, load_signals
from recordings.recording import Channel, Recording, Sensor
from recordings.resample import Kind
from recordings.signals import Samples, Signals

__all__ = [
    "Channel",
    "ChannelMap",
    "ChannelSource",
    "DataSet",
    "Kind",
    "Recording",
    "Samples",
    "Sensor",
    "Signals",
    "TimeSource",
    "fetch",
    "list_sets",
    "load",
    "load_signals",
    "parse_map",
    "read_map",
]
