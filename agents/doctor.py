"""Say what works on this machine: Python, packages, the compiled kernel, renderers, processors and display.

``python -m agents.doctor`` (or ``aerograsp doctor``) prints a table; ``--json FILE`` also writes it. The exit status is
0 if everything that is needed is there, else 1. Whatever could crash (imports, OpenGL) is tried in a process of its
own with a time limit, so this program always comes to its end.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
import re
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Literal

from aerograsp_env.own_process import fault_of
from aerograsp_env.sim.gl_probe import renderer_fault

Status = Literal["ok", "warning", "missing"]

GL_PLATFORMS = {  # MUJOCO_GL: what it needs
    "egl": "a machine without display: apt install libegl1 libgl1",
    "osmesa": "a machine without display: apt install libosmesa6",
    "glfw": "a machine with a display",
}
_MODULES = {  # where not the package's name
    "libigl": "igl",
    "opencv-python-headless": "cv2",
    "pillow": "PIL",
    "pin": "pinocchio",
    "pycollada": "collada",
    "scikit-learn": "sklearn",
}
_COMPILE_TIMEOUT = 300.0  # [s] for the kernel, which is compiled on its first use

_IMPORT = "import importlib, sys; importlib.import_module(sys.argv[1])"
_KERNEL = """
import numba
assert numba.njit(lambda x: x + 1)(1) == 2
import gymnasium
import aerograsp_env.sim.kernel
env = gymnasium.make("aerograsp/Dock-v0")
env.reset(seed=0)
env.step(env.action_space.sample())
"""


@dataclass(frozen=True)
class Check:
    """One finding: "ok", "warning" (works without it, or something is optional) or "missing" (needed)."""

    name: str
    status: Status
    detail: str


def diagnose() -> list[Check]:
    """Look at everything; takes about ten seconds. Never raises for what it finds."""
    with ThreadPoolExecutor(max_workers=max(2, os.cpu_count() or 2)) as pool:
        packages = [pool.submit(_package, requirement) for requirement in _requirements()]
        kernel = pool.submit(_kernel)
        renderers = [pool.submit(_renderer, "ray", "disable")]
        renderers += [pool.submit(_renderer, "gl", name) for name in GL_PLATFORMS]
        found = [job.result() for job in (*packages, kernel, *renderers)]
    return [_python(), *found, _processors(), _blas(), _display()]


def main(argv: list[str] | None = None) -> int:
    """Print the table. Returns 0 if all that is needed is ok, 1 if something is missing, 2 for a wrong argument."""
    parser = argparse.ArgumentParser(prog="aerograsp doctor", description="Say what works on this machine.")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the findings to FILE as JSON")
    arguments = parser.parse_args(argv)
    if arguments.json is not None and not arguments.json.parent.is_dir():
        print(f"aerograsp doctor: --json: folder {str(arguments.json.parent)!r} does not exist", file=sys.stderr)
        return 2
    checks = diagnose()
    print(_table(checks))
    missing = [check.name for check in checks if check.status == "missing"]
    print(f"\nMissing: {', '.join(missing)}." if missing else "\nAll that is needed is here.")
    if arguments.json is not None:
        document = {"ok": not missing, "checks": [asdict(check) for check in checks]}
        try:
            arguments.json.write_text(json.dumps(document, indent=2) + "\n")
        except OSError as error:
            print(f"aerograsp doctor: --json: {error}", file=sys.stderr)
            return 2
    return 1 if missing else 0


def _table(checks: list[Check]) -> str:
    rows = [("what", "status", "detail"), *((check.name, check.status, check.detail) for check in checks)]
    first, second = (max(len(row[i]) for row in rows) for i in (0, 1))
    return "\n".join(f"{name:<{first}}  {status:<{second}}  {detail}" for name, status, detail in rows)


def _python() -> Check:
    fits = sys.version_info >= (3, 11)
    detail = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    return Check("Python", "ok" if fits else "missing", detail if fits else f"{detail}: 3.11 or newer is needed")


def _requirements() -> list[tuple[str, str, str]]:
    """(package, least version, extra or "") of this project's own requirements; peers run elsewhere."""
    found = []
    for line in metadata.requires("aerograsp") or []:
        match = re.match(r"([A-Za-z0-9._-]+)(?:\s*>=\s*([0-9.]+))?", line)
        extra = re.search(r"extra\s*==\s*['\"](\w+)['\"]", line)
        group = extra.group(1) if extra else ""
        if match and group in ("", "learn", "mesh", "dev"):
            found.append((match.group(1), match.group(2) or "0", group))
    return found


