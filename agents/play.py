"""Film an episode as GIF or MP4, or take a picture at its end.

aerograsp play aerograsp/Dock-v0 --policy pid-tuned --out dock.mp4
"""

from __future__ import annotations

import inspect
import itertools
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import load_env_creator
from numpy.typing import NDArray

from agents.arguments import Parser, add_env_kwargs, add_episodes, add_seed, guarded, positive_int
from agents.overlay import Readings, annotate
from agents.policies import env_spec, load_policy, option_errors, registered_policies
from agents.seeds import TEST_SEED

VIDEO_SUFFIXES = (".gif", ".mp4")
GIF_FPS = 50.0  # viewers slow down what is faster
_RUN_OUT = "still running"


@dataclass(frozen=True)
class Ending:
    """How a filmed episode ended."""

    seed: int
    seconds: float
    outcome: str  # "success", "failure", a termination ("joint_limit", …), or "still running"
    error: float | None  # of the last frame [m]

    def __str__(self) -> str:
        error = "" if self.error is None else f", |error| {1000.0 * self.error:.0f} mm"
        return f"seed {self.seed}: {self.outcome} after {self.seconds:.1f} s{error}"


def play(
    env_id: str,
    policy: str = "",
    out: str | Path | None = None,
    picture: str | Path | None = None,
    *,
    episodes: int = 1,
    seconds: float = 10.0,
    seed: int = TEST_SEED,
    env_kwargs: Mapping[str, Any] | None = None,
    fps: float = 20.0,
    overlay: bool = True,
    progress: bool = False,
) -> list[Ending]:
    """Film the first `seconds` of some episodes, one after the other; episode k resets with `seed + k`.

    Args:
        env_id: a registered id that renders `rgb_array`.
        policy: what `load_policy` takes; by default the id's first analytic policy.
        out: the film, .gif or .mp4.
        picture: the last frame without the overlay, .png.
        env_kwargs: options of the environment, those of its picture (`width`, `height`, `camera`, …) too.
        fps: frames per second of simulated and of film time.

    Where one step is a whole story and the environment has `film(fps)`, that is what is shown of it.

    Raises:
        ValueError: an unknown id, policy, option or suffix, or a number out of range.
        OSError: a folder is missing or cannot be written to. Both are found before anything is simulated.
    """
    from aerograsp_env.sim.video import write_png, write_video

    spec = env_spec(env_id)
    _check(out, picture, seconds, fps)
    kwargs = dict(env_kwargs or {})
    name = policy or next(iter(registered_policies(env_id)), "zero")
    actor = load_policy(env_id, name, {k: v for k, v in kwargs.items() if k not in _picture_options(kwargs)})
    with option_errors(spec):
        env = gymnasium.make(env_id, render_mode="rgb_array", disable_env_checker=True, **kwargs)
    if callable(watch := getattr(actor, "watch", None)):
        watch([env.unwrapped])  # an oracle
    endings: list[Ending] = []
    try:
        shots = _Shots(env, actor, name, seconds, fps, str(kwargs.get("camera", "side")), overlay, progress)
        frames = (frame for k in range(episodes) for frame in shots.episode(seed + k, endings, out is not None))
        if out is not None:
            write_video(out, frames, fps)
        else:
            for _ in frames:
                pass
        if picture is not None:
            write_png(picture, shots.draw())
    finally:
        env.close()
    return endings


def draws_pictures(env_id: str, env_kwargs: Mapping[str, Any]) -> bool:
    """Whether the environment renders `rgb_array`."""
    env = gymnasium.make(env_id, disable_env_checker=True, **env_kwargs)
    try:
        return "rgb_array" in env.metadata.get("render_modes", ())
    finally:
        env.close()


def _picture_options(kwargs: Mapping[str, Any]) -> set[str]:
    return {"width", "height", "camera", "render_backend", "render_samples"} & set(kwargs)


def _takes(env_id: str, option: str) -> bool:
    """Whether the environment has an option of this name for its pictures."""
    entry_point = env_spec(env_id).entry_point
    creator: Any = load_env_creator(entry_point) if isinstance(entry_point, str) else entry_point
    return creator is not None and option in inspect.signature(creator).parameters


