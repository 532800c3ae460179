"""Reaching from the air, measured: errors with and without feed-forward, harder conditions, and what an arm does."""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.sensors import SensorConfig
from agents.evaluation import evaluate
from agents.policies import checkpoints
from agents.reproduction import Reproduction, Request, text_table

EPISODES = 30
ENV_ID = "aerograsp/Reach-v0"
FEEDFORWARD, WITHOUT = "dls", "dls-no-feedforward"
VEHICLES = ("belerofonte", "aquiles")
TARGETS = {"fixed": 0.0, "0.1 m/s": 0.1}
POSES = ("exact", "estimated")
CONDITIONS: dict[str, dict[str, Any]] = {  # of a point that moves at 0.1 m/s and is seen without error
    "light wind": {},
    "gusts": {"wind": "gusty"},
    "delay of 60 ms": {"command_delay": 0.06},
    "payload of 0.3 kg": {"payload": 0.3},
    "vehicles drawn": {"randomize": True},
    "point at 0.2 m/s": {"target_speed": 0.2},
}
SWING_TIME, WATCHED = 1.0, 6.0  # [s]
HOVER_TARGET = 0.03  # [m]

NOTES = """\
{episodes} pinned episodes of 10 s a figure; the mean over them of the true distance from tool to point [mm], its mean
after the first 2 s, and the worst episode's. Light wind, a hover held by vision, 50 Hz. The point moves along a smooth
closed path in the world; "estimated" is a tracker of 30 Hz, 60 ms late, 2 mm white and up to 3 mm wandering error per
axis. Without feed-forward the same servoing goes to the point as it was last seen. Every episode counts, also
those in which the drifting vehicle takes a point out of the arm's reach or the arm has to change its configuration.
Hover: one arm swings from straight down to straight ahead in {swing:.0f} s, in still air and without sensor errors; the
largest distance of the airframe from its place within {watched:.0f} s."""


def swing(vehicle: str, com_feedforward: bool) -> NDArray[np.float64]:
    """Displacements (T, 3) [m] of a hovering vehicle whose arm swings from hanging to straight ahead, world axes."""
    env = gymnasium.make(
        ENV_ID,
        vehicle=vehicle,
        com_feedforward=com_feedforward,
        wind="calm",
        localization="truth",
        sensors=SensorConfig().scaled(0.0),
    )
    world: Any = env.unwrapped
    n = world.action_space.shape[0]
    env.reset(seed=0, options={"start": np.zeros(n)})
    rates = np.array([joint.scale for joint in world.action_layout])
    action = np.zeros(n, np.float32)
    action[1] = -0.5 * math.pi / SWING_TIME / rates[1]  # the shoulder; a negative angle leans ahead
    first, places = world.state["position"].copy(), []
    for k in range(round(WATCHED / world.dt)):
        env.step(action if k < round(SWING_TIME / world.dt) else np.zeros(n, np.float32))
        places.append(world.state["position"] - first)
    env.close()
    return np.array(places)


def run(request: Request, policies: tuple[str, ...] | None = None) -> Reproduction:
    """Errors by target, pose and feed-forward; of each policy in harder conditions; displacements of the hover.

    `policies` are the ones compared in harder conditions: by default both of ours and every shipped checkpoint.
    """
    episodes = request.episodes or EPISODES
    if policies is None:
        policies = (FEEDFORWARD, WITHOUT, *checkpoints(ENV_ID))

    def errors(policy: str, **options: Any) -> dict[str, Any]:
        result = evaluate(ENV_ID, policy, episodes, request.seed, options, progress=True)
        values = result.values("error")
        low, high = result.interval("error", "mean")
        figures = {"mean": float(values.mean()), "worst": float(values.max()), "interval": [low, high]}
        success, ended = result.mean("success"), int(np.sum(result.terminations != ""))
        return {"policy": policy, "options": options, **figures, "success": success, "ended_early": ended}

    servoing, harder, hover = [], [], []
    for vehicle in VEHICLES:
        for name, speed in TARGETS.items():
            for pose in POSES:
                pair = [
                    errors(policy, vehicle=vehicle, target_speed=speed, pose=pose) for policy in (FEEDFORWARD, WITHOUT)
                ]
                servoing.append({"vehicle": vehicle, "target": name, "pose": pose, "with": pair[0], "without": pair[1]})
    for name, options in CONDITIONS.items():
        harder.append({"condition": name, "policies": {p: errors(p, **options) for p in policies}})
    for vehicle in VEHICLES:
        largest = [float(np.linalg.norm(swing(vehicle, on), axis=1).max()) for on in (True, False)]
        hover.append({"vehicle": vehicle, "with": largest[0], "without": largest[1]})
    data = {"episodes": episodes, "servoing": servoing, "conditions": harder, "hover": hover}
    return Reproduction(_text(data, policies), data)


def _text(data: dict[str, Any], policies: tuple[str, ...]) -> str:
    rows = [["vehicle", "point", "pose", "with feed-forward [mm]", "worst", "without", "worst"]]
    for row in data["servoing"]:
        figures = [f"{1e3 * row[k][f]:.1f}" for k in ("with", "without") for f in ("mean", "worst")]
        rows.append([row["vehicle"], row["target"], row["pose"], *figures])
    parts = [text_table(rows, 3)]
    rows = [["moving point, exact [mm]", *policies]]
    for row in data["conditions"]:
        rows.append([row["condition"], *(f"{1e3 * row['policies'][p]['mean']:.1f}" for p in policies)])
    parts.append(text_table(rows, 1))
    rows = [["hover displaced by the arm [cm]", "with feed-forward", "", "without"]]
    for row in data["hover"]:
        mark = "✓" if row["with"] <= HOVER_TARGET else "✗"
        rows.append([row["vehicle"], f"{1e2 * row['with']:.1f}", mark, f"{1e2 * row['without']:.1f}"])
    parts.append(text_table(rows, 1))
    notes = NOTES.format(episodes=data["episodes"], swing=SWING_TIME, watched=WATCHED)
    return "\n\n".join([*parts, notes])
