"""Grasping from the air with one arm (thesis chapters 2 and 5): hover, reach, grip, lift."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.envs.grasp_kernel import CLOUD
from aerograsp_env.envs.grasp_levels import GraspLevel, grasp_level
from aerograsp_env.envs.grasp_pool import GraspPool
from aerograsp_env.envs.grasp_task import GraspTask, grasp_config
from aerograsp_env.envs.manipulation_base import ManipulationEnv
from aerograsp_env.sim.arms.vehicles import VehicleConfig
from aerograsp_env.sim.autopilot import AutopilotConfig
from aerograsp_env.sim.manipulation.config import ManipulationConfig, ManipulationRandomizeConfig, PoseEstimateConfig
from aerograsp_env.sim.sensors import SensorConfig
from aerograsp_env.sim.wind import WindConfig


def object_cloud(observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
    """(..., 256, 6) of an observation or a batch of them: points [m] and outward unit normals, object frame.

    Raises:
        ValueError: an observation without an `object_cloud` of that size.
    """
    if "object_cloud" not in observation:
        raise ValueError(f"observation: expected an 'object_cloud', got {sorted(observation)}")
    values = np.asarray(observation["object_cloud"], dtype=np.float64)
    if values.ndim == 0 or values.shape[-1] != 6 * CLOUD:
        raise ValueError(f"observation: expected {6 * CLOUD} values of 'object_cloud', got shape {values.shape}")
    return values.reshape(*values.shape[:-1], CLOUD, 6)


def grasp_task(
    level: str | GraspLevel | Mapping[str, Any] = "easy",
    objects: Any = "test",
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
    """The task that these options mean, with the vehicle's right arm."""
    chosen = grasp_level(level)
    settings = grasp_config(
        chosen, ("right",), vehicle=vehicle, action_mode=action_mode, pose=pose, wind=wind,
        com_feedforward=com_feedforward, velocity_limit=velocity_limit, command_delay=command_delay,
        randomize=randomize, estimate=estimate, sensors=sensors, autopilot=autopilot, config=config,
    )  # fmt: skip
    jaws = settings.machine.mounts[0].arm.gripper.jaws
    return GraspTask(settings, chosen, GraspPool(objects, chosen, jaws))


class LiftEnv(ManipulationEnv):
    """What the tasks of one arm and of two have in common."""

    task: GraspTask

    def _info(self) -> dict[str, Any]:
        return super()._info() | self.task.told(self.record)


