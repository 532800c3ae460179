"""Other simulators' speed, measured by an interpreter of their own (PyFlyt pins numpy < 2) in turns with this one's.

A script below runs there. It needs no package of this project: it says which environments it has, and then, for every
line "NAME SECONDS" it reads, steps that environment for so long and answers with what its clock counted (simulated
seconds, or physics steps), processor and wall seconds.
"""

import json
import subprocess
import tempfile
from types import TracebackType
from typing import Any, NamedTuple

_HEAD = r"""
import json, sys, time
from importlib import metadata

def answer(value):
    sys.stdout.write("\nANSWER " + json.dumps(value) + "\n")  # the simulators print banners of their own
    sys.stdout.flush()
"""

DRONES = r"""
def pyflyt():
    import gymnasium, numpy, PyFlyt.gym_envs
    env = gymnasium.make("PyFlyt/QuadX-Hover-v4")
    action = numpy.array([0.0, 0.0, 0.0, 0.3])  # level, about to hover
    return env, action, lambda: env.unwrapped.env.elapsed_time

def hover_aviary():
    import numpy
    from gym_pybullet_drones.envs.HoverAviary import HoverAviary
    env = HoverAviary()
    action = numpy.zeros(env.action_space.shape)  # hover
    return env, action, lambda: env.step_counter * env.PYB_TIMESTEP

MAKERS = {"PyFlyt QuadX-Hover-v4": pyflyt, "gym-pybullet-drones HoverAviary": hover_aviary}
PACKAGES = ("PyFlyt", "gym-pybullet-drones", "pybullet", "numpy", "gymnasium")
"""

FETCH = r"""
def fetch():
    import gymnasium, gymnasium_robotics, numpy
    gymnasium.register_envs(gymnasium_robotics)
    env = gymnasium.make("FetchPickAndPlace-v4")
    action = numpy.array([0.0, 0.0, -0.1, 1.0], numpy.float32)  # slowly down over the table, jaws opening
    model = env.unwrapped.model
    return env, action, lambda: env.unwrapped.data.time / model.opt.timestep  # physics steps

MAKERS = {"FetchPickAndPlace-v4": fetch}
PACKAGES = ("gymnasium-robotics", "mujoco", "numpy", "gymnasium")
"""

_LOOP = r"""
found, missing = {}, {}
for name, make in MAKERS.items():
    try:
        found[name] = env, action, _ = make()
        env.reset(seed=0)
        for _ in range(10):
            env.step(action)  # compiled, cached, warm
    except Exception as error:
        missing[name] = type(error).__name__ + ": " + " ".join(str(error).split())
versions = {"python": sys.version.split()[0]}
for package in PACKAGES:
    try:
        versions[package] = metadata.version(package)
    except metadata.PackageNotFoundError:
        pass
answer({"found": list(found), "missing": missing, "versions": versions})

for line in sys.stdin:
    name, seconds = line.rsplit(maxsplit=1)
    env, action, clock = found[name]
    simulated = busy = wall = 0.0
    env.reset(seed=0)
    while wall < float(seconds):
        before, began, busy_before, done = clock(), time.perf_counter(), time.process_time(), False
        for _ in range(10):
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                done = True
                break
        busy += time.process_time() - busy_before
        wall += time.perf_counter() - began
        simulated += clock() - before
        if done:
            env.reset()  # not timed
    answer([simulated, busy, wall])
"""
SCRIPT = _HEAD + DRONES + _LOOP
FETCH_SCRIPT = _HEAD + FETCH + _LOOP


class Peers(NamedTuple):
    """What an interpreter offers."""

    found: list[str]
    missing: dict[str, str]  # name → why not
    versions: dict[str, str]


class PeerProcess:
    """The peers' interpreter, running one of the scripts above; a context manager that ends it.

    Raises:
        OSError: the interpreter cannot be run, or ends without an answer.
    """

    def __init__(self, python: str, script: str | None = None) -> None:
        self._errors = tempfile.TemporaryFile(mode="w+")  # noqa: SIM115 (closed with the process)
        self._process = subprocess.Popen(
            [python, "-u", "-c", SCRIPT if script is None else script],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
            errors="replace",
        )
        try:
            self.peers = Peers(**self._answer())
        except BaseException:
            self.close()
            raise

    def speed(self, name: str, seconds: float) -> tuple[float, float]:
        """What the peer's clock counts (simulated seconds; Fetch: physics steps) per processor and per wall second.

        Of its `step` alone, resets left out.
        """
        assert self._process.stdin is not None
        self._process.stdin.write(f"{name} {seconds}\n")
        self._process.stdin.flush()
        simulated, busy, wall = self._answer()
        return simulated / busy, simulated / wall

    def _answer(self) -> Any:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            _, mark, text = line.partition("ANSWER ")
            if mark:
                return json.loads(text)
        self._process.wait(timeout=10)
        self._errors.seek(0)
        said = self._errors.read().strip().splitlines()
        last = said[-1] if said else ""
        raise OSError(f"the peers' interpreter ended with status {self._process.returncode}: {last}")

    def close(self) -> None:
        """End the interpreter."""
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()
        self._process.terminate()
        self._process.wait(timeout=10)
        self._errors.close()

    def __enter__(self) -> "PeerProcess":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
