"""MuJoCo's rays at single geoms, called through their C pointers."""

from __future__ import annotations

import ctypes
import functools
from pathlib import Path

import mujoco
import numpy as np
from llvmlite import ir
from numba import types

from aerograsp_env.sim.kernel_math import compiled, intrinsic

HFIELD = int(mujoco.mjtGeom.mjGEOM_HFIELD)


@functools.cache
def ray_functions() -> tuple[int, int]:
    """Addresses of mju_rayGeom and mj_rayHfield in the library that the Python package has loaded."""
    folder = Path(mujoco.__file__).parent
    for pattern in ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll"):
        for path in sorted(folder.glob(pattern)):
            library = ctypes.CDLL(str(path))
            ray_geom, ray_hfield = (
                int(ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0)
                for name in ("mju_rayGeom", "mj_rayHfield")
            )
            return ray_geom, ray_hfield
    raise RuntimeError(f"no MuJoCo library found beside {Path(mujoco.__file__).name}; is the mujoco package intact?")


_I32, _I64, _F64 = ir.IntType(32), ir.IntType(64), ir.DoubleType()


@intrinsic
def _call_geom(typingctx, function, position, rotation, size, origin, ray, kind, normal):
    """mju_rayGeom(pos, mat, size, pnt, vec, geomtype, normal) at address `function`."""
    del typingctx, function, position, rotation, size, origin, ray, kind, normal

    def codegen(context, builder, signature, args):
        del context, signature
        prototype = ir.FunctionType(_F64, [_I64] * 5 + [_I32, _I64])
        return builder.call(builder.inttoptr(args[0], prototype.as_pointer()), args[1:])

    return types.float64(*[types.intp] * 6, types.int32, types.intp), codegen


@intrinsic
def _call_hfield(typingctx, function, model, data, geom, origin, ray, normal):
    """mj_rayHfield(m, d, geomid, pnt, vec, normal) at address `function`."""
    del typingctx, function, model, data, geom, origin, ray, normal

    def codegen(context, builder, signature, args):
        del context, signature
        prototype = ir.FunctionType(_F64, [_I64] * 2 + [_I32] + [_I64] * 3)
        return builder.call(builder.inttoptr(args[0], prototype.as_pointer()), args[1:])

    return types.float64(*[types.intp] * 3, types.int32, *[types.intp] * 3), codegen


@compiled
def meet(functions, address, g, origin, ray, normal):
    """Distance at which a ray meets geom g, which is no mesh, or a negative number.

    functions: of `ray_functions`.
    address: (ngeom + 1, 4) kinds and the addresses of positions, rotations and sizes; at the end of model and data.
    origin, ray, normal: addresses of three numbers each; normal is written, unless it is 0.
    """
    kind = address[g, 0]
    if kind == HFIELD:
        return _call_hfield(functions[1], address[-1, 0], address[-1, 1], np.int32(g), origin, ray, normal)
    place = address[g]
    return _call_geom(functions[0], place[1], place[2], place[3], origin, ray, np.int32(kind), normal)
