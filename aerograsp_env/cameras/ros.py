"""RGB-D frames of ROS: live topics of ROS 2, or a recorded bag (ROS 1 or 2). Depth must be registered to colour.

Pictures are sensor_msgs/Image in rgb8, bgr8, rgba8, bgra8 or mono8, depth in 16UC1 (millimetres) or 32FC1 (metres), and
intrinsics come from sensor_msgs/CameraInfo.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.cameras.interface import Camera, CameraError, CameraReport, missing_package, read_intrinsics
from aerograsp_env.interfaces import RGBD, Intrinsics

COLOR, DEPTH, INFO = "/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw", "/camera/color/camera_info"
_COLORS = {"rgb8": (3, (0, 1, 2)), "bgr8": (3, (2, 1, 0)), "rgba8": (4, (0, 1, 2)), "bgra8": (4, (2, 1, 0)),
           "mono8": (1, (0, 0, 0)), "8UC3": (3, (2, 1, 0))}  # fmt: skip
_DEPTHS = {"16UC1": (np.uint16, 1e-3), "mono16": (np.uint16, 1e-3), "32FC1": (np.float32, 1.0)}
_WAITING = 64  # messages kept while their partners have not come


def picture(message: Any) -> NDArray[np.uint8]:
    """A colour picture (H, W, 3) of a sensor_msgs/Image.

    Raises:
        ValueError: an encoding that is not known, or fewer bytes than the size says.
    """
    if message.encoding not in _COLORS:
        raise ValueError(f"colour topic: expected an encoding of {', '.join(_COLORS)}, got {message.encoding!r}")
    channels, order = _COLORS[message.encoding]
    rows = _rows(message, channels).reshape(message.height, message.width, channels)
    return np.ascontiguousarray(rows[:, :, list(order)])


def depths(message: Any) -> NDArray[np.float32]:
    """A depth picture (H, W) [m] of a sensor_msgs/Image, 0 where there is no return.

    Raises:
        ValueError: an encoding that is not known, or fewer bytes than the size says.
    """
    if message.encoding not in _DEPTHS:
        raise ValueError(f"depth topic: expected an encoding of {', '.join(_DEPTHS)}, got {message.encoding!r}")
    kind, unit = _DEPTHS[message.encoding]
    size = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    metres = _rows(message, size.itemsize).view(size).astype(np.float32) * np.float32(unit)
    return np.where(np.isfinite(metres) & (metres > 0.0), metres, np.float32(0.0))


def _rows(message: Any, bytes_a_pixel: int) -> NDArray[np.uint8]:
    """The bytes (H, W · bytes_a_pixel) of a picture, without what pads its rows."""
    data, width = np.frombuffer(bytes(message.data), np.uint8), message.width * bytes_a_pixel
    if message.step < width or data.size < message.step * message.height:
        raise ValueError(
            f"picture: expected {message.height} rows of at least {width} bytes, got {data.size} bytes, "
            f"{message.step} a row"
        )
    return np.ascontiguousarray(data[: message.step * message.height].reshape(message.height, message.step)[:, :width])


def camera_info(message: Any) -> Intrinsics:
    """Intrinsics of a sensor_msgs/CameraInfo; its fields are upper case in ROS 1 and lower case in ROS 2."""
    K = [float(x) for x in (message.k if hasattr(message, "k") else message.K)]
    D = [float(x) for x in (message.d if hasattr(message, "d") else message.D)]
    return Intrinsics(int(message.width), int(message.height), K[0], K[4], K[2], K[5], D if any(D) else None)


def stamp_of(message: Any) -> float:
    """Time of a message's header [s]."""
    stamp = message.header.stamp
    seconds = getattr(stamp, "sec", getattr(stamp, "secs", 0))
    return float(seconds) + 1e-9 * float(getattr(stamp, "nanosec", getattr(stamp, "nsecs", 0)))


class Partners:
    """Brings pictures and depths together that were taken within `max_gap` [s], in order of time."""

    def __init__(self, max_gap: float) -> None:
        if not 0.0 < max_gap < np.inf:
            raise ValueError(f"max_gap: expected a positive time [s], got {max_gap!r}")
        self._max_gap, self.unmatched = max_gap, 0
        self._waiting: tuple[deque[tuple[float, Any]], deque[tuple[float, Any]]] = (deque(), deque())

    def add(self, which: int, message: Any) -> tuple[Any, Any] | None:
        """A pair (colour, depth) if this message, colour (0) or depth (1), has its partner; else it waits for it."""
        stamp, others = stamp_of(message), self._waiting[1 - which]
        near = min(others, key=lambda other: abs(other[0] - stamp), default=None)
        if near is None or abs(near[0] - stamp) > self._max_gap:
            self._waiting[which].append((stamp, message))
            if len(self._waiting[which]) > _WAITING:
                self._waiting[which].popleft()
                self.unmatched += 1
            return None
        while others[0][0] < near[0]:  # their time has passed
            others.popleft()
            self.unmatched += 1
        others.remove(near)
        return (message, near[1]) if which == 0 else (near[1], message)


class _RosFrames(Camera):
    """What live topics and bags share."""

    def __init__(self, intrinsics: Any, max_gap: float) -> None:
        self.report, self._partners = CameraReport(), Partners(max_gap)
        self._intrinsics: Intrinsics | None = None if intrinsics is None else read_intrinsics(intrinsics)

    @property
    def intrinsics(self) -> Intrinsics:
        """Of the colour camera."""
        if self._intrinsics is None:
            raise CameraError("no camera_info has come yet")
        return self._intrinsics

    def _pair(self, which: int, message: Any) -> RGBD | None:
        """A frame, if `message` completes one that is good."""
        pair = self._partners.add(which, message)
        self.report.unmatched = self._partners.unmatched
        if pair is None:
            return None
        try:
            frame = RGBD(picture(pair[0]), depths(pair[1]), self.intrinsics, stamp_of(pair[0]))
        except ValueError as error:
            self.report.bad.append((f"stamp {stamp_of(pair[0]):.6f}", str(error)))
            return None
        self.report.good += 1
        return frame


