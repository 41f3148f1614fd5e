"""Byte streams from a unit: a serial port, TCP, UDP, or standard input."""

from __future__ import annotations

import os
import socket
import sys
from typing import Any, Final, Protocol

from imucal.errors import InputError
from imucal.io.extra import library

__all__ = ["Link", "LinkLostError", "link_to", "serial_port"]

# Longest time that `read` waits for data, s.
WAIT_S: Final = 0.05
# Timeout of a TCP connection, s.
CONNECT_S: Final = 5.0
# Largest number of bytes per read.
AT_ONCE: Final = 65536


class LinkLostError(Exception):
    """The connection was lost or could not be opened."""


class Link(Protocol):
    """A source of bytes."""

    name: str
    # Whether a lost connection can be opened again.
    comes_back: bool
    # Message that tells the user how to make the unit send data; empty if there is nothing to tell.
    hint: str

    def open(self) -> None:
        """Open the connection. Raises LinkLostError with the reason on failure."""

    def read(self) -> bytes:
        """Bytes that arrive within a short wait, possibly none.

        Raises LinkLostError at the end of the stream.
        """

    def close(self) -> None:
        """Close the connection. A second call does nothing."""


def serial_port(port: str, baud: int) -> Any:
    """An exclusively opened port of pyserial. Raises LinkLostError with the reason if that fails."""
    serial = library("serial", "stand", "Serial ports")
    try:
        return serial.Serial(port, baud, timeout=0, write_timeout=1.0, exclusive=os.name == "posix" or None)
    except (OSError, ValueError) as error:
        raise LinkLostError(f"{port} cannot be opened: {error}") from None


def link_to(address: str, baud: int) -> Link:
    """The link for an address.

    -                  standard input
    tcp://HOST:PORT    a TCP server
    udp://[HOST]:PORT  datagrams that are sent to this port of the computer
    otherwise          the name of a serial port
    """
    if address == "-":
        return _Stdin()
    if address.startswith("tcp://"):
        host, port = host_and_port(address, "tcp://HOST:PORT")
        if not host:
            raise InputError(f"the address {address!r} is not tcp://HOST:PORT")
        return _Tcp(host, port)
    if address.startswith("udp://"):
        return _Udp(*host_and_port(address, "udp://:PORT"))
    library("serial", "stand", "Serial ports")
    return _Serial(address, baud)


def host_and_port(address: str, form: str) -> tuple[str, int]:
    """Host and port of an address. Raises InputError with the expected form if there is no port."""
    host, _, port = address.partition("://")[2].rstrip("/").rpartition(":")
    if not port.isdigit():
        raise InputError(f"the address {address!r} is not {form}")
    return host.strip("[]"), int(port)


class _Serial:
    comes_back = True
    hint = ""

    def __init__(self, port: str, baud: int) -> None:
        self.name = port
        self._baud = baud
        self._port: Any = None

    def open(self) -> None:
        self._port = serial_port(self.name, self._baud)
        # `read` waits for one byte and then takes all available bytes.
        self._port.timeout = WAIT_S

    def read(self) -> bytes:
        try:
            first: bytes = self._port.read(1)
            return first + self._port.read(self._port.in_waiting) if first else b""
        # Any exception is caught, because for a lost or closed port pyserial also raises exceptions of other
        # modules, such as termios.
        except Exception as error:
            raise LinkLostError(f"{self.name} is lost: {error}") from None

    def close(self) -> None:
        if self._port is not None:
            self._port.close()


class _Socket:
    """Base of a TCP connection and of a UDP port."""

    comes_back = True

    def __init__(self, name: str, hint: str, address: tuple[str, int]) -> None:
        self.name, self.hint = name, hint
        self._address = address
        self._socket: socket.socket | None = None

    def _received(self) -> bytes | None:
        """Bytes that arrive within a short wait; None if nothing arrives, empty at the end of a stream."""
        assert self._socket is not None
        try:
            return self._socket.recv(AT_ONCE)
        except TimeoutError:
            return None
        except OSError as error:
            raise LinkLostError(f"{self.name} is lost: {error}") from None

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()


class _Tcp(_Socket):
    def __init__(self, host: str, port: int) -> None:
        super().__init__(f"tcp://{host}:{port}", "", (host, port))

    def open(self) -> None:
        try:
            self._socket = socket.create_connection(self._address, timeout=CONNECT_S)
            self._socket.settimeout(WAIT_S)
        except OSError as error:
            raise LinkLostError(f"{self.name} cannot be reached: {error}") from None

    def read(self) -> bytes:
        data = self._received()
        if data == b"":
            raise LinkLostError(f"{self.name} has closed the connection")
        return data or b""


class _Udp(_Socket):
    """Datagrams of text or of packets. A datagram may or may not end with a line end."""

    def __init__(self, host: str, port: int) -> None:
        hint = f"the unit has to send to UDP port {port} of this computer ({own_address()})"
        super().__init__(f"udp://{host}:{port}", hint, (host, port))

    def open(self) -> None:
        family = socket.AF_INET6 if ":" in self._address[0] else socket.AF_INET
        try:
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
            self._socket.settimeout(WAIT_S)
            self._socket.bind(self._address)
        except OSError as error:
            raise LinkLostError(f"{self.name} cannot be opened: {error}") from None

    def read(self) -> bytes:
        data = self._received()
        if data is None:
            return b""
        # A line end is added, because apps send a line or a JSON message in a datagram without a line end.
        # After a packet, which ends with its checksum, the decoder skips the line end.
        return data if data.endswith(b"\n") else data + b"\n"


def own_address() -> str:
    """The address of this computer in its network."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            # Connecting a datagram socket sends no data, but selects the interface that leads to other
            # networks.
            probe.connect(("192.0.2.1", 9))
            return str(probe.getsockname()[0])
    except OSError:
        return "127.0.0.1"


class _Stdin:
    name = "standard input"
    comes_back = False
    hint = ""

    def open(self) -> None:
        if sys.stdin.isatty():
            raise LinkLostError("standard input is a terminal: pipe the unit's data into the command")

    def read(self) -> bytes:
        data = os.read(sys.stdin.fileno(), AT_ONCE)
        if not data:
            raise LinkLostError("standard input has ended")
        return data

    def close(self) -> None:
        pass
