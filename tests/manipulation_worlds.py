"""What the tests of vehicles with arms share: quiet worlds, records for compiled functions, an idle task."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.manipulation.config import ManipulationConfig
from aerograsp_env.sim.manipulation.parameters import make_parameters
from aerograsp_env.sim.manipulation.scene import OBJECT, build_model
from aerograsp_env.sim.manipulation.task import Episode, Task, arm_dimensions
from aerograsp_env.sim.manipulation.worlds import ManipulationWorlds
from aerograsp_env.sim.sensors import SensorConfig
from aerograsp_env.sim.wind import WIND_LEVELS

QUIET: dict[str, Any] = {
    "wind": WIND_LEVELS["calm"], "sensors": SensorConfig().scaled(0.0), "localization": "truth", "estimate": None,
}  # fmt: skip
"""Still air, everything sensed without error (but for the encoders' steps)."""

CUBE = 0.04  # [m]


def cube(spec: mujoco.MjSpec) -> None:
    """A free cube of 0.1 kg; gravity may be taken off it (`body_gravcomp`)."""
    body = spec.worldbody.add_body(
        name="object", mass=0.1, inertia=[2.7e-5] * 3, explicitinertial=True, pos=[0, 0, 0.1]
    )
    body.gravcomp = 1.0
    body.add_freejoint(name="object")
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=[CUBE / 2] * 3, mass=0.0, condim=4,
        contype=OBJECT.contype, conaffinity=OBJECT.conaffinity,
    )  # fmt: skip


class StillTask(Task):
    """Nothing to do: commands for the base's velocity, every joint and every gripper; first configurations by option.

    Reset options: "start", a list of joint angles, one an arm; "object" (7,), the pose of a cube.
    """

    observation = (("nothing", 1, 1.0),)
    record = np.dtype([("nothing", np.float64)])
    terms = ("nothing",)
    metrics = ("nothing",)
    reset_options = ("start", "object", "wind_direction")
    evaluate = staticmethod(lambda *arguments: None)

    def __init__(self, config: ManipulationConfig, with_cube: bool = False) -> None:
        super().__init__(config)
        dimensions, slots = arm_dimensions(config)
        grippers = [lay.GRIPPER_SLOT + i for i in range(len(config.machine.mounts))]
        self.actions = tuple(dimensions)
        self.slots = np.array([0, 1, 2, *slots, *grippers])
        self.with_cube = with_cube

    def reward_terms(self, reward_mode: str) -> tuple[str, ...]:
        return ("nothing",)

    def pieces(self):
        return (cube,) if self.with_cube else ()

    def begin(self, episode: Episode) -> None:
        for i, q in enumerate(episode.options.get("start", ())):
            episode.arm_joints(i)[:] = q
        if "object" in episode.options:
            a = int(episode.parameters["object_address"])
            episode.data.qpos[a : a + 7] = episode.options["object"]


class World:
    """One world of `StillTask`."""

    def __init__(self, with_cube: bool = False, options: dict[str, Any] | None = None, seed: int = 0, **config: Any):
        self.config = ManipulationConfig(**{**QUIET, **config})
        self.task = StillTask(self.config, with_cube)
        self.worlds = ManipulationWorlds(self.config, self.task, 1)
        self.rng = np.random.default_rng(seed)
        self.reset(**(options or {}))

    def reset(self, **options: Any) -> None:
        self.worlds.reset(0, self.rng, options)

    @property
    def model(self) -> mujoco.MjModel:
        return self.worlds.models[0]

    @property
    def data(self) -> mujoco.MjData:
        return self.worlds.datas[0]

    @property
    def state(self):
        return self.worlds.states[0]

    @property
    def parameters(self):
        return self.worlds.parameters[0]

    def tool(self, arm: int = 0) -> np.ndarray:
        """True T_world_tool."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.state["rotation"], self.state["position"]
        return T @ self.state["true_tool"][arm]

    def step(self, velocity=(0.0, 0.0, 0.0), arms=0.0, grippers=0.0, steps: int = 1) -> None:
        """`arms`: rates as shares of a full action, for all joints alike or one by one; `grippers` likewise."""
        count = len(self.config.machine.mounts)
        n = self.worlds.action_size - 3 - count
        action = np.concatenate([velocity, np.broadcast_to(arms, n), np.broadcast_to(grippers, count)])
        for _ in range(steps):
            self.worlds.step(action[None], [self.rng])


def records(config: ManipulationConfig | None = None):
    """Model, parameter and state records, as compiled functions take them, of a world that no episode has begun in."""
    config = config or ManipulationConfig(**QUIET)
    model = build_model(config)
    parameters, states = np.zeros(1, lay.PARAMETERS), np.zeros(1, lay.STATE)
    parameters[0] = make_parameters(config, model)
    return model, parameters.view(np.recarray)[0], states.view(np.recarray)[0]