def _package(requirement: tuple[str, str, str]) -> Check:
    package, least, extra = requirement
    name = f"{package} ({extra})" if extra else package
    bad: Status = "warning" if extra else "missing"
    remedy = f"pip install 'aerograsp[{extra}]'" if extra else f"pip install '{package}>={least}'"
    try:
        version = metadata.version(package)
    except metadata.PackageNotFoundError:
        return Check(name, bad, f"not installed: {remedy}")
    if _numbers(version) < _numbers(least):
        return Check(name, bad, f"{version} is too old: {remedy}")
    if extra == "dev":  # programs that run beside this one: their presence is enough
        return Check(name, "ok", version)
    failure = fault_of(_IMPORT, _MODULES.get(package, package.replace("-", "_")))
    return Check(name, bad, f"{version} does not import: {failure}") if failure else Check(name, "ok", version)


def _numbers(version: str) -> tuple[int, ...]:
    numbers = [int(part) for part in re.findall(r"\d+", re.split(r"[+a-z]", version)[0])]
    return tuple(numbers + [0] * (4 - len(numbers)))


def _kernel() -> Check:
    start = time.perf_counter()
    failure = fault_of(_KERNEL, seconds=_COMPILE_TIMEOUT)
    if failure is None:
        return Check(
            "compiled kernel", "ok", f"one docking step, compiled or from cache, in {time.perf_counter() - start:.0f} s"
        )
    if re.search("No module named 'aerograsp_env|N(?:ame|amespace)NotFound", failure):
        return Check("compiled kernel", "warning", f"numba works, but there is no docking environment here: {failure}")
    return Check("compiled kernel", "missing", failure)


def _renderer(backend: str, gl: str) -> Check:
    failure = renderer_fault(backend, gl)
    if backend == "ray":
        return Check("renderer ray", "missing" if failure else "ok", failure or "needs no OpenGL; the default")
    name = f"renderer gl, {gl}"
    if failure is None:
        return Check(name, "ok", f"set MUJOCO_GL={gl} before Python starts")
    cause = re.search(r"OpenGL does not start with \S+ \((.*?)(?:, this most likely.*)?\)\. On a machine", failure)
    return Check(name, "warning", f"optional; wants {GL_PLATFORMS[gl]} [{cause.group(1) if cause else failure}]")


def _processors() -> Check:
    total = os.cpu_count() or 1
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else total
    return Check("processors", "ok", f"{usable} usable of {total}")


def _blas() -> Check:
    try:
        importlib.import_module("numpy.linalg")
        threadpoolctl = importlib.import_module("threadpoolctl")
    except ImportError:
        names = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
        set_to = {name: os.environ[name] for name in names if name in os.environ}
        threads = next(iter(set_to.values()), "")
        detail = ", ".join(f"{name}={value}" for name, value in set_to.items()) or "not limited by the environment"
    else:
        pools = [pool for pool in threadpoolctl.threadpool_info() if pool["user_api"] == "blas"]
        threads = str(max((pool["num_threads"] for pool in pools), default=1))
        detail = ", ".join(f"{pool['internal_api']}: {pool['num_threads']}" for pool in pools) or "none loaded"
    if threads == "1":
        return Check("BLAS threads", "ok", detail)
    return Check("BLAS threads", "warning", f"{detail}; OPENBLAS_NUM_THREADS=1 is often faster for small matrices")


def _display() -> Check:
    if platform.system() != "Linux":
        return Check("display", "ok", platform.system())
    for name in ("WAYLAND_DISPLAY", "DISPLAY"):
        if os.environ.get(name):
            return Check("display", "ok", f"{name}={os.environ[name]}")
    return Check("display", "warning", "none; only render_mode='human' needs one")


if __name__ == "__main__":
    raise SystemExit(main())
