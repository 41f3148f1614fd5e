"""Byte streams from a unit: a serial port, a TCP server, or standard input."""

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

    def open(self) -> None:
        """Open the connection. Raises LinkLostError with the reason if that fails."""

    def read(self) -> bytes:
        """Bytes that arrive within a short wait, possibly none. Raises LinkLostError at the end."""

    def close(self) -> None:
        """Close the connection; a second call does nothing."""


def serial_port(port: str, baud: int) -> Any:
    """An exclusively opened port of pyserial. Raises LinkLostError with the reason if that fails."""
    serial = library("serial", "stand", "Serial ports")
    try:
        return serial.Serial(port, baud, timeout=0, write_timeout=1.0, exclusive=os.name == "posix" or None)
    except (OSError, ValueError) as error:
        raise LinkLostError(f"{port} cannot be opened: {error}") from None


def link_to(address: str, baud: int) -> Link:
    """The link for an address: `-` for standard input, `tcp://HOST:PORT`, or the name of a serial port."""
    if address == "-":
        return _Stdin()
    if address.startswith("tcp://"):
        host, _, port = address.removeprefix("tcp://").rpartition(":")
        if not host or not port.isdigit():
            raise InputError(f"the address {address!r} is not tcp://HOST:PORT")
        return _Tcp(host.strip("[]"), int(port))
    library("serial", "stand", "Serial ports")
    return _Serial(address, baud)


class _Serial:
    comes_back = True

    def __init__(self, port: str, baud: int) -> None:
        self.name = port
        self._baud = baud
        self._port: Any = None

    def open(self) -> None:
        self._port = serial_port(self.name, self._baud)
        # `read` waits for one byte and then takes all that are available.
        self._port.timeout = WAIT_S

    def read(self) -> bytes:
        try:
            first: bytes = self._port.read(1)
            return first + self._port.read(self._port.in_waiting) if first else b""
        # pyserial passes on other exceptions for a lost or closed port, such as those of termios.
        except Exception as error:
            raise LinkLostError(f"{self.name} is lost: {error}") from None

    def close(self) -> None:
        if self._port is not None:
            self._port.close()


class _Tcp:
    comes_back = True

    def __init__(self, host: str, port: int) -> None:
        self.name = f"tcp://{host}:{port}"
        self._address = (host, port)
        self._socket: socket.socket | None = None

    def open(self) -> None:
        try:
            self._socket = socket.create_connection(self._address, timeout=CONNECT_S)
            self._socket.settimeout(WAIT_S)
        except OSError as error:
            raise LinkLostError(f"{self.name} cannot be reached: {error}") from None

    def read(self) -> bytes:
        assert self._socket is not None
        try:
            data = self._socket.recv(AT_ONCE)
        except TimeoutError:
            return b""
        except OSError as error:
            raise LinkLostError(f"{self.name} is lost: {error}") from None
        if not data:
            raise LinkLostError(f"{self.name} has closed the connection")
        return data

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()


class _Stdin:
    name = "standard input"
    comes_back = False

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
