"""The autopilot's gains, under PX4's own parameter names.

The cascade (velocity → attitude → rates → mixer) runs compiled, in `kernel_control`. Gains are PX4 v1.14's defaults:
velocity in acceleration units, rates normalised as PX4's mixer normalises them (see `AirframeConfig.torque_scale`).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AutopilotConfig:
    """PX4's default multicopter gains. Names are PX4's parameters in lower case."""

    mpc_xy_vel_p_acc: float = 1.8  # [1/s]
    mpc_xy_vel_i_acc: float = 0.4  # [1/s²]
    mpc_xy_vel_d_acc: float = 0.2
    mpc_z_vel_p_acc: float = 4.0
    mpc_z_vel_i_acc: float = 2.0
    mpc_z_vel_d_acc: float = 0.0
    mpc_tiltmax_air: float = 0.7853981633974483  # [rad] 45°
    mc_roll_p: float = 6.5  # [1/s]
    mc_pitch_p: float = 6.5
    mc_yaw_p: float = 2.8
    mc_rollrate_p: float = 0.15  # normalised torque per rad/s
    mc_rollrate_i: float = 0.2
    mc_rollrate_d: float = 0.003
    mc_pitchrate_p: float = 0.15
    mc_pitchrate_i: float = 0.2
    mc_pitchrate_d: float = 0.003
    mc_yawrate_p: float = 0.2
    mc_yawrate_i: float = 0.1
    mc_yawrate_d: float = 0.0
    mc_rr_int_lim: float = 0.3  # normalised torque
    mc_rollrate_max: float = 3.839724354387525  # [rad/s] 220°/s
    mc_yawrate_max: float = 3.490658503988659  # [rad/s] 200°/s
    imu_dgyro_cutoff: float = 30.0  # [Hz] low-pass of the rate derivative
    mpc_veld_lp: float = 5.0  # [Hz] low-pass of the velocity derivative
    command_frame: str = "world"  # velocity set-points in the "world" or in the "heading" frame

    def __post_init__(self) -> None:
        if self.command_frame not in ("world", "heading"):
            raise ValueError(f"command_frame must be 'world' or 'heading', got {self.command_frame!r}")
