"""The estimate of a pose in the body frame as a tracker on board delivers it, compiled.

Images come at a fixed rate; each gives the pose at that moment with white noise, a slow wander and the episode's bias,
and is delivered some steps later. Now and then tracking is lost for a while. Between deliveries the last one is held.
"""

from __future__ import annotations

import math

import numpy as np

from aerograsp_env.sim.kernel_math import bounded, compiled
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.manipulation.kernel_arm import multiply, turn


@compiled
def relative(rotation, position, target, out):
    """T_body_target (4, 4) of T_world_target (4, 4), for R_world_body (3, 3) and the body's position (3,)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = 0.0
            for k in range(3):
                out[i, j] += rotation[k, i] * target[k, j]
        out[i, 3] = 0.0
        for k in range(3):
            out[i, 3] += rotation[k, i] * (target[k, 3] - position[k])
        out[3, i] = 0.0
    out[3, 3] = 1.0


@compiled
def _measure(p, s, truth, noise, out):
    """One image's pose: truth with white noise, wander and bias."""
    vector, axis, twist = np.empty(3), np.empty(3), np.empty((4, 4))
    angle = 0.0
    for i in range(3):
        vector[i] = (
            p.track_bias[1, i] + p.track_wander[1] * bounded(s.track_slow[1, i]) + p.track_white[1] * noise[3 + i]
        )
        angle += vector[i] ** 2
    angle = math.sqrt(angle)
    for i in range(3):
        axis[i] = vector[i] / angle if angle > 0.0 else (1.0 if i == 2 else 0.0)
    turn(axis, angle, twist)
    multiply(truth, twist, out)
    for i in range(3):
        out[i, 3] += p.track_bias[0, i] + p.track_wander[0] * bounded(s.track_slow[0, i]) + p.track_white[0] * noise[i]


@compiled
def _deliver(p, s):
    """The newest image that is old enough becomes the estimate."""
    for c in range(lay.CAPTURES):
        age = s.capture_age[c]
        if age >= 0 and age >= p.track_delay:
            s.track[:] = s.captures[c]
            s.track_age = age
            return
    s.track_age += 1


@compiled
def begin_track(p, s, truth, noise):
    """The first estimate of an episode: all images up to now showed what the newest does. `noise` is the whole row."""
    row = noise[lay.TRACK_FIRST :]
    if p.track_exact == 1:
        s.track[:] = truth
        return
    _measure(p, s, truth, row, s.captures[0])
    for c in range(lay.CAPTURES):
        s.captures[c] = s.captures[0]
        s.capture_age[c] = int(s.track_phase + c * p.track_interval)
    _deliver(p, s)


@compiled
def track(p, s, truth, noise):
    """One control step of the tracker: the true T_body_tracked (4, 4) at its end, and the step's whole noise row."""
    if p.track_exact == 1:
        s.track[:] = truth
        s.track_age = 0
        return
    row = noise[lay.TRACK_FIRST :]
    a = p.track_wander_blend
    b = math.sqrt(1.0 - a * a)
    for k in range(2):
        for i in range(3):
            s.track_slow[k, i] = a * s.track_slow[k, i] + b * row[6 + 3 * k + i]
    for c in range(lay.CAPTURES):
        if s.capture_age[c] >= 0:
            s.capture_age[c] += 1
    s.track_lost = max(s.track_lost - 1, 0)
    s.track_phase += 1.0
    if s.track_phase >= p.track_interval:
        s.track_phase -= p.track_interval
        if s.track_lost == 0 and 0.5 * (1.0 + bounded(row[12])) < p.track_loss:
            s.track_lost = p.track_loss_steps
        if s.track_lost == 0:
            for c in range(lay.CAPTURES - 1, 0, -1):
                s.captures[c] = s.captures[c - 1]
                s.capture_age[c] = s.capture_age[c - 1]
            _measure(p, s, truth, row, s.captures[0])
            s.capture_age[0] = 0
    _deliver(p, s)
