"""Grasp planning from one view (thesis chapter 2): a partial cloud in, a parallel-jaw grasp out, judged by physics."""

from __future__ import annotations

from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from aerograsp_env.envs.grasp_cloud import (
    ACTION_SIZE,
    Cloud,
    Observation,
    action_layout,
    decode_action,
    encode_grasp,
    observation_space,
    pack_cloud,
    unpack_cloud,
)
from aerograsp_env.envs.grasp_options import GraspRandomizeConfig, ObjectChoice, check_start
from aerograsp_env.envs.grasp_outcome import metrics, reward_terms
from aerograsp_env.envs.grasp_start import begin
from aerograsp_env.envs.options import REWARD_MODES, check_action, choose, instance, randomization
from aerograsp_env.interfaces import Grasp
from aerograsp_env.sim.depth_view import DepthCameraConfig, PartialView
from aerograsp_env.sim.grasp_judge import JudgeConfig, Judgement, Recording, judge_grasp, record_grasp
from aerograsp_env.sim.grasp_scene import grasp_model
from aerograsp_env.sim.grasp_view import CAMERAS, GraspView
from aerograsp_env.sim.gripper import GripperConfig
from aerograsp_env.sim.objects import GraspObject
from aerograsp_env.sim.rendering import check_picture

__all__ = ["Cloud", "GraspPlanEnv", "decode_action", "encode_grasp", "unpack_cloud"]

Array = NDArray[np.float64]
RENDER_MODES = ("rgb_array", "depth_array")


