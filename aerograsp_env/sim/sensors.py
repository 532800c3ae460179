"""What the vehicle's sensors report, as settings: every noise can be set.

The noise of the three position sources and of the velocity estimate is *calibrated*: `aerograsp calibrate` finds it
once, on seeds of its own, so that a hover under the thesis's PID has the errors of the thesis's Table 5.3. The other
figures are typical of the parts named.

The published figures leave one choice: docked, the vehicle strayed more than with vision, although potentiometers and
lengths like the tool's resolve millimetres. Here the autopilot's velocity estimate wanders more beside the steel
structure (`SensorConfig.dock.velocity_limit`): a better controller can reject that; a tool that errs it could not.

A bounded wandering error appears in several places: an Ornstein–Uhlenbeck process x (unit variance, time constant τ)
passed through the normal distribution function, limit · (2Φ(x) − 1). It is stationary, uniform on ± limit and never
leaves it, as an estimator's error does not that gates its innovations; a Gaussian one would now and then do what no
autopilot lets pass.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

Triple = tuple[float, float, float]


def _check_nonnegative(config: object) -> None:
    for f in fields(config):  # type: ignore[arg-type]
        value = getattr(config, f.name)
        if isinstance(value, (int, float, tuple)):
            array = np.asarray(value, dtype=float)
            if not np.isfinite(array).all() or (array < 0).any():
                raise ValueError(f"{type(config).__name__}.{f.name} must be finite and not negative, got {value!r}")


@dataclass(frozen=True)
class PositionSourceConfig:
    """A world-frame position source.

    Per axis: offset (fixed size, sign drawn per episode) + wandering + slips + white noise. A slip of the tracker goes
    forth or back; slips recur at an interval, the first at a drawn time.
    """

    rate: float  # [Hz]; must divide the control rate
    offset: Triple = (0.0, 0.0, 0.0)  # [m]
    wander_limit: Triple = (0.0, 0.0, 0.0)  # [m]
    wander_time: float = 20.0  # [s]
    jump_size: Triple = (0.0, 0.0, 0.0)  # of a slip [m]
    jump_interval: float = 20.0  # between the beginnings of two slips [s]
    jump_duration: float = 2.0  # until the tracker recovers [s]
    white_std: Triple = (0.0, 0.0, 0.0)  # [m]
    velocity_limit: Triple = (0.0, 0.0, 0.0)  # wander of the autopilot's velocity estimate with this source [m/s]

    def __post_init__(self) -> None:
        _check_nonnegative(self)
        if not self.rate > 0:
            raise ValueError(f"PositionSourceConfig.rate must be positive, got {self.rate}")


@dataclass(frozen=True)
class ToolSensorConfig:
    """The docking tool's potentiometers (thesis section 5.4.1, Table 5.1) and base accelerometer."""

    rate: float = 1200.0  # [Hz]
    adc_bits: int = 10
    electrical_range: float = 4.71238898038469  # 270° of potentiometer over the whole ADC range [rad]
    white_std: float = 0.004  # per sample, wiper and supply noise [rad]
    offset_std: float = 0.004  # calibration error of each joint, fixed in an episode [rad]
    acceleration_std: float = 0.03  # base accelerometer, per control step [m/s²]
    acceleration_bias_std: float = 0.05  # [m/s²]
    tilt_time: float = 2.0  # low-pass that turns the accelerometer into the base's tilt [s]

    def __post_init__(self) -> None:
        _check_nonnegative(self)
        if not 1 <= self.adc_bits <= 24:
            raise ValueError(f"ToolSensorConfig.adc_bits must be in 1 … 24, got {self.adc_bits}")


@dataclass(frozen=True)
class ImuConfig:
    """Gyroscope, accelerometer and the attitude estimated from them."""

    gyro_std: float = 0.01  # per 2 ms sample [rad/s]
    gyro_bias_std: float = 0.002  # left after the estimator's correction [rad/s]
    acceleration_std: float = 0.05  # per control step [m/s²]
    acceleration_bias_std: float = 0.05  # [m/s²]
    attitude_limit: float = 0.003  # wander of estimated roll, pitch and yaw [rad]
    attitude_time: float = 30.0  # [s]

    def __post_init__(self) -> None:
        _check_nonnegative(self)


@dataclass(frozen=True)
class SensorConfig:
    """Every sensor. `velocity_std`, `velocity_time`: the velocity estimate's fast error; each source has a slow one."""

    gps: PositionSourceConfig = field(
        default_factory=lambda: PositionSourceConfig(
            rate=10.0,
            offset=(0.148, 0.067, 0.164),
            wander_limit=(0.187, 0.310, 0.198),
            wander_time=15.0,
            white_std=(0.02, 0.02, 0.02),
            velocity_limit=(0.02, 0.02, 0.01),
        )
    )
    vision: PositionSourceConfig = field(
        default_factory=lambda: PositionSourceConfig(
            rate=25.0,
            wander_limit=(0.047, 0.0, 0.053),
            wander_time=8.0,
            jump_size=(0.0, 0.34, 0.0),
            jump_interval=55.0,
            jump_duration=1.0,
            white_std=(0.005, 0.005, 0.005),
            velocity_limit=(0.01, 0.0, 0.004),
        )
    )
    dock: PositionSourceConfig = field(
        default_factory=lambda: PositionSourceConfig(rate=50.0, velocity_limit=(0.060, 0.067, 0.040))
    )
    truth: PositionSourceConfig = field(
        default_factory=lambda: PositionSourceConfig(rate=50.0, velocity_limit=(0.060, 0.067, 0.040))
    )
    tool: ToolSensorConfig = field(default_factory=ToolSensorConfig)
    imu: ImuConfig = field(default_factory=ImuConfig)
    velocity_wander_time: float = 20.0  # of `velocity_limit` [s]
    velocity_std: float = 0.015  # [m/s]
    velocity_time: float = 0.1  # [s]

    def __post_init__(self) -> None:
        _check_nonnegative(self)

    def scaled(self, factor: float) -> SensorConfig:
        """Every noise amplitude times `factor`, rates and time constants as they are: for randomisation and studies."""
        return _scale(self, factor)


_NOT_NOISE = {"rate", "adc_bits", "electrical_range"}


def _scale(config, factor: float):
    changes: dict[str, Any] = {}
    for f in fields(config):
        value = getattr(config, f.name)
        if f.name in _NOT_NOISE or f.name.endswith(("_time", "_interval", "_duration")):
            continue
        if isinstance(value, tuple):
            changes[f.name] = tuple(factor * v for v in value)
        elif isinstance(value, float):
            changes[f.name] = factor * value
        else:
            changes[f.name] = _scale(value, factor)
    return type(config)(**{**{f.name: getattr(config, f.name) for f in fields(config)}, **changes})
