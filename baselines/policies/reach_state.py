"""What the reaching policy is tuned by, and what it remembers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

JOINTS = 6  # at most
PAST = 32  # control steps of own motion remembered: the longest delay of an estimate that is made up for


class Settings(NamedTuple):
    """Gains of the servoing. Chosen on validation seeds."""

    gain: float = 8.0  # [1/s] of the goal configuration towards the point, and of the reference towards it
    share: float = 0.8  # of the joints' rate limits that the reference uses; the rest is for corrections
    damping: float = 0.05  # λ at a singularity, as a share of the arm's length
    threshold: float = 0.05  # least singular value below which damping begins, as a share of the arm's length
    posture_gain: float = 5.0  # [1/s] of joints away from near limits, with the motion that leaves the tool in place
    posture_weight: float = 0.01  # of that motion [m/rad]: well below the Jacobian's singular values
    sag_gain: float = 0.05  # of a control step's estimate of how far servos give way under load
    rotation_time: float = 0.04  # [s] low-pass of the angular velocity that is fed forward
    delay_margin: float = 0.3  # of gain · commands' delay: an integrator behind a delay overshoots above 1/e
    rotation_delays: float = 16.0  # that low-pass in delays, at least: what the arm does turns the vehicle as well
    acceleration: float = 0.6  # [m/s²] the point's, unknown, standard deviation
    noise: float = 0.002  # [m] of an estimate that is processed images
    exact_noise: float = 0.0001  # [m] of one without delay


STATE = np.dtype(
    [
        ("started", np.int64),
        ("step", np.int64),
        ("heading", np.float64),
        ("place", np.float64, (3,)),  # of the vehicle, level axes
        ("past", np.float64, (PAST, 4, 3)),  # R_level_body and place, newest at step % PAST
        ("age", np.float64),  # of the newest estimate [s]
        ("seen", np.int64),  # estimates so far
        ("point", np.float64, (3,)),  # when it was seen, level axes
        ("velocity", np.float64, (3,)),  # of the point, level axes
        ("rotation", np.float64, (3,)),  # angular velocity, low-passed
        ("stuck", np.int64),  # control steps in a row that the goal configuration has been off the point
        ("goal", np.float64, (JOINTS,)),  # configuration with the tool at the point
        ("reference", np.float64, (JOINTS,)),  # where the joints should be, on their way to the goal
        ("command", np.float64, (JOINTS,)),  # servo set-points as this policy gave them
        ("rate", np.float64, (JOINTS,)),  # their last rates
        ("behind", np.float64),  # sum of (set-points given − those that hold) · rates
        ("moved", np.float64),  # sum of rates²
        ("delay", np.float64),  # of commands, by these [s]
        ("sag", np.float64, (JOINTS,)),  # of set-points against joints that do not move
    ],
    align=True,
)
