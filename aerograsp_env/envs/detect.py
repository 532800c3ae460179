"""Detection in flight (thesis chapter 3): images from a moving vehicle in; classes, boxes and poses of objects out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.envs.detect_action import ACTION_SIZE, action_layout, action_to_detections
from aerograsp_env.envs.detect_motion import Start, camera_mount, draw_start
from aerograsp_env.envs.detect_options import DetectOptions, check_start, detect_options
from aerograsp_env.envs.detect_outcome import Outcome
from aerograsp_env.envs.detect_scene import Look, SeenScene, Sensor, draw_scene
from aerograsp_env.envs.detect_view import draw_detections
from aerograsp_env.envs.options import REWARD_MODES, built, check_action, choose
from aerograsp_env.interfaces import Detection
from aerograsp_env.metrics import TrueObject
from aerograsp_env.sim.flight import Flight
from aerograsp_env.sim.rendering import check_picture
from aerograsp_env.spatial import adjoint, inverse

FRAME = 0.1  # [s]
FRAMES = 40  # of an episode
VIEWS = 8  # drawn for an episode until one shows an object that counts
RENDER_MODES = ("rgb_array", "depth_array")

Observation = dict[str, NDArray[Any]]


class DetectEnv(gymnasium.Env):
    """See a scene from a moving vehicle, and say what is where, in every frame.

    A hexarotor carries a colour and depth camera past objects on a table, a floor or a pipe: it hovers, passes by or
    circles them, flown by its autopilot in wind. Each step shows one frame, 0.1 s after the last; the registered
    episode has 40. The action reports up to eight objects in the frame that was just seen: class, score, box and pose.

    Action, Box(−1, 1, (184,), float32), eight slots of 23 entries; entry 23 k + # of slot k:

    | # | name | full action | unit | frame |
    | --- | --- | --- | --- | --- |
    | 0 | presence | 1.0 | score where > 0 | none |
    | 1 | is_screwdriver | 1.0 | the largest names the class | none |
    | 2 | is_wrench | 1.0 | the largest names the class | none |
    | 3 | is_pliers | 1.0 | the largest names the class | none |
    | 4 | is_hammer | 1.0 | the largest names the class | none |
    | 5 | is_crawler | 1.0 | the largest names the class | none |
    | 6 | is_can | 1.0 | the largest names the class | none |
    | 7 | is_juice_box | 1.0 | the largest names the class | none |
    | 8 | is_box | 1.0 | the largest names the class | none |
    | 9 | is_fruit | 1.0 | the largest names the class | none |
    | 10 | box_x1 | 1.0 | image from edge to edge | image |
    | 11 | box_y1 | 1.0 | image from edge to edge | image |
    | 12 | box_x2 | 1.0 | image from edge to edge | image |
    | 13 | box_y2 | 1.0 | image from edge to edge | image |
    | 14 | position_x | 6.0 | m | camera |
    | 15 | position_y | 6.0 | m | camera |
    | 16 | position_z | 6.0 | m | camera |
    | 17 | x_axis_x | 1.0 | direction | camera |
    | 18 | x_axis_y | 1.0 | direction | camera |
    | 19 | x_axis_z | 1.0 | direction | camera |
    | 20 | y_axis_x | 1.0 | direction | camera |
    | 21 | y_axis_y | 1.0 | direction | camera |
    | 22 | y_axis_z | 1.0 | direction | camera |

    A slot with a presence of 0 or less is empty. The pose is T_c_object: position, and the first two columns of its
    rotation, made orthonormal. The objects' frames are those of `aerograsp_env.sim.visual.objects`.
    `detections_to_action` and `action_to_detections` of `aerograsp_env.envs.detect_action` translate.

    Observation, Dict of Boxes; `observed_frame` of the same module gives the images their shapes back:

    | name | size | bound | what |
    | --- | --- | --- | --- |
    | rgb | 240 x 320 x 3 | 0 … 255 | the image, uint8 |
    | depth | 76800 | 0 … 6 | its depth along the optical axis, row by row, 0 where there is no return [m] |
    | intrinsics | 4 | 0 … 10000 | fx, fy, cx, cy; the centre of the first pixel is (0, 0) [px] |
    | camera_tilt | 1 | 0 … 1.5707964 | of the camera's axis below the body's x axis [rad] |
    | angular_velocity | 3 | 20 | gyroscope, body frame [rad/s] |
    | velocity | 3 | 5 | the autopilot's velocity estimate, body frame [m/s] |
    | attitude | 3 | 3.1415927 | estimated roll, pitch, yaw; the yaw it began with is 0 [rad] |

    With sensors="stereo" there is no depth, but the image of a second camera `right` (like rgb), the same camera moved
    by `baseline` (1) [m] along its x axis.

    Reward (dense), the sum of `info["reward_terms"]`:

    | term | value |
    | --- | --- |
    | found | 0.5 · F1 of this frame at IoU 0.5; 1 in place of F1 where nothing is to be found and nothing is reported |
    | position | 0.25 · tolerance(position error, margin 0.05 m, linear), mean over the objects, 0 for a missed one |
    | rotation | 0.25 · tolerance(rotation error, margin 30°, linear), mean over the objects, 0 for a missed one |

    Sparse: `within`, 1 for a frame with an F1 of at least 0.7 and a median position error of at most 0.02 m.

    Objects of which less than 40 % are visible, or which are less than 12 px long, need not be found: neither reward
    nor fault. Rotation errors count up to the object's symmetries.

    Success: over the frames so far F1 at IoU 0.5 ≥ 0.7, and the median position error of the matches ≤ 0.02 m.

    Termination (`info["termination"]`): the flight's own (diverged, collision, out_of_bounds); none in practice.
    `info["metrics"]` holds, over the frames so far: map50, map75, recall, precision, f1, add_s (share of the objects
    that were found with ADD-S ≤ 0.1 diameters), position_error [m] and rotation_error [rad] (medians of the matches),
    jumps (how often an object's reported rotation jumped by more than 30° between frames). What nothing defines yet is
    left out.

    Options: `level="easy"|"cluttered"|"dark"|"blurred"`, `labels` (which classes there are), `mesh` (a file, or a YCB
    folder: what the objects of the one class in `labels` are), `motion="any"|"hover"|"pass"|"orbit"`,
    `sensors="rgbd"|"stereo"`, `camera_backend="ray"|"gl"` (shapes, textures and depth agree; OpenGL's light and shadows
    are MuJoCo's own, darker in bright scenes and lighter in dark ones; surfaces seen from within are not drawn),
    `camera_config` (image size, field of view, noise), `wind`,
    `randomize` (masses, rotors, gains and sensors of the vehicle; scenes, looks and lights are always drawn),
    `reward_mode`, `render_mode`.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": round(1.0 / FRAME)}  # noqa: RUF012  Gymnasium's way

    def __init__(
        self,
        render_mode: str | None = None,
        reward_mode: str = "dense",
        width: int = 640,
        height: int = 480,
        **options: Any,
    ) -> None:
        self.reward_mode = choose("reward_mode", reward_mode, REWARD_MODES)
        self.render_mode = None if render_mode is None else choose("render_mode", render_mode, RENDER_MODES)
        check_picture(width, height, prefix="render_")
        self._picture = (width, height)
        self.options: DetectOptions = built(detect_options, options)
        self._sensor = Sensor(self.options)
        self.observation_space = self._sensor.space
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (ACTION_SIZE,), np.float32)
        self.action_layout = action_layout()
        self._flight = Flight(self.options.wind, self.options.vehicle)
        self._scene: SeenScene | None = None
        self._start: Start | None = None
        self._look: Look | None = None  # the newest frame
        self._reported: tuple[Look, list[Detection]] | None = None  # the frame that the last action was about
        self._outcome = Outcome(self.reward_mode)
        self._frame = 0

    # what oracles and tools may read ------------------------------------------------------------------------------

    @property
    def truths(self) -> Sequence[TrueObject]:
        """What is true of the newest frame, for oracles; difficult objects among it."""
        return self._begun[1].truths

    @property
    def T_world_camera(self) -> NDArray[np.float64]:
        """(4, 4) where the newest frame was taken: the truth, for oracles."""
        return self._begun[1].T_world_camera.copy()

    @property
    def model(self) -> mujoco.MjModel:
        """The scene that the camera sees; the vehicle lives in a model of its own."""
        return self._begun[0].model

    @property
    def data(self) -> mujoco.MjData:
        """The scene's MjData."""
        return self._begun[0].data

    @property
    def dt(self) -> float:
        """Seconds per step."""
        return FRAME

    @property
    def motion(self) -> str:
        """How the vehicle moves in this episode: "hover", "pass" or "orbit"."""
        assert self._begun and self._start is not None
        return self._start.motion

    # Gymnasium's interface ----------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode.

        options: "motion" (hover, pass or orbit); "wind_direction" [rad], the azimuth the mean wind blows towards.
        """
        given = check_start(options)
        super().reset(seed=seed)
        rng, motion = self.np_random, given.pop("motion", self.options.motion)
        self._scene = draw_scene(self.options, rng)
        for _ in range(VIEWS):
            self._start = draw_start(motion, self._scene.target(rng), FRAMES * FRAME, rng)
            self._flight.reset(rng, given)
            self._frame = 0
            self._take(rng)
            if any(not true.difficult for true in self.truths):
                break
        self._reported = None
        self._outcome = Outcome(self.reward_mode)
        return self._observation(), self._outcome.info("")

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Say what is in the newest frame, and fly on by 0.1 s. The episode truncates by Gymnasium's TimeLimit."""
        _, look = self._begun
        assert self._start is not None
        values = check_action(action, (ACTION_SIZE,))
        if not np.isfinite(values).all():
            raise ValueError(f"action must be finite, got {int((~np.isfinite(values)).sum())} values that are not")
        found = action_to_detections(values, self._sensor.intrinsics)
        self._outcome.add(found, look.truths, look.T_world_camera)
        self._reported = look, found
        self._flight.advance(self._start.path, FRAME, self.np_random)
        self._frame += 1
        self._take(self.np_random)
        info = self._outcome.info(self._flight.termination)
        return self._observation(), float(sum(info["reward_terms"].values())), info["termination"] != "", False, info

    def render(self) -> NDArray[Any] | None:
        """The frame that the last action was about, with what it reported; before the first step the first frame."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() was called, but the environment was made without render_mode")
            return None
        look, found = self._reported or (self._begun[1], [])
        if self.render_mode == "depth_array":
            return self._sensor.enlarged_depth(look, self._picture)
        return draw_detections(look.rgb, found, self._sensor.intrinsics, self._picture)

    def close(self) -> None:
        """Free the renderer and the vehicle."""
        if self._scene is not None:
            self._scene.close()
        self._flight.close()

    # helpers ------------------------------------------------------------------------------------------------------

    @property
    def _begun(self) -> tuple[SeenScene, Look]:
        if self._scene is None or self._look is None:
            raise gymnasium.error.ResetNeeded("call reset() before anything else")
        return self._scene, self._look

    def _take(self, rng: np.random.Generator) -> None:
        """Take the frame that the camera sees now."""
        assert self._scene is not None and self._start is not None
        mount = camera_mount(self._start.tilt)
        T_world_camera = self._start.T_world_start @ self._flight.T_start_body() @ mount
        twist_c = adjoint(inverse(mount)) @ self._flight.twist_b()
        self._look = self._scene.look(T_world_camera, twist_c, self._frame * FRAME, rng)

    def _observation(self) -> Observation:
        assert self._look is not None and self._start is not None
        tilt = np.array([self._start.tilt], dtype=np.float32)
        return {**self._sensor.observed(self._look), "camera_tilt": tilt, **self._flight.readings()}
