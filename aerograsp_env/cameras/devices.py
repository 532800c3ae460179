"""Cameras on a cable. Each maker's Python package is imported only when such a camera is opened."""

from __future__ import annotations

import time
from abc import abstractmethod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.cameras.interface import Camera, CameraError, CameraReport, missing_package, read_intrinsics
from aerograsp_env.interfaces import RGBD, Intrinsics

_LOST_IN_A_ROW = 5  # empty answers before a camera counts as lost


def _check_size(width: int, height: int, rate: int) -> None:
    for name, value in (("width", width), ("height", height), ("rate", rate)):
        if isinstance(value, bool) or not isinstance(value, int) or value < 1:
            raise ValueError(f"{name}: expected a positive whole number, got {value!r}")


class _Device(Camera):
    """What the devices share: waiting for a frame, with a limit, and closing once."""

    def __init__(self, name: str) -> None:
        self.report = CameraReport()
        self._name, self._open = name, True

    def read(self) -> RGBD | None:
        """The next frame.

        Raises:
            CameraError: the camera is closed, or gives no more frames.
        """
        if not self._open:
            raise CameraError(f"{self._name} is closed")
        for _ in range(_LOST_IN_A_ROW):
            frame = self._grab()
            if frame is not None:
                self.report.good += 1
                return frame
            self.report.bad.append((f"frame {self.report.good + len(self.report.bad)}", "the camera gave none"))
        raise CameraError(f"{self._name} gives no more frames: is it still plugged in?")

    def close(self) -> None:
        """Free the device."""
        if self._open:
            self._open = False
            self._release()

    @abstractmethod
    def _grab(self) -> RGBD | None:
        """The next frame; None if there was none in time."""

    @abstractmethod
    def _release(self) -> None:
        """Free the device; called once."""


class UVCCamera(_Device):
    """A colour camera (USB, or any that OpenCV opens; a video file too). Depth is 0 everywhere: it has none.

    Args:
        device: its number, or the path of a device or of a video.
        intrinsics: of its calibration; without them nothing can be measured.
        rate: frames a second to ask for, and of a video's stamps.

    Raises:
        ValueError: intrinsics are missing or out of range.
        CameraError: it does not open, or gives pictures of another size than the intrinsics'.
    """

    def __init__(self, intrinsics: Any, device: int | str | Path = 0, rate: int = 30) -> None:
        super().__init__(f"camera {device}")
        import cv2

        self._intrinsics, self._rate = read_intrinsics(intrinsics), rate
        _check_size(self._intrinsics.width, self._intrinsics.height, rate)
        self._video = not isinstance(device, int) and Path(device).is_file()
        self._capture = cv2.VideoCapture(device if isinstance(device, int) else str(device))
        if not self._capture.isOpened():
            raise CameraError(
                f"{self._name} does not open: expected a camera's number, or the path of a device or video"
            )
        if not self._video:
            self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, self._intrinsics.width)
            self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self._intrinsics.height)
            self._capture.set(cv2.CAP_PROP_FPS, rate)

    @property
    def intrinsics(self) -> Intrinsics:
        """As configured."""
        return self._intrinsics

    def read(self) -> RGBD | None:
        """The next picture; None at the end of a video."""
        if not self._video:
            return super().read()
        frame = self._grab() if self._open else None
        self.report.good += frame is not None
        return frame

    def _grab(self) -> RGBD | None:
        seen, picture = self._capture.read()
        if not seen or picture is None:
            return None
        size = (self._intrinsics.height, self._intrinsics.width)
        if picture.shape[:2] != size:
            height, width = picture.shape[:2]
            raise CameraError(f"{self._name}: expected pictures of {size[1]}×{size[0]}, got {width}×{height}")
        stamp = self.report.good / self._rate if self._video else time.monotonic()
        rgb = np.ascontiguousarray(picture[:, :, ::-1], dtype=np.uint8)  # from BGR
        return RGBD(rgb, np.zeros(size, np.float32), self._intrinsics, stamp)

    def _release(self) -> None:
        self._capture.release()


class RealSenseCamera(_Device):
    """An Intel RealSense, depth registered to colour, calibrated by its maker.

    Args:
        serial: of the camera; None for the first one.

    Raises:
        MissingPackage: pyrealsense2 is not installed.
        CameraError: no such camera, or it does not have this mode.
    """

    def __init__(self, width: int = 640, height: int = 480, rate: int = 30, serial: str | None = None) -> None:
        super().__init__(f"RealSense {serial or ''}".strip())
        _check_size(width, height, rate)
        try:
            import pyrealsense2 as rs
        except ImportError as error:
            raise missing_package("backend 'realsense'", "pyrealsense2", "pip install pyrealsense2") from error
        self._pipeline, setup = rs.pipeline(), rs.config()
        if serial is not None:
            setup.enable_device(serial)
        setup.enable_stream(rs.stream.color, width, height, rs.format.rgb8, rate)
        setup.enable_stream(rs.stream.depth, width, height, rs.format.z16, rate)
        try:
            profile = self._pipeline.start(setup)
        except RuntimeError as error:
            raise CameraError(f"{self._name} does not start at {width}×{height}, {rate} Hz: {error}") from error
        self._unit = float(profile.get_device().first_depth_sensor().get_depth_scale())  # [m] a step
        self._align = rs.align(rs.stream.color)
        found = profile.get_stream(rs.stream.color).as_video_stream_profile().get_intrinsics()
        self._intrinsics = Intrinsics(width, height, found.fx, found.fy, found.ppx, found.ppy, list(found.coeffs))

    @property
    def intrinsics(self) -> Intrinsics:
        """Of the colour camera, as its maker calibrated it."""
        return self._intrinsics

    def _grab(self) -> RGBD | None:
        try:
            frames = self._align.process(self._pipeline.wait_for_frames())
        except RuntimeError:
            return None
        color, depth = frames.get_color_frame(), frames.get_depth_frame()
        if not color or not depth:
            return None
        rgb = np.asanyarray(color.get_data()).copy()
        return RGBD(rgb, _metres(depth.get_data(), self._unit), self._intrinsics, color.get_timestamp() / 1e3)

    def _release(self) -> None:
        self._pipeline.stop()


