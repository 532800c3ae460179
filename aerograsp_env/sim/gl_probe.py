"""Whether OpenGL works here, found out in a process of its own: a bad driver can crash the one that asks."""

from __future__ import annotations

import functools

from aerograsp_env.own_process import fault_of

_PROGRAM = """
import mujoco
from aerograsp_env.sim.rendering import FreeCamera, make_renderer
model = mujoco.MjModel.from_xml_string('<mujoco><worldbody><geom size="1" rgba="1 0 0 1"/></worldbody></mujoco>')
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
picture = make_renderer(model, 32, 24, "gl").render(data, FreeCamera())
assert picture[12, 16, 0] > 2 * picture[12, 16, 2], f"a red ball came out as {picture[12, 16]}"
"""


@functools.cache
def gl_fault() -> str | None:
    """None if a picture comes out right with this process's environment (MUJOCO_GL), else one line that says why not.

    The first call takes a few seconds; its answer is kept.
    """
    return fault_of(_PROGRAM)
