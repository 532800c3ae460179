"""Paden–Kahan subproblems: the angles about given axes that take one point to another, compiled.

Murray, Li & Sastry 1994, "A Mathematical Introduction to Robotic Manipulation", section 3.2 (after Paden 1986; Kahan
1983). Where no angle takes the point all the way, the nearest one is given, and the caller finds out by the forward
kinematics; where any does, the one nearest to a reference.
"""

from __future__ import annotations

import math

from aerograsp_env.sim.kernel_math import compiled

_ON_AXIS = 1e-9  # of a vector's length: nearer to the axis than this it does not tell the angle


@compiled
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled
def rotated(w, angle, v):
    """v turned about the unit axis w (Rodrigues)."""
    s, c = math.sin(angle), math.cos(angle)
    k, along = cross(w, v), (1.0 - c) * dot(w, v)
    return c * v[0] + s * k[0] + along * w[0], c * v[1] + s * k[1] + along * w[1], c * v[2] + s * k[2] + along * w[2]


@compiled
def angle_between(w, u, v, reference):
    """Subproblem 1: the angle about w that turns u towards v; the reference where one of them lies along w."""
    a, b = cross(w, u), cross(w, v)  # both turned by 90° about w, seen along it
    least = _ON_AXIS * _ON_AXIS
    if dot(a, a) <= least * dot(u, u) or dot(b, b) <= least * dot(v, v):
        return reference
    return math.atan2(dot(w, cross(u, v)), dot(a, b))


@compiled
def two_angles(w1, w2, u, v, reference1, reference2, sign):
    """Subproblem 2: (θ1, θ2) with Rot(w1, θ1) Rot(w2, θ2) u = v, for axes that cross; `sign` ± 1 picks the solution."""
    c = dot(w1, w2)
    alpha = (c * dot(w2, u) - dot(w1, v)) / (c * c - 1.0)
    beta = (c * dot(w1, v) - dot(w2, u)) / (c * c - 1.0)
    n = cross(w1, w2)
    squared = (dot(u, u) - alpha * alpha - beta * beta - 2.0 * alpha * beta * c) / dot(n, n)
    gamma = sign * math.sqrt(max(squared, 0.0))
    z = (
        alpha * w1[0] + beta * w2[0] + gamma * n[0],
        alpha * w1[1] + beta * w2[1] + gamma * n[1],
        alpha * w1[2] + beta * w2[2] + gamma * n[2],
    )
    return angle_between(w1, z, v, reference1), angle_between(w2, u, z, reference2)


@compiled
def angle_to_distance(w, u, v, distance, reference, sign):
    """Subproblem 3: the angle about w that leaves u that far from v; `sign` ± 1 picks the solution.

    u and v are seen from a point of the axis.
    """
    a, b = cross(w, u), cross(w, v)
    long, wide = math.sqrt(dot(a, a)), math.sqrt(dot(b, b))
    middle = angle_between(w, u, v, reference)
    if long * wide <= 0.0:
        return middle
    along = dot(w, minus(u, v))
    cosine = (long * long + wide * wide - distance * distance + along * along) / (2.0 * long * wide)
    return middle + sign * math.acos(min(max(cosine, -1.0), 1.0))


@compiled
def shoulder_angles(axes, shoulder, elbow, point, target, reference, bend, lean):
    """The first three angles of an arm that take a point of its third link to a target (section 3.3, example 3.5).

    Axes 0 and 1 cross in `shoulder`, `elbow` is a point of axis 2, all at angle zero; `bend` and `lean` ± 1 pick one of
    four solutions.
    """
    goal = minus(target, shoulder)
    q2 = angle_to_distance(
        axes[2], minus(point, elbow), minus(shoulder, elbow), math.sqrt(dot(goal, goal)), reference[2], bend
    )
    bent = rotated(axes[2], q2, minus(point, elbow))
    reach = (bent[0] + elbow[0] - shoulder[0], bent[1] + elbow[1] - shoulder[1], bent[2] + elbow[2] - shoulder[2])
    q0, q1 = two_angles(axes[0], axes[1], reach, goal, reference[0], reference[1], lean)
    return q0, q1, q2


@compiled
def out_of_reach(shoulder, elbow, point, target, tolerance):
    """Whether a target is farther from the shoulder than both links in line, or nearer than folded, so nothing fits."""
    upper, fore, goal = minus(elbow, shoulder), minus(point, elbow), minus(target, shoulder)
    a, b, distance = math.sqrt(dot(upper, upper)), math.sqrt(dot(fore, fore)), math.sqrt(dot(goal, goal))
    return distance > a + b + tolerance or distance < abs(a - b) - tolerance