class GraspEnv(LiftEnv):
    """Hover, reach, grip and lift an object with one arm.

    The object stands on a table or on a pipe's saddle within the reach of the vehicle's right arm; its pose comes from
    a tracker on board, noisy, late and a little wrong. The vehicle follows velocity commands and drifts with the error
    of its own velocity estimate; it knows no position, only the object's and the support's in its own frame. A step
    lasts 20 ms (10 ticks of physics, autopilot, servos and gripper); the registered episode 20 s
    (`max_episode_steps=1000`).

    Action, Box(−1, 1, (10,), float32):

    | # | name | full action | unit | frame |
    | --- | --- | --- | --- | --- |
    | 0 | velocity_x | 0.5 | m/s | heading |
    | 1 | velocity_y | 0.5 | m/s | heading |
    | 2 | velocity_z | 0.5 | m/s | heading |
    | 3 | joint0 | 2.0 | rad/s | joint |
    | 4 | joint1 | 2.0 | rad/s | joint |
    | 5 | joint2 | 2.0 | rad/s | joint |
    | 6 | joint3 | 2.0 | rad/s | joint |
    | 7 | joint4 | 2.0 | rad/s | joint |
    | 8 | joint5 | 2.0 | rad/s | joint |
    | 9 | gripper | 0.03 | m/s of each finger, > 0 closes | jaws |

    The heading frame has x where the vehicle points and z up. `vehicle="aquiles"` has four joints. With
    `action_mode="ee_twist"` the arm's entries are the tool's twist relative to the vehicle, body frame: linear (3, full
    action 0.25 m/s), angular (3, 1 rad/s). The gripper's screw stops by itself when its motor stalls, and cannot be
    driven back: at 0 it keeps what it holds.

    Observation, Dict of float32 Boxes within ± bound:

    | name | size | bound | what |
    | --- | --- | --- | --- |
    | velocity | 3 | 5 | the autopilot's velocity estimate, body frame [m/s] |
    | attitude | 3 | 3.1415927 | estimated roll, pitch, yaw [rad] |
    | angular_velocity | 3 | 20 | gyroscope, body frame [rad/s] |
    | joints | 6 | 3.1415927 | encoder angles [rad] |
    | joint_rates | 6 | 20 | speeds that the servos report [rad/s] |
    | joint_loads | 6 | 1.5 | servo torques as shares of their limits |
    | command_lag | 6 | 1 | servo set-points − encoder angles [rad] |
    | gripper | 2 | 2 | opening [m]; motor load as a share of its stall force |
    | tool | 9 | 2 | tool frame by encoders, body frame: position [m], rotation |
    | object | 9 | 5 | object's frame as the tracker reports it, body frame: position [m], rotation |
    | object_age | 1 | 20 | time since the image that `object` and `support` come from [s] |
    | support | 6 | 5 | the surface the object stood on, body frame: outward normal, the seat's middle [m] |
    | previous_action | 10 | 1 | the action just given |
    | object_cloud | 1536 | 1 | tracker's model: 256 × (point [m], outward normal), object's frame (`object_cloud`) |

    Rotations are 6-D (their first two columns, one after the other). The support is seen in the same images, with the
    same errors of place. `object_cloud` is the same throughout an episode.

    Reward (dense), the sum of `info["reward_terms"]`, with h the rise of the object's centre of mass since the start:

    | term | value |
    | --- | --- |
    | reach | 0.2 · tolerance(distance tool–object's surface, margin 0.15 m, long_tail) |
    | grip | 0.1 for each finger that touches the object |
    | lift | 0.3 · clip(h / 0.10 m, 0, 1) while a finger touches it |
    | hold | 0.3 while h ≥ 0.10 m and a finger touches it |
    | effort | −0.1 · min(‖Δaction‖², 4) |
    | crash | −10 on termination |

    Sparse: `held`, 1 while h has been ≥ 0.10 m for 1 s.

    Success: h ≥ 0.10 m for 1 s without a break at some time of the episode, and no crash in it. The episode goes on.

    Termination (`info["termination"]`): a collision of the airframe, or the vehicle out of bounds (3 m).
    `info["cause"]` sorts failures, as if the episode ended now; the first rule that holds (`""` is success):

    | cause | when |
    | --- | --- |
    | collided | the vehicle crashed |
    | timed_out | it holds the object (both fingers for 0.2 s), 2 cm or more above its start |
    | jammed | it holds the object, lower than that |
    | slipped | it held the object or had lifted it by 2 cm, and holds it no longer |
    | collided | the arm touched surroundings or vehicle in 50 steps or more, or the object fell off its support |
    | jammed | a servo protects itself from overload |
    | missed | the jaws were closed by 30 % of their travel, and never held it |
    | timed_out | they never were |

    `info["metrics"]`: lift (largest h) [m], lift_time (until success; while there is none, so far) [s], hover (mean
    distance of the airframe from where it began) [m], slip (largest displacement of the object in the jaws since they
    held it) [m], effort (rms change of action per step), contacts (steps in which the arm touched the vehicle or the
    surroundings), crash, and for each cause 1 or 0. `info["object"]` and `info["support"]` name what was drawn.

    Levels (`level=`), drawn uniformly per episode unless single:

    | level | wind | support | object [kg] | its friction | estimate's bias | delay |
    | --- | --- | --- | --- | --- | --- | --- |
    | easy | light | level table or saddle, ± 10° | 0.10–0.25 | 0.7 | 0–2 mm, 0–0.5° | 60 ms |
    | gusty | gusty | as easy | as easy | 0.7 | as easy | 60 ms |
    | biased | light | as easy | as easy | 0.7 | 5–15 mm, 0–3° | 100 ms |
    | oblique | light | 15–30° (in steps of 5°), any heading | as easy | 0.7 | as easy | 60 ms |
    | heavy | light | as easy | 0.2–0.8 | 0.25–0.45 | as easy | 60 ms |
    | combined | gusty | as oblique | 0.2–0.8 | 0.25–0.45 | 15–30 mm, 0–6° | 150 ms |

    The pads' friction is 0.7, a contact's the geometric mean of both. Biases have any direction. The object's centre of
    mass begins 0.16 m ahead of the arm's base and 0.49 m below it (aquiles: 0.15 and 0.46 m), ± 4, 4 and 2 cm
    (combined: ± 8, 8 and 3 cm), lower where it would come nearer than 3 cm to the open fingers. Objects and resting
    poses are those that the jaws can take by geometry alone: an antipodal pair at most 9 cm wide, around which the open
    gripper has room, approached from at most 70° off the vertical (`aerograsp_env.sim.manipulation.jaw_room`).

    Reset options: "object", the name of one of the environment's objects or families; "wind_direction" [rad].

    Options: `level` (a name, a GraspLevel, or a mapping of changes to the easy one), `objects="test"|"train"|
    "validation"`, an object's or a family's name, a mesh's path, a GraspObject, or a sequence of the last four;
    `vehicle="belerofonte"|"aquiles"`, `action_mode="joint_velocity"|"ee_twist"`, `pose="estimated"|"exact"` and the
    tracker's `estimate` (but for what the level says of it), `wind` (instead of the level's), `com_feedforward`,
    `velocity_limit`, `command_delay` (seconds, or a range drawn per episode), `randomize`, `sensors`, `autopilot`,
    `reward_mode`, `render_mode`, `camera`, and `config` for everything else.
    """

    build = staticmethod(grasp_task)
