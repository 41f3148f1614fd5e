"""Link to a ROS 2 topic with sensor_msgs/Imu messages; it needs rclpy."""

from __future__ import annotations

import importlib
import queue
import threading
from typing import Any, Final

from imucal.errors import InputError
from imucal.stand.link import WAIT_S, LinkLostError

__all__ = ["TEMPLATE", "RosTopic"]

# Columns of the lines that the link returns.
TEMPLATE: Final = "time_ns," + ",".join(
    f"{sensor}_{axis}_{unit}" for sensor, unit in (("accel", "mps2"), ("gyro", "radps")) for axis in "xyz"
)


class RosTopic:
    """Link that returns a line with the columns of `TEMPLATE` for each message."""

    comes_back = True

    def __init__(self, topic: str) -> None:
        self.name = f"ros2://{topic}"
        self.hint = f"nothing is published on {topic}: see `ros2 topic hz {topic}`"
        self._topic = topic
        try:
            self._rclpy: Any = importlib.import_module("rclpy")
            self._qos: Any = importlib.import_module("rclpy.qos")
            self._message: Any = importlib.import_module("sensor_msgs.msg").Imu
        except ImportError as error:
            raise InputError(
                f"ROS 2 is not installed in this Python ({error}): source its setup file, and use its Python"
            ) from None
        self._lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._node: Any = None

    def open(self) -> None:
        """Subscribe to the topic. Raises LinkLostError on failure."""
        if not self._rclpy.ok():
            self._rclpy.init()
        try:
            self._node = self._rclpy.create_node("imucal_capture")
            self._node.create_subscription(
                self._message, self._topic, self._received, self._qos.qos_profile_sensor_data
            )
        except Exception as error:
            # Any exception is caught, because rclpy has separate exception classes, for example for an
            # invalid name.
            raise LinkLostError(f"{self.name} cannot be opened: {error}") from None
        threading.Thread(target=self._rclpy.spin, args=(self._node,), daemon=True).start()

    def read(self) -> bytes:
        """The lines of the messages that arrive within a short wait."""
        try:
            lines = self._lines.get(timeout=WAIT_S)
            while not self._lines.empty():
                lines += self._lines.get_nowait()
        except queue.Empty:
            return b""
        return lines

    def close(self) -> None:
        """End the subscription."""
        if self._node is not None:
            self._node.destroy_node()
            self._node = None

    def _received(self, message: Any) -> None:
        stamp, force, rate = message.header.stamp, message.linear_acceleration, message.angular_velocity
        time_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
        values = (force.x, force.y, force.z, rate.x, rate.y, rate.z)
        self._lines.put(f"{time_ns},{','.join(map(repr, map(float, values)))}\n".encode())
