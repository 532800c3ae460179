"""Whether a renderer works here, found out in a process of its own: a bad driver can crash the one that asks."""

from __future__ import annotations

import functools

from aerograsp_env.own_process import fault_of

_PROGRAM = """
import sys
import mujoco
from aerograsp_env.sim.rendering import FreeCamera, make_renderer
model = mujoco.MjModel.from_xml_string('<mujoco><worldbody><geom size="1" rgba="1 0 0 1"/></worldbody></mujoco>')
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
picture = make_renderer(model, 32, 24, sys.argv[1]).render(data, FreeCamera())
assert picture[12, 16, 0] > 2 * picture[12, 16, 2], f"a red ball came out as {picture[12, 16]}"
"""


def renderer_fault(backend: str, gl: str | None = None) -> str | None:
    """None if a picture of a backend ("ray", "gl") comes out right, else one line that says why not.

    It takes a few seconds. MUJOCO_GL is `gl` then; None: as in this process.
    """
    return fault_of(_PROGRAM, backend) if gl is None else fault_of(_PROGRAM, backend, MUJOCO_GL=gl)


@functools.cache
def gl_fault() -> str | None:
    """`renderer_fault` of OpenGL with this process's environment (MUJOCO_GL); the first call's answer is kept."""
    return renderer_fault("gl")
