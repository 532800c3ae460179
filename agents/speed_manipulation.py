"""`aerograsp bench aerograsp/Reach-v0 --speed` and the same of Grasp-v0: what a step and a plan cost, in one run.

Measured as `agents.speed` does it: what is compared runs in turns, warm, medians and quartiles over repeats. A flight
of the reference policy is recorded and replayed, so that its decisions cost nothing.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

import aerograsp_env
from aerograsp_env.sim.layout import SUBSTEPS
from agents.arguments import Parser, add_json, guarded, positive_int
from agents.bench_setup import GRASP, GRASP_DUAL, REACH
from agents.files import write_json
from agents.policies import UnknownName
from agents.provenance import provenance
from agents.speed import Row, as_tuple, positive_seconds, table
from agents.speed_peers import FETCH_SCRIPT, PeerProcess
from agents.speed_runners import (
    PROCESSOR,
    WALL,
    BareSteps,
    Flight,
    Replay,
    in_turns,
    make_batch,
    make_single,
    record,
    reset_times,
)

STEPS = {REACH: 400, GRASP: 500}  # of the recorded flight; Grasp's takes the object and lifts it
CHUNK = 10  # steps that are timed together: over more, bare steps under a held command leave the flight's state
NUM_ENVS = 32
SEEDS = 5  # flights that are tried for one that ends nowhere
PEER = "FetchPickAndPlace-v4"
PLANS, LOOK = 8, 150  # episodes that are planned in; steps until a policy has planned
NO_PEER = "--peer-python PATH names an interpreter with gymnasium-robotics and mujoco < 3.12"


def steady(env: Any, env_id: str, steps: int) -> Flight:
    """A recorded flight that did not end early.

    Raises:
        RuntimeError: there is none among the first seeds.
    """
    failed = ""
    for seed in range(SEEDS):
        try:
            return record(env, steps, CHUNK, seed, env_id)
        except RuntimeError as error:
            failed = str(error)
    raise RuntimeError(failed)


def step_rows(env_id: str, seconds: float, repeats: int, peer: PeerProcess | None) -> list[Row]:
    """`env.step` against bare MuJoCo steps of the same flight, and against the peer's physics steps."""
    name = env_id.removeprefix("aerograsp/")
    env = make_single(env_id)
    flight = steady(env, env_id, STEPS[env_id])
    bare, replay = BareSteps(flight), Replay(env, flight)
    times = in_turns({"bare": bare, "env": replay}, seconds, repeats)
    step = {key: 1e6 * values / CHUNK for key, values in times.items()}
    ratio = step["bare"] / step["env"]
    rows = [
        Row(f"bare loop of {SUBSTEPS} × mj_step", "µs", as_tuple(step["bare"])),
        Row(f"{name}, env.step", "µs", as_tuple(step["env"])),
        Row(f"{name} / bare loop, speed", "", as_tuple(ratio), "≥ 0.75"),
        Row(f"{name} / bare loop, speed by wall time", "", as_tuple(ratio, WALL)),
        Row(f"{name}, simulated / wall time", "×", as_tuple(1e6 * env.unwrapped.dt / step["env"], WALL)),
        *peer_rows(name, replay, seconds, repeats, peer),
        Row(f"{name}, reset", "ms", tuple((1e3 * reset_times(env, max(10, 3 * repeats))).tolist())),
    ]
    env.close()
    return rows


def peer_rows(name: str, ours: Replay, seconds: float, repeats: int, peer: PeerProcess | None) -> list[Row]:
    """Physics steps per second, ours over the peer's."""
    title = f"{name} / {PEER}, physics steps"
    if peer is None or PEER in peer.peers.missing:
        return [Row(title, "×", (), "≥ 2", NO_PEER if peer is None else peer.peers.missing[PEER])]
    theirs, own = np.zeros((repeats, 2)), np.zeros((repeats, 2))
    for repeat in range(repeats):
        own[repeat] = CHUNK * SUBSTEPS / in_turns({"ours": ours}, seconds, 1)["ours"][0]
        theirs[repeat] = peer.speed(PEER, seconds)
    return [
        Row(f"{name}, physics steps per second", "1/s", as_tuple(own)),
        Row(f"{PEER}, physics steps per second", "1/s", as_tuple(theirs)),
        Row(title, "×", as_tuple(own / theirs), "≥ 2"),
        Row(f"{title} by wall time", "×", as_tuple(own / theirs, WALL)),
    ]


