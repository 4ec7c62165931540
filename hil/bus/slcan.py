"""The protocol of serial CAN adapters (Lawicel), read in blocks, behind python-can's interface.

python-can's own reads byte by byte, at some 118 µs a frame; here a read takes all that is there.
A line is a frame, a command or an answer and ends with a carriage return: `t1238AABB…` is a frame
with an 11-bit identifier, `T` has 29 bits, `r` and `R` are remote frames; `S8` sets 1 Mbit/s, `O`
opens, `C` closes. A bell says that a command was refused.
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import time
from collections import deque
from typing import Any

import can
from can import CanProtocol, Message

if sys.platform != "win32":
    import termios
    import tty

_BITRATES = {
    10_000: "S0",
    20_000: "S1",
    50_000: "S2",
    100_000: "S3",
    125_000: "S4",
    250_000: "S5",
    500_000: "S6",
    800_000: "S7",
    1_000_000: "S8",
}
_BLOCK = 1 << 16
_LONGEST_LINE = 32
_APART = 1e-6
_END, _REFUSED = b"\r", b"\a"


class SlcanBus(can.BusABC):
    """A serial CAN adapter, or a peer on the other end of a pseudo-terminal.

    Args:
        channel: The terminal, such as `/dev/ttyACM0`.
        bitrate: Of the bus [bit/s]; None: as the adapter is.
        tty_baudrate: Of the serial line; adapters on USB do not care.
        listen_only: Do not acknowledge frames.

    Attributes:
        malformed: Lines that made no sense, and commands that were refused.

    Raises:
        can.CanInitializationError: The terminal is absent, or no terminal.
        ValueError: A bit rate that the protocol does not have.
    """

    def __init__(
        self,
        channel: str,
        bitrate: int | None = None,
        tty_baudrate: int = 115_200,
        listen_only: bool = False,
        **kwargs: Any,
    ) -> None:
        if bitrate is not None and bitrate not in _BITRATES:
            known = ", ".join(map(str, _BITRATES))
            raise ValueError(f"slcan has no bit rate {bitrate}; it has {known}")
        self.malformed = 0
        self._is_open = False
        self._frames: deque[Message] = deque()
        self._rest = b""
        try:
            self._file = os.open(channel, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:
            raise can.CanInitializationError(f"{channel}: {error.strerror}") from error
        try:
            tty.setraw(self._file)
            _set_speed(self._file, tty_baudrate)
            self._is_open = True
            self._write(b"C\r")
            if bitrate is not None:
                self._write(f"{_BITRATES[bitrate]}\r".encode())
            self._write(b"L\r" if listen_only else b"O\r")
        except (OSError, termios.error) as error:
            os.close(self._file)
            self._is_open = False
            raise can.CanInitializationError(f"{channel}: {error}") from error
        self._can_protocol = CanProtocol.CAN_20
        self.channel_info = f"slcan on {channel}"
        super().__init__(channel, **kwargs)

    def fileno(self) -> int:
        """Return the terminal's file descriptor, to wait for frames with `select`."""
        return self._file

    @property
    def buffered(self) -> int:
        """Frames that have been read, and are received without waiting for the terminal."""
        return len(self._frames)

    def send(self, msg: Message, timeout: float | None = None) -> None:
        """Send a frame.

        Raises:
            can.CanOperationError: Nobody takes it within `timeout` [s], or the terminal is gone.
        """
        self._write(line_of(msg), timeout)

    def _write(self, line: bytes, timeout: float | None = None) -> None:
        if not self._is_open:
            raise can.CanOperationError("the bus is closed")
        end = None if timeout is None else time.monotonic() + timeout
        while line:
            try:
                line = line[os.write(self._file, line) :]
            except BlockingIOError:
                rest = 1.0 if end is None else max(end - time.monotonic(), 0.0)
                if not select.select([], [self._file], [], rest)[1]:
                    raise can.CanOperationError("nobody takes frames") from None
            except OSError as error:
                raise can.CanOperationError(f"the terminal is gone: {error.strerror}") from error

    def _recv_internal(self, timeout: float | None) -> tuple[Message | None, bool]:
        if not self._frames and self._is_open:
            self._read(timeout)
        return (self._frames.popleft() if self._frames else None), False

    def _read(self, timeout: float | None) -> None:
        if timeout != 0 and not select.select([self._file], [], [], timeout)[0]:
            return
        try:
            block = os.read(self._file, _BLOCK)
        except BlockingIOError:
            return
        except OSError as error:
            raise can.CanOperationError(f"the terminal is gone: {error.strerror}") from error
        if not block:
            # A terminal that has hung up is for ever ready to be read, and has nothing.
            raise can.CanOperationError("the terminal is gone")
        # Recordings keep whole microseconds, and frames that lie one apart must not become one.
        stamp = round(time.time(), 6)
        if _REFUSED in block:
            self.malformed += block.count(_REFUSED)
            block = block.replace(_REFUSED, b"")
        *lines, self._rest = (self._rest + block).split(_END)
        if len(self._rest) > _LONGEST_LINE:
            self._rest = b""
            self.malformed += 1
        for k, line in enumerate(lines):
            if line and line[0] in b"tTrR":
                try:
                    # Two frames of a bus are never at once, and a doubled one is told by its stamp.
                    self._frames.append(frame_of(line, stamp + _APART * k))
                except ValueError:
                    self.malformed += 1
            elif line and line[0] not in b"OLCSszZFVvN":
                self.malformed += 1

    def shutdown(self) -> None:
        """Close the channel and the terminal."""
        super().shutdown()
        if self._is_open:
            with contextlib.suppress(can.CanOperationError):
                self._write(b"C\r", 0.0)
            self._is_open = False
            os.close(self._file)


def line_of(frame: Message) -> bytes:
    """Return a frame as a line.

    Example:
        >>> line_of(Message(arbitration_id=0x123, is_extended_id=False, data=b"\\xaa\\xbb"))
        b't1232AABB\\r'
    """
    if frame.is_extended_id:
        head = f"{'R' if frame.is_remote_frame else 'T'}{frame.arbitration_id:08X}{frame.dlc}"
    else:
        head = f"{'r' if frame.is_remote_frame else 't'}{frame.arbitration_id:03X}{frame.dlc}"
    return f"{head}{'' if frame.is_remote_frame else frame.data.hex().upper()}\r".encode()


def frame_of(line: bytes, stamp: float) -> Message:
    """Return the frame of a line, without its end.

    Raises:
        ValueError: The line is no frame.
    """
    kind = line[:1]
    digits = 8 if kind in b"TR" else 3
    length = int(line[1 + digits : 2 + digits])
    if length > 8:
        raise ValueError("more than 8 bytes")
    is_remote = kind in b"rR"
    start = 2 + digits
    data = b"" if is_remote else bytes.fromhex(line[start : start + 2 * length].decode("ascii"))
    # After the data some adapters send a time stamp of 4 digits.
    if len(data) != (0 if is_remote else length):
        raise ValueError("the line is cut")
    return Message(
        timestamp=stamp,
        arbitration_id=int(line[1 : 1 + digits], 16),
        is_extended_id=digits == 8,
        is_remote_frame=is_remote,
        dlc=length,
        data=data,
    )


def _set_speed(file: int, baudrate: int) -> None:
    speed = getattr(termios, f"B{baudrate}", None)
    if speed is None:
        raise OSError(f"a serial line has no speed {baudrate}")
    settings = termios.tcgetattr(file)
    settings[4] = settings[5] = speed
    termios.tcsetattr(file, termios.TCSANOW, settings)
