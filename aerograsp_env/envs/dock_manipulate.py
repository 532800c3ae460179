"""Manipulation while docked (thesis section 5.4.7): hold the free arm's end-effector at a point in the world."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from aerograsp_env.envs.dock_manipulate_task import DockManipulateTask
from aerograsp_env.envs.manipulation_base import ManipulationEnv
from aerograsp_env.envs.manipulation_options import manipulation_config
from aerograsp_env.envs.options import choose, instance
from aerograsp_env.sim.arms.vehicles import BELEROFONTE_TOOL
from aerograsp_env.sim.autopilot import AutopilotConfig
from aerograsp_env.sim.docking_tool import DockingToolConfig
from aerograsp_env.sim.layout import LOCALIZATIONS
from aerograsp_env.sim.manipulation.config import ManipulationConfig, ManipulationRandomizeConfig
from aerograsp_env.sim.scene_look import CAMERAS
from aerograsp_env.sim.sensors import SensorConfig
from aerograsp_env.sim.wind import WindConfig


def dock_manipulate_task(
    docked: bool = True,
    localization: str = "dock",
    wind: str | WindConfig | dict = "light",
    payload: float = 0.0,
    com_feedforward: bool = True,
    velocity_limit: Any = 0.5,
    command_frame: str = "world",
    command_delay: Any = 0.0,
    randomize: bool | ManipulationRandomizeConfig | dict = False,
    sensors: SensorConfig | None = None,
    tool: DockingToolConfig | dict | None = None,
    autopilot: AutopilotConfig | dict | None = None,
    config: ManipulationConfig | None = None,
) -> DockManipulateTask:
    """The task that these options mean."""
    if not isinstance(docked, (bool, np.bool_)):
        raise ValueError(f"docked must be True or False, got {docked!r}")
    source = choose("localization", localization, tuple(LOCALIZATIONS))
    free = manipulation_config(
        vehicle=BELEROFONTE_TOOL, wind=wind, localization="truth", payload=payload, com_feedforward=com_feedforward,
        velocity_limit=velocity_limit, command_delay=command_delay, randomize=randomize, sensors=sensors,
        autopilot=autopilot, config=config,
    )  # fmt: skip
    pilot, frame = free.autopilot, choose("command_frame", command_frame, ("world", "heading"))
    settings = replace(
        free,
        active=("right",),
        hold=False,
        docked=bool(docked),
        localization=source,
        autopilot=replace(pilot, command_frame=frame) if frame != "world" else pilot,
        tool=instance("tool", tool, DockingToolConfig) if tool is not None else free.tool,
    )
    return DockManipulateTask(settings)


class DockManipulateEnv(ManipulationEnv):
    """Docked to a pipe by the passive tool, hold the free arm's end-effector at a point in wind.

    The left arm holds the docking tool, from which the vehicle knows where it is; the right arm has six joints. The
    point stands still in the world, is known exactly, and is seen from where the vehicle believes to be. Velocity
    commands hold the vehicle at its set-point, joint rates servo the arm. A step lasts 20 ms (10 ticks of physics,
    autopilot and servos); the registered episode 30 s (`max_episode_steps=1500`).

    Action, Box(−1, 1, (9,), float32):

    | # | name | full action | unit | frame |
    | --- | --- | --- | --- | --- |
    | 0 | velocity_x | 0.5 | m/s | world |
    | 1 | velocity_y | 0.5 | m/s | world |
    | 2 | velocity_z | 0.5 | m/s | world |
    | 3 | joint0 | 2.0 | rad/s | joint |
    | 4 | joint1 | 2.0 | rad/s | joint |
    | 5 | joint2 | 2.0 | rad/s | joint |
    | 6 | joint3 | 2.0 | rad/s | joint |
    | 7 | joint4 | 2.0 | rad/s | joint |
    | 8 | joint5 | 2.0 | rad/s | joint |

    `velocity_limit=` changes the scale of the first three (never above the thesis's Table 5.2: 2, 2, 1 m/s),
    `command_frame="heading"` their frame.

    Observation, Dict of float32 Boxes within ± bound. The first ten are those of Dock-v0:

    | name | size | bound | what |
    | --- | --- | --- | --- |
    | position_error | 3 | 5 | set-point − estimated airframe position, command frame [m] |
    | error_integral | 3 | 5 | its leaky integral, time constant 10 s [m s] |
    | velocity | 3 | 5 | the autopilot's velocity estimate, command frame [m/s] |
    | attitude | 3 | 3.1415927 | estimated roll, pitch, yaw [rad] |
    | angular_velocity | 3 | 20 | gyroscope, body frame [rad/s] |
    | specific_force | 3 | 100 | accelerometer, body frame [m/s²] |
    | joints | 5 | 3.1415927 | docking tool's joints θ0 … θ4, mean of the step's 24 potentiometer samples [rad] |
    | base_acceleration | 3 | 20 | accelerometer of the docking tool's base, base frame [m/s²] |
    | previous_actions | 54 | 1 | the last six actions, newest first |
    | set_point | 3 | 5 | set-point − nominal airframe position, world frame [m] |
    | arm_joints | 6 | 3.1415927 | angles as the servos report them [rad] |
    | arm_rates | 6 | 20 | speeds as the servos report them [rad/s] |
    | arm_loads | 6 | 2 | torques as shares of their limits, mean over the step |
    | arm_lag | 6 | 1 | servo set-points − arm_joints [rad] |
    | end_effector | 9 | 5 | by arm_joints, body frame: position [m], then the rotation's first two columns |
    | target | 3 | 5 | the point from the estimated airframe position, body frame as estimated [m] |

    Reward (dense), the sum of `info["reward_terms"]`, with e the true distance of the end-effector from the point:

    | term | value |
    | --- | --- |
    | position | 0.5 · tolerance(e, margin 0.50 m, linear) |
    | precision | 0.5 · tolerance(e, margin 0.02 m, long_tail) |
    | effort | −0.2 · min(‖Δaction‖², 4) |
    | crash | −10 on termination |

    Sparse: `within`, 1 while e ≤ 0.02 m.

    Success: no termination, and the mean of e after the first 5 s ≤ 0.02 m.

    Termination (`info["termination"]`): a joint of the docking tool pressed through its printed stop, a collision of
    the airframe, a clamp force above the tool's strength, the vehicle out of bounds (3 m).

    `info["metrics"]`: error and error_max, the mean and the largest e; estimate_error, the mean distance from the
    end-effector to where the vehicle believes it; hover, the mean distance of the airframe from its set-point (all
    after 5 s, absent before); effort (rms change of action per step), contacts (steps in which the arm touched the
    vehicle or the surroundings), crash and the largest clamp force.

    Reset options: "goal" (3,), the point, from the airframe's nominal place in world axes [m]; "start" (3,), where the
    airframe begins, from its set-point [m]; "arm_start" (6,), the first joint angles [rad]; "tilt" (2,), of the clamped
    base about the horizontal axes [rad]; "wind_direction" [rad]. What is not given is drawn.

    Options: `localization="dock"|"gps"|"vision"|"truth"`, `docked` (False: free hover, docking tool hanging), `wind`,
    `payload` [kg at the end-effector, unknown to the vehicle], `com_feedforward` (False: the autopilot does not know
    where the arm is), `velocity_limit`, `command_frame`, `command_delay` (seconds, or a range drawn per episode),
    `randomize`, `sensors`, `tool`, `autopilot`, `reward_mode`, `render_mode`, `camera`, and `config` for everything
    else (see `aerograsp_env.sim.manipulation.config`).
    """

    build = staticmethod(dock_manipulate_task)
    cameras = (*CAMERAS, "vehicle")
