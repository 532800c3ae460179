"""Real cameras, recorded data sets and ROS behind one interface, chosen by one configuration.

    with open_camera("camera.toml") as camera:  # or a dictionary, or the folder of a data set
        for frame in camera:  # RGBD: rgb, depth [m], intrinsics, stamp, and the pose where it is known
            ...
        print(camera.report)  # frames that were left out, gaps in the time stamps

where camera.toml is, for example,

    backend = "dataset"          # or uvc, realsense, kinect, zed, ros2, rosbag
    path = "rgbd_dataset_freiburg1_desk"

Devices need their makers' Python packages (pyrealsense2, pyk4a, pyzed), bags `rosbags`, topics ROS 2 itself. What is
simulated is `aerograsp_env.sim.rgbd_camera.SimulatedCamera`.
"""

from aerograsp_env.cameras.config import BACKENDS, open_camera
from aerograsp_env.cameras.dataset import DatasetCamera
from aerograsp_env.cameras.devices import KinectCamera, RealSenseCamera, UVCCamera, ZedCamera
from aerograsp_env.cameras.interface import Camera, CameraError, CameraReport, MissingPackage
from aerograsp_env.cameras.ros import RosBagCamera, RosCamera

__all__ = [
    "BACKENDS",
    "Camera",
    "CameraError",
    "CameraReport",
    "DatasetCamera",
    "KinectCamera",
    "MissingPackage",
    "RealSenseCamera",
    "RosBagCamera",
    "RosCamera",
    "UVCCamera",
    "ZedCamera",
    "open_camera",
]
