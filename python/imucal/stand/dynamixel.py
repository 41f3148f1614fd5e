"""Dynamixel motors as a stand: a program that executes the commands of `imucal.stand.external`.

    python -m imucal.stand.dynamixel --port /dev/ttyUSB0 --baud 57600 --ids 1,2,3

`--driver dynamixel` starts this program. The motors use Protocol 2.0 and the control table of the X series.
They are in extended position mode, in which they count several turns. A motor that restarts during a run
loses its count of turns, and its torque is off. The run ends with an error if the torque of a motor is off.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import Any, Final, TextIO

from imucal.errors import ImucalError, InputError
from imucal.io.extra import library

__all__ = ["Motors", "ids_of", "serve"]

# Addresses of registers in the control table of Dynamixel motors of the X series.
OPERATING_MODE, TORQUE_ENABLE, HARDWARE_ERROR = 11, 64, 70
PROFILE_ACCELERATION, PROFILE_VELOCITY, GOAL_POSITION, PRESENT_POSITION = 108, 112, 116, 132
EXTENDED_POSITION: Final = 4
# Position counts per revolution, and the units of the registers profile velocity (0.229 rpm) and profile
# acceleration (214.577 rev/min^2).
COUNTS: Final = 4096
RATE_UNIT_DPS: Final = 0.229 * 6.0
ACCELERATION_UNIT_DPS2: Final = 214.577 * 360.0 / 3600.0
# Rate, deg/s, and acceleration, deg/s^2, of the motor with the largest rotation of a move.
RATE_DPS, ACCELERATION_DPS2 = 60.0, 240.0
# Maximum number of attempts to read or write a register. An attempt fails if a packet is damaged or lost. It
# also fails if the answer is late, because the library waits only 35 ms for it. All attempts take 2 s, less
# than the 3 s after which `imucal.stand.external` gives up.
TRIES: Final = 60
# Number of position readings between two checks of torque and hardware error.
CHECK_EVERY: Final = 10
PROTOCOL: Final = 2.0


def ids_of(text: str) -> tuple[int, int, int]:
    """The numbers of three motors in a text such as `1,2,3`, outermost first.

    Raises InputError for any other text.
    """
    try:
        first, second, third = (int(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--ids is {text!r}: give the numbers of three motors, such as 1,2,3") from None
    if len({first, second, third}) != 3 or not all(0 <= number <= 252 for number in (first, second, third)):
        raise InputError(f"--ids is {text!r}: give three different numbers from 0 to 252")
    return (first, second, third)


class Motors:
    """Three motors on one bus. Methods raise ImucalError with the motor and the cause."""

    def __init__(self, port: str, baud: int, ids: Sequence[int]) -> None:
        sdk = library("dynamixel_sdk", "dynamixel", "Dynamixel motors")
        self._sdk, self._ids = sdk, tuple(ids)
        self._bus, self._packets = sdk.PortHandler(port), sdk.PacketHandler(PROTOCOL)
        try:
            is_open = bool(self._bus.openPort() and self._bus.setBaudRate(baud))
        except Exception as error:
            raise ImucalError(f"{port} cannot be opened: {error}") from None
        if not is_open:
            raise ImucalError(f"{port}: the baud rate {baud} is not possible")
        self._asked = 0
        for motor in self._ids:
            mode = self._read(motor, OPERATING_MODE, 1)
            if mode != EXTENDED_POSITION:
                raise ImucalError(
                    f"motor {motor} is in operating mode {mode}: set it to 4, extended position, in which it "
                    "counts several turns"
                )
            self._check(motor, torque=False)
            # A motor without torque may have been turned, so its goal is set to the present position before
            # torque is enabled.
            self._write(motor, GOAL_POSITION, 4, self._read(motor, PRESENT_POSITION, 4))
            self._write(motor, TORQUE_ENABLE, 1, 1)

    def angles_deg(self) -> list[float]:
        """The present angles, deg."""
        if self._asked % CHECK_EVERY == 0:
            for motor in self._ids:
                self._check(motor)
        self._asked += 1
        return [self._signed(self._read(motor, PRESENT_POSITION, 4)) * 360.0 / COUNTS for motor in self._ids]

    def move(self, angles_deg: Sequence[float]) -> None:
        """Start to turn to these angles. All motors arrive at about the same time."""
        turns = [abs(b - a) for a, b in zip(self.angles_deg(), angles_deg, strict=True)]
        for motor, turn in zip(self._ids, turns, strict=True):
            self._check(motor)
            share = turn / max(turns) if max(turns) > 0.0 else 1.0
            # The velocity is at least 1, because the value 0 means no limit.
            velocity = max(round(share * RATE_DPS / RATE_UNIT_DPS), 1)
            acceleration = max(round(share * ACCELERATION_DPS2 / ACCELERATION_UNIT_DPS2), 1)
            self._write(motor, PROFILE_ACCELERATION, 4, acceleration)
            self._write(motor, PROFILE_VELOCITY, 4, velocity)
        for motor, angle in zip(self._ids, angles_deg, strict=True):
            self._write(motor, GOAL_POSITION, 4, round(angle * COUNTS / 360.0) & 0xFFFFFFFF)

    def stop(self) -> None:
        """Hold the motors at their present positions."""
        for motor in self._ids:
            self._write(motor, GOAL_POSITION, 4, self._read(motor, PRESENT_POSITION, 4))

    def close(self) -> None:
        """Close the port; the motors stay powered."""
        self._bus.closePort()

    def _check(self, motor: int, *, torque: bool = True) -> None:
        error = self._read(motor, HARDWARE_ERROR, 1)
        if error:
            raise ImucalError(
                f"motor {motor} reports a hardware error ({error:#04x}): overload, heat or supply"
            )
        if torque and not self._read(motor, TORQUE_ENABLE, 1):
            raise ImucalError(
                f"motor {motor} has restarted or released its torque, so its count of revolutions is lost: "
                "bring the motors to zero, and run the program again"
            )

    def _read(self, motor: int, address: int, size: int) -> int:
        read = {1: self._packets.read1ByteTxRx, 4: self._packets.read4ByteTxRx}[size]
        value: int = self._done(motor, lambda: read(self._bus, motor, address))[0]
        return value

    def _write(self, motor: int, address: int, size: int, value: int) -> None:
        write = {1: self._packets.write1ByteTxRx, 4: self._packets.write4ByteTxRx}[size]
        self._done(motor, lambda: (0, *write(self._bus, motor, address, value)))

    def _done(self, motor: int, exchange: Any) -> Any:
        """The result of a read or write, which is repeated if a packet was lost or damaged."""
        said = ""
        for _ in range(TRIES):
            try:
                value, result, error = exchange()
            # Any exception is caught, because for a lost device pyserial also raises exceptions of other
            # modules, such as termios.
            except Exception as lost:
                raise ImucalError(f"the bus of the motors is lost: {lost}") from None
            if result == self._sdk.COMM_SUCCESS:
                # The highest bit of `error` is ignored. It indicates a hardware error, which is checked
                # separately.
                if error & 0x7F:
                    raise ImucalError(f"motor {motor}: {self._packets.getRxPacketError(error & 0x7F)}")
                return (value,)
            said = self._packets.getTxRxResult(result)
        raise ImucalError(
            f"motor {motor} does not answer: {said}; check its number, the baud rate and its supply"
        )

    @staticmethod
    def _signed(value: int) -> int:
        return value - (1 << 32) if value >= 1 << 31 else value


def serve(motors: Motors, commands: TextIO, answers: TextIO) -> None:
    """Answer commands until the stream of commands ends."""
    for line in commands:
        word, *numbers = line.split() or [""]
        try:
            if word == "position":
                answer = "position " + " ".join(f"{angle:.4f}" for angle in motors.angles_deg())
            elif word == "move":
                motors.move([float(number) for number in numbers])
                answer = "ok"
            elif word == "stop":
                motors.stop()
                answer = "ok"
            else:
                answer = f"error unknown command {word}"
        except ImucalError as error:
            answer = f"error {error}"
        answers.write(f"{answer}\n")
        answers.flush()


def main() -> None:
    """Serve the motors named on the command line. Commands are read from standard input."""
    parser = argparse.ArgumentParser(description="Dynamixel motors as a stand for `imucal stand`.")
    parser.add_argument("--port", required=True)
    parser.add_argument("--baud", type=int, default=57600)
    parser.add_argument("--ids", default="1,2,3")
    given = parser.parse_args()
    try:
        motors = Motors(given.port, given.baud, ids_of(given.ids))
    except ImucalError as error:
        print(f"error {error}", flush=True)
        return
    try:
        serve(motors, sys.stdin, sys.stdout)
    finally:
        motors.close()


if __name__ == "__main__":
    main()
