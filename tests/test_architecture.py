"""The tree keeps its promises: one direction of imports, and nothing heavy loaded before it is needed."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("aerograsp_env", "baselines", "agents")
MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))

# What each package may import of the others, anywhere; what it may not import at all; and what not while it loads.
ALLOWED = {"aerograsp_env": set(), "baselines": {"aerograsp_env"}, "agents": {"aerograsp_env", "baselines"}}
LEARNING = {"torch", "stable_baselines3", "safetensors", "rliable", "tensorboard"}
FORBIDDEN = {"aerograsp_env": LEARNING, "baselines": LEARNING, "agents": set()}
GL_AND_PLOTS = {"OpenGL", "glfw", "matplotlib"}
FORBIDDEN_AT_LOAD = {"aerograsp_env": GL_AND_PLOTS, "baselines": GL_AND_PLOTS, "agents": set()}


def imports(path: Path) -> Iterator[tuple[str, int, bool]]:
    """Every module that a file imports, as (absolute dotted name, line, whether while loading)."""
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    tree = ast.parse(path.read_text(encoding="utf-8"), str(path))
    later: set[ast.AST] = set()
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) or _type_checking(node):
            later.update(inner for statement in node.body for inner in ast.walk(statement))  # type: ignore[attr-defined]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else ()
            base = ".".join((*above, *filter(None, [node.module])))
            names = [f"{base}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            yield name, node.lineno, node not in later


def _type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING")


def test_there_are_modules_to_check() -> None:
    assert {path.relative_to(ROOT).parts[0] for path in MODULES} == set(PACKAGES)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_go_one_way(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0]
    faults = []
    for name, line, at_load in imports(path):
        top = name.partition(".")[0]
        if top in PACKAGES and top != package and top not in ALLOWED[package]:
            faults.append(f"line {line}: {package} imports {name}")
        if top in FORBIDDEN[package] or (at_load and top in FORBIDDEN_AT_LOAD[package]):
            faults.append(f"line {line}: {package} imports {name}{' while it loads' if at_load else ''}")
    assert not faults, f"{path.relative_to(ROOT)}: " + "; ".join(faults)


def test_the_walker_sees_every_form_of_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    source = tmp_path / "baselines" / "control" / "pid.py"
    source.parent.mkdir(parents=True)
    source.write_text(
        "import agents.cli as c, numpy\nfrom agents import evaluate\n"
        "from . import gains\nfrom ..filtering.kalman import EKF\n"
        "def f():\n    from torch import nn\n"
        "try:\n    import OpenGL.GL\nexcept ImportError:\n    pass\n"
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import matplotlib\n"
    )
    found = {(name, at_load) for name, _, at_load in imports(source)}
    assert found == {
        ("agents.cli", True),
        ("numpy", True),
        ("agents.evaluate", True),
        ("baselines.control.gains", True),
        ("baselines.filtering.kalman.EKF", True),
        ("torch.nn", False),
        ("OpenGL.GL", True),
        ("typing.TYPE_CHECKING", True),
        ("matplotlib", False),
    }


# --- what a fresh interpreter loads ------------------------------------------


def run(code: str, **environment: str) -> list[str]:
    """The lines that `code` prints in an interpreter of its own, where MUJOCO_GL is what is given, or unset."""
    inherited = {key: value for key, value in os.environ.items() if key not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
    result = subprocess.run(
        [sys.executable, "-c", code], env={**inherited, **environment}, cwd=ROOT, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.split()


PRINT_LOADED = "import sys; print(*sys.modules)\n"


def loaded(modules: list[str], *names: str) -> list[str]:
    return [module for module in modules if any(module == name or module.startswith(f"{name}.") for name in names)]


def test_importing_the_package_imports_no_simulator() -> None:
    modules = run(f"import aerograsp_env\n{PRINT_LOADED}")
    assert loaded(modules, "mujoco", "torch", "matplotlib", "OpenGL", "baselines", "agents") == []


STEP = """
import gymnasium, aerograsp_env
env = gymnasium.make("aerograsp/Dock-v0")
env.reset(seed=0)
for _ in range(3):
    env.step(env.action_space.sample())
