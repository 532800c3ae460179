"""Reaching from the air (thesis sections 5.2 and 5.3): the tool follows a moving point while the vehicle drifts."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.envs.manipulation_base import ManipulationEnv
from aerograsp_env.envs.manipulation_options import manipulation_config
from aerograsp_env.envs.reach_task import SUCCESS_DISTANCE, ReachTask
from aerograsp_env.sim.arms.vehicles import VehicleConfig
from aerograsp_env.sim.autopilot import AutopilotConfig
from aerograsp_env.sim.manipulation.config import (
    ManipulationConfig,
    ManipulationRandomizeConfig,
    PoseEstimateConfig,
)
from aerograsp_env.sim.sensors import SensorConfig
from aerograsp_env.sim.wind import WindConfig


def reach_task(
    vehicle: str | VehicleConfig = "belerofonte",
    action_mode: str = "joint_velocity",
    target_speed: float = 0.1,
    pose: str = "exact",
    wind: str | WindConfig | dict = "light",
    localization: str = "vision",
    payload: float = 0.0,
    com_feedforward: bool = True,
    command_delay: Any = 0.0,
    randomize: bool | ManipulationRandomizeConfig | dict = False,
    estimate: PoseEstimateConfig | dict | None = None,
    sensors: SensorConfig | None = None,
    autopilot: AutopilotConfig | dict | None = None,
    config: ManipulationConfig | None = None,
) -> ReachTask:
    """The task that these options mean."""
    settings = manipulation_config(
        vehicle=vehicle, action_mode=action_mode, pose=pose, wind=wind, localization=localization, payload=payload,
        com_feedforward=com_feedforward, command_delay=command_delay, randomize=randomize, estimate=estimate,
        sensors=sensors, autopilot=autopilot, config=config,
    )  # fmt: skip
    return ReachTask(settings, target_speed)


def goal_reward(achieved: ArrayLike, desired: ArrayLike, sparse: bool) -> NDArray[np.float64]:
    """Reward (...) for goals (..., 3) [m]: −distance, or −1 where it is above 0.02 m and 0 elsewhere."""
    a, b = np.asarray(achieved, dtype=np.float64), np.asarray(desired, dtype=np.float64)
    x, y, z = a[..., 0] - b[..., 0], a[..., 1] - b[..., 1], a[..., 2] - b[..., 2]
    distance = np.sqrt(x * x + y * y + z * z)
    return -np.where(distance > SUCCESS_DISTANCE, 1.0, 0.0) if sparse else -distance


class GoalReward:
    """`compute_reward`, as hindsight replay asks for it."""

    reward_mode: str

    def compute_reward(self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any) -> Any:
        """The reward (...) of having reached `achieved_goal` (..., 3) when `desired_goal` (..., 3) was wanted [m].

        For a step's own goals it is that step's reward, to the last bit. `info` is not used.
        """
        reward = goal_reward(achieved_goal, desired_goal, self.reward_mode == "sparse")
        return float(reward) if np.ndim(reward) == 0 else reward


class ReachEnv(GoalReward, ManipulationEnv):
    """Hold the tool at a moving point, by joint rates, while the vehicle hovers in wind.

    The vehicle holds its place by itself, as well as its position source and the wind let it (PX4's position mode); the
    point moves in the world, along a smooth closed path below and in front of the vehicle, at constant speed. Goal-
    conditioned: `achieved_goal` is the tool by the arm's encoders, `desired_goal` the point, both in the body frame.
    A step lasts 20 ms (10 ticks of physics, autopilot and servos); the registered episode 10 s
    (`max_episode_steps=500`).

    Action, Box(−1, 1, (6,), float32):

    | # | name | full action | unit | frame |
    | --- | --- | --- | --- | --- |
    | 0 | joint0 | 2.0 | rad/s | joint |
    | 1 | joint1 | 2.0 | rad/s | joint |
    | 2 | joint2 | 2.0 | rad/s | joint |
    | 3 | joint3 | 2.0 | rad/s | joint |
    | 4 | joint4 | 2.0 | rad/s | joint |
    | 5 | joint5 | 2.0 | rad/s | joint |

    `vehicle="aquiles"` has four joints. With `action_mode="ee_twist"` the action is the tool's twist relative to the
    vehicle, body frame: linear (3, full action 0.25 m/s), angular (3, 1 rad/s), resolved by damped least squares.

    Observation, Dict of float32 Boxes within ± bound:

    | name | size | bound | what |
    | --- | --- | --- | --- |
    | observation | 33 | 20 | see below |
    | achieved_goal | 3 | 5 | tool, by encoder angles and kinematics, body frame [m] |
    | desired_goal | 3 | 5 | the point, body frame [m]; with `pose="estimated"` as a tracker on board reports it |

    `observation` holds, in this order (n joints; `observation_layout` has the slices):
    joints n [rad] and joint_rates n [rad/s] as the servos report them, command_lag n (servo set-points − joints) [rad],
    velocity 3 (the autopilot's estimate, body frame) [m/s], angular_velocity 3 (gyroscope) [rad/s], tilt 2 (roll,
    pitch) [rad], target_age 1 (since the image that `desired_goal` comes from) [s], previous_action (as many as the
    action has).

    Reward (dense), with d = |achieved_goal − desired_goal| as observed:

    | term | value |
    | --- | --- |
    | distance | −d |

    Sparse: `outside`, −1 where d > 0.02 m, else 0.

    `compute_reward(achieved_goal, desired_goal, info)` gives exactly the step's reward, for arrays of goals too.

    Success, at every step by itself: the true tool within 0.02 m of the true point.

    Termination (`info["termination"]`): a collision of the airframe, the vehicle out of bounds (3 m).

    `info["metrics"]`: error and error_max, mean and largest true distance after the first 2 s, hover, the mean distance
    of the airframe from where it began (these absent before); effort (rms change of action per step), contacts (steps
    in which the arm touched the vehicle or the surroundings), crash.

    Reset options: "goal" (3,), a point that does not move, body frame of the level vehicle [m]; "start" (n,), the first
    joint angles [rad]; "wind_direction" [rad].

    Options: `vehicle="belerofonte"|"aquiles"`, `action_mode="joint_velocity"|"ee_twist"`, `target_speed` [m/s] (0: a
    fixed point), `pose="exact"|"estimated"` and the tracker's `estimate`, `wind`, `localization="gps"|"vision"|"truth"`
    (of the hover), `payload` [kg at the tool, unknown to the vehicle], `com_feedforward` (False: the autopilot does not
    know where the arm is), `command_delay` (seconds, or a range drawn per episode), `randomize`, `sensors`,
    `autopilot`, `reward_mode`, `render_mode`, `camera`, and `config` for everything else (see
    `aerograsp_env.sim.manipulation.config`).
    """

    build = staticmethod(reach_task)

    @property
    def observation_layout(self) -> dict[str, slice]:
        """Where each part of `observation` stands."""
        return self.task.observation_layout  # type: ignore[attr-defined]
