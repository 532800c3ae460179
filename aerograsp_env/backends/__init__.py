"""One interface to simulated and real arms (the hardware abstraction of the thesis' appendix A.3).

    config = SerialArmConfig.from_xml("config_arm1.xml", arm=1)
    with SerialArm(config, "/dev/ttyUSB0") as arm:  # read-only; a simulated arm has the same methods
        print(arm.read().position)
    with SerialArm(config, "/dev/ttyUSB0", enable_motion=True) as arm:
        while ...:
            arm.command_rates(rates, dt=0.02)  # refused beyond limits; the arm holds when commands stop

Serial ports need pyserial (`pip install 'aerograsp[serial]'`).
"""

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