class KinectCamera(_Device):
    """An Azure Kinect, depth registered to colour.

    Args:
        device: its number.
        resolution: 720, 1080, 1440, 1536, 2160 or 3072 rows of the colour picture.

    Raises:
        MissingPackage: pyk4a is not installed.
        CameraError: no such camera.
    """

    def __init__(self, device: int = 0, resolution: int = 720) -> None:
        super().__init__(f"Kinect {device}")
        if resolution not in (720, 1080, 1440, 1536, 2160, 3072):
            raise ValueError(f"resolution: expected 720, 1080, 1440, 1536, 2160 or 3072 rows, got {resolution!r}")
        try:
            import pyk4a
        except ImportError as error:
            raise missing_package(
                "backend 'kinect'", "pyk4a", "install Microsoft's SDK, then pip install pyk4a"
            ) from error
        mode = getattr(pyk4a.ColorResolution, f"RES_{resolution}P")
        self._kinect = pyk4a.PyK4A(pyk4a.Config(color_resolution=mode, synchronized_images_only=True), device_id=device)
        try:
            self._kinect.start()
            K = np.asarray(self._kinect.calibration.get_camera_matrix(pyk4a.CalibrationType.COLOR))
            coefficients = self._kinect.calibration.get_distortion_coefficients(pyk4a.CalibrationType.COLOR)
            height, width = self._kinect.get_capture().color.shape[:2]
        except Exception as error:  # pyk4a's own exceptions have no common base
            raise CameraError(f"{self._name} does not start: {error}") from error
        self._intrinsics = Intrinsics(width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2], coefficients)

    @property
    def intrinsics(self) -> Intrinsics:
        """Of the colour camera, as its maker calibrated it."""
        return self._intrinsics

    def _grab(self) -> RGBD | None:
        capture = self._kinect.get_capture()
        if capture.color is None or capture.transformed_depth is None:
            return None
        rgb = np.ascontiguousarray(capture.color[:, :, 2::-1])  # from BGRA
        stamp = capture.color_timestamp_usec / 1e6
        return RGBD(rgb, _metres(capture.transformed_depth, 1e-3), self._intrinsics, stamp)

    def _release(self) -> None:
        self._kinect.stop()


class ZedCamera(_Device):
    """A Stereolabs ZED: rectified left picture and the depth that its SDK finds.

    Args:
        resolution: "VGA", "HD720", "HD1080" or "HD2K".

    Raises:
        MissingPackage: pyzed is not installed.
        CameraError: no such camera.
    """

    def __init__(self, resolution: str = "HD720", rate: int = 30) -> None:
        super().__init__("ZED")
        if resolution not in ("VGA", "HD720", "HD1080", "HD2K"):
            raise ValueError(f"resolution: expected VGA, HD720, HD1080 or HD2K, got {resolution!r}")
        try:
            import pyzed.sl as sl
        except ImportError as error:
            raise missing_package("backend 'zed'", "pyzed", "it comes with Stereolabs' ZED SDK") from error
        self._sl, self._camera = sl, sl.Camera()
        setup = sl.InitParameters()
        setup.camera_resolution, setup.camera_fps = getattr(sl.RESOLUTION, resolution), rate
        setup.coordinate_units = sl.UNIT.METER
        status = self._camera.open(setup)
        if status != sl.ERROR_CODE.SUCCESS:
            raise CameraError(f"ZED does not open: {status}")
        settings = self._camera.get_camera_information().camera_configuration
        left, size = settings.calibration_parameters.left_cam, settings.resolution
        self._intrinsics = Intrinsics(size.width, size.height, left.fx, left.fy, left.cx, left.cy)
        self._rgb, self._depth = sl.Mat(), sl.Mat()

    @property
    def intrinsics(self) -> Intrinsics:
        """Of the rectified left camera."""
        return self._intrinsics

    def _grab(self) -> RGBD | None:
        sl = self._sl
        if self._camera.grab() != sl.ERROR_CODE.SUCCESS:
            return None
        self._camera.retrieve_image(self._rgb, sl.VIEW.LEFT)
        self._camera.retrieve_measure(self._depth, sl.MEASURE.DEPTH)
        rgb = np.ascontiguousarray(self._rgb.get_data()[:, :, 2::-1])  # from BGRA
        stamp = self._camera.get_timestamp(sl.TIME_REFERENCE.IMAGE).get_nanoseconds() / 1e9
        return RGBD(rgb, _metres(self._depth.get_data(), 1.0), self._intrinsics, stamp)

    def _release(self) -> None:
        self._camera.close()


def _metres(depth: Any, unit: float) -> NDArray[np.float32]:
    """Depth (H, W) [m], with 0 for what is not a distance."""
    metres = np.asanyarray(depth).astype(np.float32) * np.float32(unit)
    return np.where(np.isfinite(metres) & (metres > 0.0), metres, np.float32(0.0))
