"""Grasping from the air with two arms: the pipe crawler, by two of its handles (thesis sections 2.4 and 5.2)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from aerograsp_env.envs.grasp import LiftEnv
from aerograsp_env.envs.grasp_levels import DUAL_LEVELS, GraspLevel, grasp_level
from aerograsp_env.envs.grasp_pool import CrawlerPool
from aerograsp_env.envs.grasp_task import GraspTask, grasp_config
from aerograsp_env.sim.arms.vehicles import VehicleConfig
from aerograsp_env.sim.autopilot import AutopilotConfig
from aerograsp_env.sim.manipulation.config import ManipulationConfig, ManipulationRandomizeConfig, PoseEstimateConfig
from aerograsp_env.sim.sensors import SensorConfig
from aerograsp_env.sim.wind import WindConfig


def grasp_dual_task(
    level: str | GraspLevel | Mapping[str, Any] = "easy",
    vehicle: str | VehicleConfig = "belerofonte",
    action_mode: str = "joint_velocity",
    pose: str = "estimated",
    wind: str | WindConfig | dict | None = None,
    com_feedforward: bool = True,
    velocity_limit: Any = 0.5,
    command_delay: Any = 0.0,
    randomize: bool | ManipulationRandomizeConfig | dict = False,
    estimate: PoseEstimateConfig | dict | None = None,
    sensors: SensorConfig | None = None,
    autopilot: AutopilotConfig | dict | None = None,
    config: ManipulationConfig | None = None,
) -> GraspTask:
    """The task that these options mean, with both of the vehicle's arms."""
    chosen = grasp_level(level, DUAL_LEVELS)
    settings = grasp_config(
        chosen, ("right", "left"), vehicle=vehicle, action_mode=action_mode, pose=pose, wind=wind,
        com_feedforward=com_feedforward, velocity_limit=velocity_limit, command_delay=command_delay,
        randomize=randomize, estimate=estimate, sensors=sensors, autopilot=autopilot, config=config,
    )  # fmt: skip
    return GraspTask(settings, chosen, CrawlerPool(chosen))