class GraspPlanEnv(gymnasium.Env):
    """See an object from one side, and say how a floating parallel-jaw gripper should grasp it.

    An episode is one decision. The object lies anyhow (uniform over rotations); a depth camera looks at it from 0.5 m,
    from any azimuth and −20° to 70° above the horizon, and with probability 0.25 something hides 20–40 % of what it
    sees on one side. The grasp is then tried in MuJoCo: the open gripper comes along the approach axis, its fingers
    close with 25 N each, take the object's weight, lift it by 0.15 m and shake it along three axes
    (`aerograsp_env.sim.grasp_judge`). Contact forces alone hold the object.

    All of observation and action is in the cloud's frame: the world's axes (z up), the origin at the mean of the seen
    points.

    Action, Box(−1, 1, (10,), float32):

    | # | name | full action | unit | frame |
    | --- | --- | --- | --- | --- |
    | 0 | centre_x | 0.25 | m | cloud |
    | 1 | centre_y | 0.25 | m | cloud |
    | 2 | centre_z | 0.25 | m | cloud |
    | 3 | closing_x | 1.0 | direction | cloud |
    | 4 | closing_y | 1.0 | direction | cloud |
    | 5 | closing_z | 1.0 | direction | cloud |
    | 6 | approach_x | 1.0 | direction | cloud |
    | 7 | approach_y | 1.0 | direction | cloud |
    | 8 | approach_z | 1.0 | direction | cloud |
    | 9 | width | 0.1 | m, times (a + 1) / 2 | gripper |

    The centre lies midway between the pads, the fingers close along the closing axis, the approach axis points from
    the palm to the object, the width is the opening before closing. The closing axis is normalised; the approach axis
    is made orthogonal to it and normalised. Axes shorter than 0.001, or parallel, are no grasp. `decode_action` and
    `encode_grasp` of this module translate.

    Observation, Dict of float32 Boxes (`unpack_cloud` gives the shapes back):

    | name | size | bound | what |
    | --- | --- | --- | --- |
    | points | 1536 | 0.5 | 512 seen points, x y z each, with noise [m] |
    | normals | 1536 | 1 | their normals, x y z each, unit, towards the camera, fitted to the noisy points |
    | noise | 512 | 0 … 0.05 | standard deviation of each point along its viewing ray [m] |
    | viewpoint | 3 | 1 | where the camera stands [m] |
    | count | 1 | 0 … 512 | how many of the points are distinct; the others repeat some |

    Reward (dense), the sum of `info["reward_terms"]`, physical margins only:

    | term | value |
    | --- | --- |
    | survived | 0.5 · share of the time under load for which the object was held |
    | slip | 0.25 · tolerance(slip, margin 20 mm, linear) if held |
    | turn | 0.25 · tolerance(turn, margin 20°, linear) if held |

    Sparse: `held`, 1 if held.

    Success: held. At the end, after lift and shake, both fingers touch the object, and its centre of mass has moved
    less than 0.10 m relative to the gripper since the fingers closed.

    Termination (`info["termination"]`): held; dropped, lost under load; slipped away, lost while closing; missed, never
    between both fingers; collision, the open gripper cut more than 1 mm into the object on its way; degenerate, axes
    that say nothing. `info["metrics"]` holds held, survived, strict (held, slip < 20 mm and turn < 20°) and, where it
    was held, slip [m] and turn [rad] of the object in the gripper. `info` names the `object` and its `family`.

    Options: `objects="test"|"train"|"validation"`, an object's or a family's name, a mesh's path, a GraspObject, or a
    sequence of these (of a fixed list, seed s takes number s mod n, and resets without a seed draw; "train" and
    "validation" draw a new member at every reset), `points`, `gripper`, `depth_camera` (its noise too), `judge` (lift,
    shake), `randomize` (mass, friction, noise), `reward_mode`, `render_mode`, `camera`.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": 20}  # noqa: RUF012  Gymnasium's convention

    def __init__(
        self,
        render_mode: str | None = None,
        reward_mode: str = "dense",
        width: int = 480,
        height: int = 360,
        camera: str = "side",
        render_backend: str = "ray",
        render_samples: int = 1,
        objects: Any = "test",
        points: int = 512,
        gripper: GripperConfig | dict | None = None,
        depth_camera: DepthCameraConfig | dict | None = None,
        judge: JudgeConfig | dict | None = None,
        randomize: bool | GraspRandomizeConfig | dict = False,
    ) -> None:
        self.reward_mode = choose("reward_mode", reward_mode, REWARD_MODES)
        self.render_mode = None if render_mode is None else choose("render_mode", render_mode, RENDER_MODES)
        check_picture(width, height, render_backend, render_samples, prefix="render_")
        self._render_settings = (width, height, choose("camera", camera, CAMERAS), render_backend, render_samples)
        if isinstance(points, bool) or not isinstance(points, int | np.integer) or not 16 <= points <= 100_000:
            raise ValueError(f"points must be a whole number from 16 to 100000, got {points!r}")
        self.points = int(points)
        self.gripper = _configured("gripper", gripper, GripperConfig)
        self.depth_camera = _configured("depth_camera", depth_camera, DepthCameraConfig)
        self.judge_config = _configured("judge", judge, JudgeConfig)
        self.randomize = randomization(randomize, GraspRandomizeConfig)
        self._choice = ObjectChoice(objects)
        self.observation_space = observation_space(self.points)
        self.action_space = spaces.Box(-1.0, 1.0, (ACTION_SIZE,), np.float32)
        self.action_layout = action_layout(self.gripper)
        self._object: GraspObject | None = None
        self._seen: PartialView | None = None
        self._observation: Observation = {}
        self._tried: tuple[Grasp | None, Judgement] | None = None
        self._view: GraspView | None = None

    # what oracles and tools may read ------------------------------------------------------------------------------

    @property
    def object(self) -> GraspObject:
        """The episode's object, its mass and friction as drawn: the truth, for oracles."""
        self._check_begun()
        assert self._object is not None
        return self._object

    @property
    def T_cloud_object(self) -> Array:
        """(4, 4) where the object is: the truth, for oracles."""
        return self._partial_view.T_cloud_object.copy()

    @property
    def model(self) -> mujoco.MjModel:
        """The model in which the episode's grasp is judged (its world is the gripper's frame)."""
        return grasp_model(self.object, self.gripper)

    @property
    def data(self) -> mujoco.MjData:
        """A new MjData of `model`; every judgement makes its own."""
        return mujoco.MjData(self.model)

    @property
    def dt(self) -> float:
        """Seconds per step: the longest judgement."""
        config = self.judge_config
        return config.closing_time + config.load_time + config.lift_time + config.shake_time + config.hold_time

    def judge(self, grasp: Grasp | None) -> Judgement:
        """What would become of a grasp in the cloud's frame; deterministic, and the episode does not notice."""
        return judge_grasp(self.object, grasp, self.T_cloud_object, self.gripper, self.judge_config)

    # Gymnasium's interface ----------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode.

        options: "object", the name of one of the environment's objects or families; "orientation" (4,), the
        quaternion wxyz that turns the object's axes to the world's; "view" (3,), the direction from the object to the
        camera; "occluded", whether something hides one side of it.

        Raises:
            ValueError: an option that is none of these or not of its kind; an object that is too large for the camera,
                or that is not seen in ten drawn views or in the one asked for.
        """
        start = check_start(options, self._choice.names)
        super().reset(seed=seed)
        config = self.randomize, self.depth_camera, self.points, self.gripper
        self._object, self._seen = begin(self._choice, start, *config, seed, self.np_random)
        self._tried = None
        self._observation = pack_cloud(self._seen)
        self._drop_view()
        return self._copy(), self._info(None)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Try the grasp. The episode is over."""
        self._check_begun()
        if self._tried is not None:
            raise gymnasium.error.ResetNeeded("the episode's one grasp was tried: call reset() before step()")
        grasp = decode_action(check_action(action, (ACTION_SIZE,)), self.gripper)
        judgement = self.judge(grasp)
        self._tried = grasp, judgement
        info = self._info(judgement)
        return self._copy(), float(sum(info["reward_terms"].values())), True, False, info

    def render(self) -> NDArray[Any] | None:
        """Before the step the object and the seen points (dots); after it the end of the judgement."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() was called, but the environment was made without render_mode")
            return None
        recording = self._recording()
        view = self._scene_view()
        if recording is None:
            return view.before(self.render_mode)
        return view.during(recording, len(recording.times) - 1, self.render_mode)

    def film(self, fps: float = 20.0) -> list[NDArray[np.uint8]]:
        """Frames (H, W, 3) of the last step's judgement, approach included: it is run again, with the same outcome.

        Where nothing could be tried, one picture of the object.

        Raises:
            ValueError: an `fps` that is not positive.
            ResetNeeded: nothing was tried yet.
        """
        if not 0.0 < fps < np.inf:
            raise ValueError(f"fps must be positive, got {fps}")
        if self._tried is None:
            raise gymnasium.error.ResetNeeded("call step() before film()")
        recording = self._recording()
        view = self._scene_view()
        if recording is None:
            return [view.before("rgb_array")]
        return view.film(recording, fps)

    def close(self) -> None:
        """Free the renderer."""
        self._drop_view()

    # helpers ------------------------------------------------------------------------------------------------------

    @property
    def _partial_view(self) -> PartialView:
        self._check_begun()
        assert self._seen is not None
        return self._seen

    def _check_begun(self) -> None:
        if self._seen is None:
            raise gymnasium.error.ResetNeeded("call reset() before anything else")

    def _copy(self) -> Observation:
        return {name: value.copy() for name, value in self._observation.items()}

    def _info(self, judgement: Judgement | None) -> dict[str, Any]:
        return {
            "success": judgement is not None and judgement.held,
            "reward_terms": reward_terms(judgement, self.reward_mode),
            "metrics": {} if judgement is None else metrics(judgement),
            "termination": "" if judgement is None else judgement.outcome,
            "object": self.object.name,
            "family": self.object.family,
        }

    def _recording(self) -> Recording | None:
        if self._tried is None or self._tried[0] is None:
            return None
        return record_grasp(self.object, self._tried[0], self.T_cloud_object, self.gripper, self.judge_config)

    def _scene_view(self) -> GraspView:
        if self._view is None:
            self._view = GraspView(self.object, self.gripper, self._partial_view, *self._render_settings)
        return self._view

    def _drop_view(self) -> None:
        if self._view is not None:
            self._view.close()
            self._view = None


def _configured(name: str, value: Any, kind: type) -> Any:
    return kind() if value is None else instance(name, value, kind)
