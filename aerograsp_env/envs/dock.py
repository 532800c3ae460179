"""Docked positioning (thesis sections 5.4.2–5.4.6): hold a hexarotor at a set-point by velocity commands in wind."""

from __future__ import annotations

from aerograsp_env.envs.base import DockBase


class DockEnv(DockBase):
    """Docked to a pipe by the passive tool, hold a set-point in wind.

    The action is the velocity set-point of the autopilot (thesis figure 5.16: outer position loop around PX4's velocity
    loop). A step lasts 20 ms (10 physics and autopilot ticks); the registered episode 60 s (`max_episode_steps=3000`).

    Action, Box(−1, 1, (3,), float32):

    | # | name | full action | unit | frame |
    | --- | --- | --- | --- | --- |
    | 0 | velocity_x | 0.5 | m/s | world |
    | 1 | velocity_y | 0.5 | m/s | world |
    | 2 | velocity_z | 0.5 | m/s | world |

    `velocity_limit=` changes the scale (never above the thesis's Table 5.2: 2, 2, 1 m/s), `command_frame="heading"` the
    frame.

    Observation, Dict of float32 Boxes within ± bound:

    | name | size | bound | what |
    | --- | --- | --- | --- |
    | position_error | 3 | 5 | set-point − estimated airframe position, command frame [m] |
    | error_integral | 3 | 5 | its leaky integral, time constant 10 s [m s] |
    | velocity | 3 | 5 | the autopilot's velocity estimate, command frame [m/s] |
    | attitude | 3 | 3.1415927 | estimated roll, pitch, yaw [rad] |
    | angular_velocity | 3 | 20 | gyroscope, body frame [rad/s] |
    | specific_force | 3 | 100 | accelerometer, body frame [m/s²] |
    | joints | 5 | 3.1415927 | tool joints θ0 … θ4, mean of the step's 24 potentiometer samples [rad] |
    | base_acceleration | 3 | 20 | accelerometer of the tool's base, base frame [m/s²] |
    | previous_actions | 18 | 1 | the last six actions, newest first |
    | set_point | 3 | 5 | set-point − nominal airframe position, world frame [m] |

    Reward (dense), the sum of `info["reward_terms"]`, with e the distance of the true position from the set-point:

    | term | value |
    | --- | --- |
    | position | 0.5 · tolerance(e, margin 0.20 m, linear) |
    | precision | 0.5 · tolerance(e, margin 0.02 m, long_tail) |
    | effort | −0.2 · min(‖Δaction‖², 4) |
    | crash | −10 on termination |

    Sparse: `within`, 1 while every axis' true |error| ≤ 0.05 m.

    Success: no termination, and the mean true |error| of every axis after the first 5 s ≤ 0.05 m.

    Termination (`info["termination"]`): a tool joint pressed through its printed stop, a collision, a clamp force above
    the tool's strength, the vehicle out of bounds. `info["metrics"]` holds mean |error|, bias and spread per axis after
    5 s (absent before), effort (rms change of action per step), crash and the largest clamp force.

    Options: `wind`, `localization="dock"|"gps"|"vision"|"truth"`, `docked` (False: free hover, tool hanging),
    `randomize`, `command_delay` (seconds, or a range drawn per episode), `payload` [kg, unknown to the autopilot],
    `airframe`, `sensors`, `tool`, `autopilot`, `reward_mode`, `render_mode`, and `config` for everything else (see
    `aerograsp_env.sim.config`).
    """

    attach = False


class DockAttachEnv(DockBase):
    """Fly in, couple the tool to the pipe, and hold the docked set-point.

    The vehicle begins 0.3–0.6 m behind and 0.35–0.55 m above the place where its hanging tool meets the pipe, localised
    by vision until it is coupled and by the tool from then on. θ0 is locked by its servo until the coupling. The tool
    couples when the last action says so (> 0), its base is within 4 cm and 20° of the seat and the vehicle slower than
    0.4 m/s; the clamp then closes in 0.5 s.

    Action, Box(−1, 1, (5,), float32):

    | # | name | full action | unit | frame |
    | --- | --- | --- | --- | --- |
    | 0 | velocity_x | 0.5 | m/s | world |
    | 1 | velocity_y | 0.5 | m/s | world |
    | 2 | velocity_z | 0.5 | m/s | world |
    | 3 | yaw_rate | 0.5 | rad/s | world |
    | 4 | couple | 1.0 | couples when > 0 and the base lies in the seat | none |

    Observation, Dict of float32 Boxes within ± bound:

    | name | size | bound | what |
    | --- | --- | --- | --- |
    | position_error | 3 | 5 | docked set-point − estimated airframe position, command frame [m] |
    | error_integral | 3 | 5 | its leaky integral, time constant 10 s, from zero at the coupling [m s] |
    | velocity | 3 | 5 | the autopilot's velocity estimate, command frame [m/s] |
    | attitude | 3 | 3.1415927 | estimated roll, pitch, yaw [rad] |
    | angular_velocity | 3 | 20 | gyroscope, body frame [rad/s] |
    | specific_force | 3 | 100 | accelerometer, body frame [m/s²] |
    | joints | 5 | 3.1415927 | tool joints θ0 … θ4 [rad] |
    | base_acceleration | 3 | 20 | accelerometer of the tool's base, base frame [m/s²] |
    | previous_actions | 30 | 1 | the last six actions, newest first |
    | set_point | 3 | 5 | docked set-point − docked nominal, world frame [m] |
    | seat_offset | 3 | 5 | estimated vector from the tool's base to the seat, world frame [m] |
    | coupled | 1 | 1 | 1 once coupled |

    Reward (dense): the terms of Dock-v0, earned once coupled, and

    | term | value |
    | --- | --- |
    | position | 0.5 · tolerance(e, margin 0.20 m, linear), 0 before the coupling |
    | precision | 0.5 · tolerance(e, margin 0.02 m, long_tail), 0 before the coupling |
    | approach | 0.3 · tolerance(distance base–seat, margin 1 m, long_tail); 0.3 once coupled |
    | effort | −0.2 · min(‖Δaction‖², 4) |
    | crash | −10 on termination |

    Sparse: `within`, 1 while coupled and every axis' true |error| ≤ 0.05 m.

    Success: coupled, and for the last 5 s so held: the mean true |error| of every axis over them ≤ 0.05 m; no
    termination.
    """

    attach = True
