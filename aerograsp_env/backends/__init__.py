"""One interface to simulated and real arms (the hardware abstraction of the thesis' appendix A.3)."""

from aerograsp_env.backends.bus import IdConflict, ServoBus
from aerograsp_env.backends.config import SerialArmConfig, ServoCalibration, read_calibration
from aerograsp_env.backends.feetech import SCS, STS, ServoModel
from aerograsp_env.backends.interface import ArmBackend
from aerograsp_env.backends.limits import (
    ArmLimits,
    ArmState,
    BackendError,
    CommandRefused,
    LinkLost,
    MotionDisabled,
    NotConnected,
    ServoError,
    ServoFault,
)
from aerograsp_env.backends.serial_arm import SerialArm
from aerograsp_env.backends.servos import ServoParameters, SimulatedServos
from aerograsp_env.backends.simulated_arm import SimulatedArm
from aerograsp_env.backends.simulated_bus import SimulatedServoBus

__all__ = [
    "SCS",
    "STS",
    "ArmBackend",
    "ArmLimits",
    "ArmState",
    "BackendError",
    "CommandRefused",
    "IdConflict",
    "LinkLost",
    "MotionDisabled",
    "NotConnected",
    "SerialArm",
    "SerialArmConfig",
    "ServoBus",
    "ServoCalibration",
    "ServoError",
    "ServoFault",
    "ServoModel",
    "ServoParameters",
    "SimulatedArm",
    "SimulatedServoBus",
    "SimulatedServos",
    "read_calibration",
]
