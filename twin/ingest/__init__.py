"""From the bus to samples: receiving, recording, decoding, resampling."""

from twin.ingest.decoder import Decoded, Decoder
from twin.ingest.receiver import Receiver, Reception, columns
from twin.ingest.recorder import FrameRecorder, convert
from twin.ingest.sampler import Block, Sampler
from twin.ingest.stamps import ArrivalStamps
from twin.ingest.timeline import Slice, Timeline

__all__ = [
    "ArrivalStamps",
    "Block",
    "Decoded",
    "Decoder",
    "FrameRecorder",
    "Receiver",
    "Reception",
    "Sampler",
    "Slice",
    "Timeline",
    "columns",
    "convert",
]