class GraspDualEnv(LiftEnv):
    """Hover, take the pipe crawler by two of its handles, one with each arm, and lift it.

    As `aerograsp/Grasp-v0` (`aerograsp_env.envs.grasp.GraspEnv`), with both arms, the right one first. The crawler
    (`aerograsp_env.sim.objects.crawler`; its three handles are `crawler_handles()`, in the object's frame) stands on
    its drive units on a table or on a pipe's saddle, midway between the arms. The registered episode lasts 20 s
    (`max_episode_steps=1000`).

    Action, Box(−1, 1, (17,), float32):

    | # | name | full action | unit | frame |
    | --- | --- | --- | --- | --- |
    | 0 | velocity_x | 0.5 | m/s | heading |
    | 1 | velocity_y | 0.5 | m/s | heading |
    | 2 | velocity_z | 0.5 | m/s | heading |
    | 3 | right_joint0 | 2.0 | rad/s | joint |
    | 4 | right_joint1 | 2.0 | rad/s | joint |
    | 5 | right_joint2 | 2.0 | rad/s | joint |
    | 6 | right_joint3 | 2.0 | rad/s | joint |
    | 7 | right_joint4 | 2.0 | rad/s | joint |
    | 8 | right_joint5 | 2.0 | rad/s | joint |
    | 9 | right_gripper | 0.03 | m/s of each finger, > 0 closes | jaws |
    | 10 | left_joint0 | 2.0 | rad/s | joint |
    | 11 | left_joint1 | 2.0 | rad/s | joint |
    | 12 | left_joint2 | 2.0 | rad/s | joint |
    | 13 | left_joint3 | 2.0 | rad/s | joint |
    | 14 | left_joint4 | 2.0 | rad/s | joint |
    | 15 | left_joint5 | 2.0 | rad/s | joint |
    | 16 | left_gripper | 0.03 | m/s of each finger, > 0 closes | jaws |

    Observation, Dict of float32 Boxes within ± bound; of what each arm has, the right one's come first:

    | name | size | bound | what |
    | --- | --- | --- | --- |
    | velocity | 3 | 5 | the autopilot's velocity estimate, body frame [m/s] |
    | attitude | 3 | 3.1415927 | estimated roll, pitch, yaw [rad] |
    | angular_velocity | 3 | 20 | gyroscope, body frame [rad/s] |
    | joints | 12 | 3.1415927 | encoder angles [rad] |
    | joint_rates | 12 | 20 | speeds that the servos report [rad/s] |
    | joint_loads | 12 | 1.5 | servo torques as shares of their limits |
    | command_lag | 12 | 1 | servo set-points − encoder angles [rad] |
    | gripper | 4 | 2 | opening [m]; motor load as a share of its stall force |
    | tool | 18 | 2 | tool frame by encoders, body frame: position [m], rotation |
    | object | 9 | 5 | crawler's frame as the tracker reports it, body frame: position [m], rotation |
    | object_age | 1 | 20 | time since the image that `object` and `support` come from [s] |
    | support | 6 | 5 | the surface the crawler stood on, body frame: outward normal, the seat's middle [m] |
    | previous_action | 17 | 1 | the action just given |
    | object_cloud | 1536 | 1 | tracker's model: 256 × (point [m], outward normal), crawler's frame |

    Reward (dense), the sum of `info["reward_terms"]`, with h the rise of the crawler's centre of mass since the start:

    | term | value |
    | --- | --- |
    | reach | 0.2 · tolerance(mean distance of both tools from its surface, margin 0.15 m, long_tail) |
    | grip | 0.05 for each finger that touches it |
    | lift | 0.3 · clip(h / 0.10 m, 0, 1) while a finger touches it |
    | hold | 0.3 while h ≥ 0.10 m and a finger touches it |
    | effort | −0.1 · min(‖Δaction‖², 4) |
    | crash | −10 on termination |

    Sparse: `held`, 1 while h has been ≥ 0.10 m for 1 s.

    Success: h ≥ 0.10 m for 1 s without a break at some time of the episode, and no crash in it. The episode goes on.

    Termination, `info["cause"]` and `info["metrics"]` are those of Grasp-v0; "it holds the object" when all four
    fingers touch the crawler, and slip is that in the right jaws.

    Levels (`level=`), drawn uniformly per episode unless single:

    | level | wind | support | crawler [kg] | its friction | estimate's bias | delay |
    | --- | --- | --- | --- | --- | --- | --- |
    | easy | light | level table or saddle, ± 10° | 1.0–1.4 | 0.7 | 0–2 mm, 0–0.5° | 60 ms |
    | gusty | gusty | as easy | as easy | 0.7 | as easy | 60 ms |
    | biased | light | as easy | as easy | 0.7 | 5–15 mm, 0–3° | 100 ms |
    | oblique | light | 5–15° (in steps of 5°), any heading | as easy | 0.7 | as easy | 60 ms |
    | heavy | light | as easy | 1.4–1.8 | 0.25–0.45 | as easy | 60 ms |

    The crawler's heading is a multiple of 60° from its support's: with the support straight, two handles are where a
    line across the vehicle through the centre of mass meets both. Its centre of mass begins 0.16 m ahead of the arms'
    bases and 0.49 m below them, ± 3, 3 and 2 cm.

    Reset options: "object" ("pipe_crawler"), "wind_direction" [rad].

    Options: those of Grasp-v0 but for objects: `level`, `vehicle`, `action_mode`, `pose`, `estimate`, `wind`,
    `com_feedforward`, `velocity_limit`, `command_delay`, `randomize`, `sensors`, `autopilot`, `reward_mode`,
    `render_mode`, `camera`, `config`.
    """

    build = staticmethod(grasp_dual_task)