env.close()
"""

# What the linker has mapped says more than any list of modules; only Linux tells.
PRINT_LIBRARIES = """
import pathlib
maps = pathlib.Path("/proc/self/maps")
print(*{line.split()[-1] for line in maps.read_text().splitlines()} if maps.exists() else [])
"""


@pytest.mark.parametrize("environment", [{}, {"MUJOCO_GL": "disable"}], ids=["MUJOCO_GL unset", "MUJOCO_GL=disable"])
def test_state_observations_need_neither_gl_nor_torch(environment: dict[str, str]) -> None:
    """MuJoCo itself imports glfw when MUJOCO_GL is unset (without loading GL), so that case looks for the rest."""
    words = run(STEP + PRINT_LOADED + PRINT_LIBRARIES, **environment)
    assert loaded(words, "mujoco")
    unwanted = ["OpenGL", "mujoco.egl", "mujoco.osmesa", *LEARNING, "matplotlib"]
    assert loaded(words, *unwanted, *(["mujoco.glfw", "glfw"] if environment else [])) == []
    assert [word for word in words if Path(word).name.startswith(("libGL", "libEGL", "libOSMesa"))] == []


BLOCK_LEARNING = f"""
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {LEARNING!r}:
            raise ImportError(f"{{name}} is not installed")
sys.meta_path.insert(0, Blocked())
"""


def test_analytic_policies_load_and_act_without_torch() -> None:
    lines = run(
        BLOCK_LEARNING
        + """
import gymnasium, numpy, aerograsp_env
from agents import load_policy
env = gymnasium.make("aerograsp/Dock-v0")
observation, _ = env.reset(seed=0)
for name in ("zero", "random", "pid", "pid-tuned", "lqg"):
    action, _ = load_policy("aerograsp/Dock-v0", name).predict(observation)
    assert numpy.asarray(action, dtype=numpy.float32) in env.action_space, (name, action)
    print(name)
aerograsp_env.reference_policy("aerograsp/Dock-v0").predict(observation)
print("reference")
"""
    )
    assert lines == ["zero", "random", "pid", "pid-tuned", "lqg", "reference"]


def test_the_copyleft_part_of_libigl_is_never_loaded() -> None:
    """libigl is MPL 2.0, but its wheel holds GPL modules too (`igl.copyleft`): what is loaded must do without them."""
    modules = run(
        f"""
import pkgutil, importlib
import numpy, trimesh
import aerograsp_env, baselines, agents
for package in (baselines, aerograsp_env):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        importlib.import_module(module.name)
from baselines.objects import MeshObject
cube = MeshObject.from_trimesh(trimesh.creation.box((0.1, 0.1, 0.1)))
points = numpy.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]])
cube.ray_hits(points, numpy.ones((2, 3)))
cube.signed_distance(points)
cube.report
{PRINT_LOADED}"""
    )
    assert loaded(modules, "igl")
    assert [module for module in modules if "copyleft" in module] == []


def test_no_requirement_is_under_the_gpl() -> None:
    """What is installed of this project's own requirements says of itself that it is neither GPL nor LGPL."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    lines = [*project["dependencies"], *(line for name in ("learn", "mesh", "dev") for line in extras[name])]
    names = [re.split(r"[<>=\[ ]", line)[0] for line in lines]
    assert len(names) > 20
    for name in names:
        try:
            about = metadata.metadata(name)
        except metadata.PackageNotFoundError:
            continue  # an extra that was left out
        says = [about.get("License-Expression") or "", (about.get("License") or "").split("\n")[0]]
        says += [line for line in about.get_all("Classifier") or [] if line.startswith("License")]
        assert not re.search(r"\b[AL]?GPL|General Public", " ".join(says)), f"{name}: {says}"