class RosBagCamera(_RosFrames):
    """A recorded bag.

    Args:
        path: a ROS 1 file or a ROS 2 folder.
        color, depth, info: names of the topics.
        intrinsics: where the bag has no camera_info.
        max_gap: [s] between the stamps of a picture and its depth.

    Raises:
        FileNotFoundError: there is no such file or folder.
        MissingPackage: rosbags is not installed.
        ValueError: it is no bag, or lacks a topic; the message lists those that it has.
    """

    def __init__(
        self,
        path: str | Path,
        color: str = COLOR,
        depth: str = DEPTH,
        info: str = INFO,
        intrinsics: Any = None,
        max_gap: float = 0.02,
    ) -> None:
        super().__init__(intrinsics, max_gap)
        if not Path(path).exists():
            raise FileNotFoundError(f"{path}: no such file or folder")
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ImportError as error:
            raise missing_package("backend 'rosbag'", "rosbags", "pip install rosbags") from error
        try:
            self._reader = AnyReader([Path(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
            self._reader.open()
        except Exception as error:  # the package has several bases of exceptions
            raise ValueError(f"{path}: expected a ROS bag: {' '.join(str(error).split())}") from error
        self._open = True
        topics = {connection.topic for connection in self._reader.connections}
        wanted = [color, depth] + ([] if intrinsics is not None else [info])
        for topic in wanted:
            if topic not in topics:
                self.close()
                raise ValueError(f"{path}: no topic {topic!r}; it has {', '.join(sorted(topics)) or 'none'}")
        if self._intrinsics is None:
            self._intrinsics = camera_info(next(self._messages(info))[1])
        self._color, self._stream = color, self._messages(color, depth)

    def _messages(self, *topics: str) -> Iterator[tuple[str, Any]]:
        chosen = [connection for connection in self._reader.connections if connection.topic in topics]
        for connection, _, raw in self._reader.messages(connections=chosen):
            yield connection.topic, self._reader.deserialize(raw, connection.msgtype)

    def read(self) -> RGBD | None:
        """The next frame, None at the end."""
        if self._open:
            for topic, message in self._stream:
                frame = self._pair(0 if topic == self._color else 1, message)
                if frame is not None:
                    return frame
        return None

    def close(self) -> None:
        """Close the file."""
        if self._open:
            self._open = False
            self._reader.close()


class RosCamera(_RosFrames):
    """Live topics of ROS 2.

    Args:
        color, depth, info: names of the topics.
        intrinsics: where nothing publishes camera_info.
        max_gap: [s] between the stamps of a picture and its depth.
        timeout: [s] without a frame after which the camera counts as lost.

    Raises:
        MissingPackage: rclpy is not installed (it comes with ROS 2).
        CameraError: no camera_info within `timeout`.
    """

    def __init__(
        self,
        color: str = COLOR,
        depth: str = DEPTH,
        info: str = INFO,
        intrinsics: Any = None,
        max_gap: float = 0.02,
        timeout: float = 5.0,
    ) -> None:
        super().__init__(intrinsics, max_gap)
        try:
            import rclpy
            from rclpy.qos import qos_profile_sensor_data
            from sensor_msgs.msg import CameraInfo, Image
        except ImportError as error:
            raise missing_package("backend 'ros2'", "rclpy", "it comes with ROS 2: source its setup file") from error
        self._rclpy, self._timeout, self._open = rclpy, timeout, True
        if not rclpy.ok():
            rclpy.init()
        self._ready: deque[RGBD] = deque(maxlen=2)  # an old frame is worth less than a new one
        self._node = rclpy.create_node("aerograsp_camera")
        quality = qos_profile_sensor_data
        self._node.create_subscription(Image, color, lambda message: self._take(0, message), quality)
        self._node.create_subscription(Image, depth, lambda message: self._take(1, message), quality)
        if self._intrinsics is None:
            self._node.create_subscription(CameraInfo, info, self._take_info, quality)
            if not self._spin(lambda: self._intrinsics is not None):
                self.close()
                raise CameraError(f"no camera_info on {info!r} within {timeout:g} s")

    def read(self) -> RGBD | None:
        """The next frame.

        Raises:
            CameraError: the camera is closed, or gives no frames.
        """
        if not self._open:
            raise CameraError("the ROS 2 camera is closed")
        if not self._spin(lambda: bool(self._ready)):
            raise CameraError(f"no colour and depth on the topics within {self._timeout:g} s")
        return self._ready.popleft()

    def close(self) -> None:
        """Destroy the node."""
        if self._open:
            self._open = False
            self._node.destroy_node()

    def _spin(self, done: Any) -> bool:
        end = time.monotonic() + self._timeout
        while not done() and time.monotonic() < end:
            self._rclpy.spin_once(self._node, timeout_sec=0.1)
        return bool(done())

    def _take(self, which: int, message: Any) -> None:
        if self._intrinsics is not None and (frame := self._pair(which, message)) is not None:
            self._ready.append(frame)

    def _take_info(self, message: Any) -> None:
        if self._intrinsics is None:
            self._intrinsics = camera_info(message)
