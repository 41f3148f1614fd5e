"""The bytes of a unit: a serial port, a TCP server, or standard input."""

from __future__ import annotations

import os
import socket
import sys
from typing import Any, Final, Protocol

from imucal.errors import InputError
from imucal.io.extra import library

__all__ = ["Link", "LinkLostError", "link_to", "serial_port"]

WAIT_S: Final = 0.05
CONNECT_S: Final = 5.0
AT_ONCE: Final = 65536


class LinkLostError(Exception):
    """The other end is gone, or this one cannot be opened; what is recorded is not touched by that."""


class Link(Protocol):
    """Bytes as they arrive."""

    name: str
    # Whether it can be opened again once it is lost.
    comes_back: bool

    def open(self) -> None:
        """Open it; LinkLostError with the reason if that fails."""

    def read(self) -> bytes:
        """What is there, after a short wait perhaps nothing; LinkLostError if nothing will come any more."""

    def close(self) -> None:
        """Close it; does nothing the second time."""


def serial_port(port: str, baud: int) -> Any:
    """An open port of pyserial that no other program shares; LinkLostError with the reason if that fails."""
    serial = library("serial", "stand", "Serial ports")
    try:
        return serial.Serial(port, baud, timeout=0, write_timeout=1.0, exclusive=os.name == "posix" or None)
    except (OSError, ValueError) as error:
        raise LinkLostError(f"{port} cannot be opened: {error}") from None


def link_to(address: str, baud: int) -> Link:
    """The link of an address: `-` for standard input, `tcp://HOST:PORT`, else a serial port."""
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
        # A byte is enough to wake up; what else is there comes with it.
        self._port.timeout = WAIT_S

    def read(self) -> bytes:
        try:
            first: bytes = self._port.read(1)
            return first + self._port.read(self._port.in_waiting) if first else b""
        # pyserial lets errors of termios, and of a port that is closed meanwhile, through.
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