def batch_rows(env_id: str, seconds: float, repeats: int, num_envs: int = NUM_ENVS) -> list[Row]:
    """A world's step in the native batched environment against the single environment's, along the same phases."""
    name, steps = env_id.removeprefix("aerograsp/"), STEPS[env_id]
    single, one, all_ = make_single(env_id), make_batch(num_envs, 1, env_id), make_batch(num_envs, None, env_id)
    flights = steady(single, env_id, steps), steady(one, env_id, steps)
    rows = []
    for batch, threads, clock in ((one, "1 thread", PROCESSOR), (all_, "all cores", WALL)):
        runners = {"single": Replay(single, flights[0]), "batch": Replay(batch, flights[1])}
        times = in_turns(runners, seconds, repeats)
        world = 1e6 * times["batch"] / (CHUNK * num_envs)
        ratio = 1e6 * times["single"] / CHUNK / world
        title = f"{name}, batch of {num_envs}, {threads}"
        rows += [
            Row(f"{title}: a world's step", "µs", as_tuple(world, clock)),
            Row(f"{title} / single env, speed", "", as_tuple(ratio, clock)),
        ]
    for env in (single, one, all_):
        env.close()
    return rows


class Timed:
    """A planner that notes the processor time of its calls."""

    def __init__(self, planner: Callable[..., Any]) -> None:
        self._planner = planner
        self.seconds: list[float] = []

    def __call__(self, *arguments: Any) -> Any:
        """The planner's answer."""
        began = time.process_time()
        answer = self._planner(*arguments)
        self.seconds.append(time.process_time() - began)
        return answer


def planning_times(env_id: str, episodes: int) -> NDArray[np.float64]:
    """Seconds of the reference policy's first plan in each of some episodes: grasps, reach and collisions, all arms.

    The first of all, which compiles and loads, does not count.
    """
    env = gymnasium.make(env_id, disable_env_checker=True)
    policy: Any = aerograsp_env.reference_policy(env_id)
    timed = policy.flight.planner = Timed(policy.flight.planner)
    for seed in range(episodes + 1):
        observation, _ = env.reset(seed=seed)
        state, before = None, len(timed.seconds)
        for _ in range(LOOK):
            if len(timed.seconds) > before:
                break
            action, state = policy.predict(observation, state=state)
            observation, *_ = env.step(action)
    env.close()
    return np.array(timed.seconds[1:])


def planning_rows(episodes: int) -> list[Row]:
    """What a plan costs, for one arm and for two."""
    return [
        Row(title, "s", tuple(planning_times(env_id, episodes).tolist()), "≤ 1.0", "grasps, reach and collisions")
        for env_id, title in ((GRASP, "a plan for one arm"), (GRASP_DUAL, "a plan for two arms"))
    ]


def speed(
    env_id: str,
    seconds: float = 0.5,
    repeats: int = 7,
    peer_python: str | None = None,
    num_envs: int = NUM_ENVS,
    plans: int = PLANS,
    command: str = "agents.speed_manipulation.speed",
) -> dict[str, Any]:
    """Measure everything of one id; arguments and result as `agents.speed.speed` has them.

    Raises:
        UnknownName: an id that is not measured here.
        OSError: the peer's interpreter cannot be run.
    """
    if env_id not in STEPS:
        raise UnknownName("id whose speed is measured", env_id, STEPS)
    peer = None if peer_python is None else PeerProcess(peer_python, FETCH_SCRIPT)
    try:
        rows = step_rows(env_id, seconds, repeats, peer)
        versions = {} if peer is None else peer.peers.versions
    finally:
        if peer is not None:
            peer.close()
    rows += batch_rows(env_id, seconds, repeats, num_envs)
    if env_id == GRASP:
        rows += planning_rows(plans)
    settings = {"environment": env_id, "seconds": seconds, "repeats": repeats, "num_envs": num_envs, "plans": plans}
    return {"provenance": provenance(command), "settings": settings, "peer": versions, "rows": rows}


def main(argv: list[str]) -> int:
    """`aerograsp bench ID --speed`."""
    parser = Parser(prog="aerograsp bench ID --speed", description="What a step and a plan cost, measured in one run.")
    parser.add_argument("id", metavar="ID", help=f"{REACH} or {GRASP}")
    parser.add_argument("--peer-python", metavar="PATH", help="interpreter with gymnasium-robotics and mujoco < 3.12")
    parser.add_argument("--seconds", metavar="S", type=positive_seconds, default=0.5, help="of a repeat's measurement")
    parser.add_argument("--repeats", metavar="R", type=positive_int, default=7, help="of every measurement")
    add_json(parser)
    args = parser.parse_args(argv)
    command = " ".join(["aerograsp", "bench", "--speed", *argv])
    result = speed(args.id, args.seconds, args.repeats, args.peer_python, command=command)
    if args.json != "-":
        facts = result["provenance"]
        print(table(result["rows"]))
        print(f"{facts['machine']['cpu']}, {facts['machine']['cores']} cores; commit {facts['commit'] or 'unknown'}")
        print(", ".join(f"{name} {version}" for name, version in facts["versions"].items()))
        if result["peer"]:
            print("peer: " + ", ".join(f"{name} {version}" for name, version in result["peer"].items()))
    if args.json:
        write_json(args.json, {**result, "rows": [row.to_dict() for row in result["rows"]]})
    return 0


if __name__ == "__main__":
    sys.exit(guarded("aerograsp bench --speed", main, sys.argv[1:]))