def _check(out: str | Path | None, picture: str | Path | None, seconds: float, fps: float) -> None:
    """Everything that could fail after the work, before it."""
    if out is None and picture is None:
        raise ValueError("nothing to write: give --out FILE.gif|.mp4, --picture FILE.png, or both")
    for name, path, suffixes in (("out", out, VIDEO_SUFFIXES), ("picture", picture, (".png",))):
        if path is None:
            continue
        if Path(path).suffix.lower() not in suffixes:
            raise ValueError(f"{name}: expected a name that ends in {' or '.join(suffixes)}, got {str(path)!r}")
        folder = Path(path).absolute().parent
        if not folder.is_dir():
            raise FileNotFoundError(f"{name}: no such folder: {folder}")
        probe = folder / f".{Path(path).name}.probe"
        try:
            probe.touch()
            probe.unlink()
        except OSError as error:
            raise PermissionError(f"{name}: cannot write to folder {folder} ({error.strerror})") from error
    if not 0.0 < seconds < np.inf:
        raise ValueError(f"seconds: expected a positive number, got {seconds}")
    high = GIF_FPS if out is not None and Path(out).suffix.lower() == ".gif" else 1000.0
    if not 0.0 < fps <= high:
        raise ValueError(f"fps: expected a positive number of at most {high:g}, got {fps}")


class _Shots:
    """Steps one environment and draws it at the film's rate."""

    def __init__(
        self,
        env: gymnasium.Env,
        policy: Any,
        name: str,
        seconds: float,
        fps: float,
        camera: str,
        overlay: bool,
        progress: bool,
    ) -> None:
        self.env, self.policy, self.name, self.overlay, self.progress = env, policy, name, overlay, progress
        self.dt = float(getattr(env.unwrapped, "dt", 1.0 / env.metadata.get("render_fps", 50)))
        self.steps, self.fps, self.camera = max(round(seconds / self.dt), 1), fps, camera
        self.frames = max(round(seconds * fps), 1)

    def episode(self, seed: int, endings: list[Ending], film: bool) -> Iterator[NDArray[np.uint8]]:
        """The frames of one episode, if they are wanted; appends how it ended."""
        from tqdm import tqdm

        observation, info = self.env.reset(seed=seed)
        state, start, outcome, shown, step = None, np.array([True]), _RUN_OUT, 0, 0
        with tqdm(total=self.steps, desc=self.name, leave=False, disable=None if self.progress else True) as bar:
            while outcome == _RUN_OUT and step < self.steps:
                due = int((step * self.dt + 1e-9) * self.fps) + 1 if film else 0  # frames of the film so far
                if due > shown:
                    frame = self._frame(step, observation)
                    yield from itertools.repeat(frame, due - shown)  # a film may be faster than the task
                    shown = due
                batch = {key: np.asarray(value)[None] for key, value in observation.items()}
                action, state = self.policy.predict(batch, state=state, episode_start=start, deterministic=True)
                observation, _, terminated, truncated, info = self.env.step(action[0])
                start, step = np.array([False]), step + 1
                if terminated or truncated:
                    ended = "success" if info.get("success") else "failure"
                    outcome = (info.get("termination") or ended) if terminated else ended
                bar.update(1)
        if film:
            yield from self._last(step, observation, info, str(outcome))
        endings.append(Ending(seed, step * self.dt, str(outcome), self._error(observation)))

    def _last(
        self, step: int, observation: Mapping[str, Any], info: Mapping[str, Any], outcome: str
    ) -> Iterator[NDArray[np.uint8]]:
        """The episode's last picture, or what happened in its step where the environment can show that."""
        show = getattr(self.env.unwrapped, "film", None)
        if step == 0 or not callable(show):
            ended = "success" if info.get("success") else str(info.get("cause", "")).replace("_", " ")
            yield self._frame(step, observation, ended if "cause" in info else "")
            return
        note = ": ".join(filter(None, (str(info.get("object", "")), outcome)))
        for number, frame in enumerate(itertools.islice(show(self.fps), self.frames)):
            time = number / self.fps
            yield annotate(frame, Readings(time, self.name, note=note)) if self.overlay else frame

    def draw(self) -> NDArray[np.uint8]:
        """The scene as it is."""
        frame: Any = self.env.render()
        return frame

    def _frame(self, step: int, observation: Mapping[str, Any], note: str = "") -> NDArray[np.uint8]:
        frame = self.draw()
        if not self.overlay:
            return frame
        if "coupled" in observation:
            note = "coupled" if observation["coupled"][0] > 0.5 else "flying in"
        return annotate(frame, Readings(step * self.dt, self.name, self._error(observation), self._wind(), note))

    def _error(self, observation: Mapping[str, Any]) -> float | None:
        """True distance from the set-point where the simulator tells it, else the observed one [m]."""
        env: Any = self.env.unwrapped
        state, record = getattr(env, "state", None), getattr(env, "record", None)
        begun = state is not None and int(state["step"]) > 0
        if record is not None:  # of a task of arms
            return float(record["distance"]) if begun and "distance" in record.dtype.names else None
        if state is not None and begun:
            return float(np.linalg.norm(state["true_error"]))
        error = observation.get("position_error")
        return None if error is None else float(np.linalg.norm(error))

    def _wind(self) -> tuple[float, float] | None:
        from aerograsp_env.sim.manipulation.config import ManipulationConfig
        from aerograsp_env.sim.manipulation.look import camera_heading as by_arms
        from aerograsp_env.sim.scene_look import camera_heading as by_pipe

        env: Any = self.env.unwrapped
        state, config = getattr(env, "state", None), getattr(env, "config", None)
        docking = not isinstance(config, ManipulationConfig) or config.vehicle.tool
        heading = (by_pipe if docking else by_arms)(self.camera)
        if state is None or heading is None:
            return None
        x, y, _ = state["wind"]
        c, s = np.cos(heading), np.sin(heading)
        return float(s * x - c * y), float(c * x + s * y)


