"""Small compiled helpers: calls through MuJoCo's C pointers, 3-vectors, bounded wandering."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic as numba_intrinsic

intrinsic: Any = numba_intrinsic  # its stub counts the typing context among a caller's arguments
# C's rules for division by zero (infinities, no exception): the checks cost more than the divisions
compiled = njit(cache=True, nogil=True, error_model="numpy")


@intrinsic
def call_with_two_pointers(typingctx, function, first, second):
    """Call the C function at address `function` with two pointers, e.g. mj_step(m, d).

    The address is an argument, not a global, so that the compiled code can be cached on disk.
    """
    del typingctx, function, first, second

    def codegen(context, builder, signature, args):
        del signature
        prototype = ir.FunctionType(ir.VoidType(), [ir.IntType(64), ir.IntType(64)])
        builder.call(builder.inttoptr(args[0], prototype.as_pointer()), [args[1], args[2]])
        return context.get_dummy_value()

    return types.void(types.intp, types.intp, types.intp), codegen


@intrinsic
def as_pointer(typingctx, address):
    """An integer address as a void pointer, for `numba.carray`."""
    del typingctx, address

    def codegen(context, builder, signature, args):
        del context, signature
        return builder.inttoptr(args[0], cgutils.voidptr_t)

    return types.voidptr(types.intp), codegen


@compiled
def clip(x, low, high):
    return min(max(x, low), high)


@compiled
def all_finite(rows):
    """Whether every entry of a (N, M) array is finite. For the few of an action this costs less than numpy's own."""
    for n in range(rows.shape[0]):
        for i in range(rows.shape[1]):
            if not math.isfinite(rows[n, i]):
                return False
    return True


@compiled
def bounded(x):
    """2Φ(x) − 1: a standard normal to a uniform value in (−1, 1)."""
    return math.erf(x * 0.7071067811865476)


@compiled
def tool_forward(lengths, q, position, rotation):
    """Pose of the tip in the base frame (thesis equations 5.1–5.4): writes position (3,) and rotation (3, 3)."""
    a1 = q[1]
    a2 = a1 + q[2]
    a3 = a2 + q[3]
    s3, c3 = math.sin(a3), math.cos(a3)
    # in the plane of the chain, before θ0: y and z
    y = -(lengths[1] * math.sin(a1) + lengths[2] * math.sin(a2) + lengths[3] * s3) + lengths[4] * c3
    z = lengths[0] + lengths[1] * math.cos(a1) + lengths[2] * math.cos(a2) + lengths[3] * c3 + lengths[4] * s3
    s0, c0 = math.sin(q[0]), math.cos(q[0])
    s4, c4 = math.sin(q[4]), math.cos(q[4])
    position[0], position[1], position[2] = -s0 * y, c0 * y, z
    # Rz(θ0) Rx(a3) Ry(θ4)
    xy, xz = s3 * s4, -c3 * s4
    zy, zz = -s3 * c4, c3 * c4
    rotation[0, 0], rotation[1, 0], rotation[2, 0] = c0 * c4 - s0 * xy, s0 * c4 + c0 * xy, xz
    rotation[0, 1], rotation[1, 1], rotation[2, 1] = -s0 * c3, c0 * c3, s3
    rotation[0, 2], rotation[1, 2], rotation[2, 2] = c0 * s4 - s0 * zy, s0 * s4 + c0 * zy, zz


@compiled
def upright(up, rotation):
    """Smallest rotation that takes the unit vector along `up` to z: writes (3, 3). Identity if `up` is not usable."""
    n = math.sqrt(up[0] ** 2 + up[1] ** 2 + up[2] ** 2)
    rotation[:] = np.eye(3)
    if n < 1e-6 or up[2] < 0.0:
        return
    x, y, z = up[0] / n, up[1] / n, up[2] / n
    k = 1.0 / (1.0 + z)
    rotation[0, 0], rotation[0, 1], rotation[0, 2] = 1.0 - k * x * x, -k * x * y, -x
    rotation[1, 0], rotation[1, 1], rotation[1, 2] = -k * x * y, 1.0 - k * y * y, -y
    rotation[2, 0], rotation[2, 1], rotation[2, 2] = x, y, z