def main(argv: list[str]) -> int:
    """`aerograsp play ID`."""
    parser = Parser(prog="aerograsp play", description="Film an episode as GIF or MP4, or take a picture at its end.")
    parser.add_argument("id", metavar="ID", help="environment, e.g. aerograsp/Dock-v0")
    parser.add_argument(
        "--policy", metavar="NAME", default="", help="as for eval; default: the id's first analytic one"
    )
    parser.add_argument("--out", metavar="FILE", default=None, help="the film: .gif or .mp4")
    parser.add_argument("--picture", metavar="FILE", default=None, help="the last frame without overlay: .png")
    add_episodes(parser, 1)
    parser.add_argument("--seconds", metavar="S", type=float, default=10.0, help="of every episode that are filmed")
    add_seed(parser, TEST_SEED)
    add_env_kwargs(parser)
    parser.add_argument("--camera", metavar="NAME", default=None, help="side, front, tool (docking) or close (arms)")
    parser.add_argument("--width", metavar="PX", type=positive_int, default=None, help="480; 960 without --out")
    parser.add_argument("--height", metavar="PX", type=positive_int, default=None, help="360; 720 without --out")
    parser.add_argument("--fps", metavar="F", type=float, default=20.0, help="frames per second")
    parser.add_argument(
        "--samples", metavar="N", type=positive_int, default=None, help="N² rays a pixel: 1; 3 without --out"
    )
    parser.add_argument("--no-overlay", action="store_true", help="frames without time, policy, error and wind")
    args = parser.parse_args(argv)
    width, height, samples = (960, 720, 3) if args.out is None else (480, 360, 1)
    look = {"width": args.width or width, "height": args.height or height}
    for option, given, usual in (("camera", args.camera, "side"), ("render_samples", args.samples, samples)):
        if given is not None or _takes(args.id, option):
            look[option] = given or usual
    endings = play(
        args.id,
        args.policy,
        args.out,
        args.picture,
        episodes=args.episodes,
        seconds=args.seconds,
        seed=args.seed,
        env_kwargs={**look, **args.env_kwargs},
        fps=args.fps,
        overlay=not args.no_overlay,
        progress=True,
    )
    print(f"{' and '.join(filter(None, (args.out, args.picture)))}: {'; '.join(map(str, endings))}")
    return 0


if __name__ == "__main__":
    sys.exit(guarded("aerograsp play", main, sys.argv[1:]))
