"""GraspPlan's policies: a batch equals its rows, zeros where nothing is found, no action that means something else."""

from __future__ import annotations

import gc
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest
from grasp_worlds import box

import aerograsp_env
from aerograsp_env.envs.grasp_cloud import REACH
from aerograsp_env.envs.grasp_plan import GraspPlanEnv, decode_action, unpack_cloud
from aerograsp_env.interfaces import Grasp, Oracle
from aerograsp_env.sim.gripper import GripperConfig
from agents import evaluate, load_policy
from baselines.policies import POLICIES
from baselines.policies import grasp_plan as module
from baselines.policies.grasp_plan import GraspPolicy, MeshOracle, moved, planner

PLAN = "aerograsp/GraspPlan-v0"
NAMES = list(POLICIES[PLAN])
SEEN = [name for name in NAMES if name != "oracle-mesh"]  # decide by what they see
SEEDS = (1, 4, 7)


@pytest.fixture(scope="module")
def worlds() -> list[GraspPlanEnv]:
    made = []
    for seed in SEEDS:
        env = gymnasium.make(PLAN).unwrapped
        assert isinstance(env, GraspPlanEnv)
        env.reset(seed=seed)
        made.append(env)
    return made


@pytest.fixture(scope="module")
def observations(worlds) -> list[dict[str, np.ndarray]]:
    return [world.reset(seed=seed)[0] for world, seed in zip(worlds, SEEDS, strict=True)]


def batch(observations: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {key: np.stack([observation[key] for observation in observations]) for key in observations[0]}


def with_points(observation: dict[str, np.ndarray], points: np.ndarray, **parts: Any) -> dict[str, np.ndarray]:
    return {**observation, "points": points.astype(np.float32).ravel(), **parts}


def watching(policy: Any, worlds: list[GraspPlanEnv]) -> Any:
    if isinstance(policy, Oracle):
        policy.watch(worlds)
    return policy


@pytest.mark.parametrize("name", NAMES)
def test_a_batch_equals_its_rows_and_actions_fit_the_space(name, worlds, observations):
    policy = watching(load_policy(PLAN, name), worlds)
    together, state = policy.predict(batch(observations))
    assert state is None and together.shape == (3, 10) and together.dtype == np.float32
    for world, observation, action in zip(worlds, observations, together, strict=True):
        policy = watching(load_policy(PLAN, name), [world])
        alone, state = policy.predict(observation)
        np.testing.assert_array_equal(alone, action)
        assert state is None and world.action_space.contains(alone)
        again, _ = policy.predict(observation, deterministic=False)
        np.testing.assert_array_equal(again, alone)
        grasp = decode_action(alone, world.gripper)
        assert (grasp is None) == (not alone.any())
    assert any(action.any() for action in together) or name == "cloud"


def test_names_that_no_planner_has_are_refused():
    with pytest.raises(ValueError, match="name: expected 'gpis', 'gpis-constant' or 'com', got 'cloud'"):
        planner("cloud")


def test_the_generator_depends_on_the_cloud_only(observations):
    a, b = observations[:2]
    first = module.content_rng(a).integers(0, 2**31, 4)
    np.testing.assert_array_equal(module.content_rng({**a, "noise": b["noise"]}).integers(0, 2**31, 4), first)
    assert not np.array_equal(module.content_rng(b).integers(0, 2**31, 4), first)


def test_random_eligible_takes_others_than_the_best_and_other_ones_on_other_clouds(observations):
    observation = observations[0]
    find = planner("gpis")
    ranks = []
    for change in range(4):
        points = observation["points"].copy()
        points[0] += 1e-5 * change
        changed = {**observation, "points": points}
        action, _ = load_policy(PLAN, "random-eligible").predict(changed)
        found = find(unpack_cloud(changed), module.content_rng(changed))
        grasp = decode_action(action, GripperConfig())
        assert grasp is not None
        ranks.append(int(np.argmin(np.linalg.norm(found.candidates.centers - grasp.center, axis=1))))
    assert len(set(ranks)) > 1 and any(ranks)


def test_com_is_nearer_to_the_estimated_centre_than_the_reference(observations):
    for observation in observations:
        cloud = unpack_cloud(observation)
        center = planner("gpis")(cloud, np.random.default_rng(0)).estimate.center
        distances = []
        for name in ("com", "gpis"):
            grasp = decode_action(load_policy(PLAN, name).predict(observation)[0], GripperConfig())
            assert grasp is not None
            offset = grasp.center - center
            distances.append(np.linalg.norm(offset - grasp.closing_axis * (offset @ grasp.closing_axis)))
        assert distances[0] <= distances[1] + 1e-6


# nothing to be found --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SEEN)
@pytest.mark.parametrize("points", ["equal", "line", "large"])
def test_zeros_where_nothing_can_be_found(name, points, observations):
    t = np.linspace(-1.0, 1.0, 512)
    cloud = {
        "equal": np.zeros((512, 3)),
        "line": 0.1 * t[:, None] * np.array([1.0, 0.3, -0.2]),
        "large": 0.4 * np.random.default_rng(0).uniform(-1.0, 1.0, (512, 3)) * [1.0, 1.0, 0.01],
    }[points]
    up = np.tile(np.array([0.0, 0.0, 1.0], np.float32), 512)
    observation = with_points(observations[0], cloud, normals=up, viewpoint=np.array([0.0, 0.0, 0.5], np.float32))
    action, _ = load_policy(PLAN, name).predict(observation)
    np.testing.assert_array_equal(action, np.zeros(10, dtype=np.float32))


@pytest.mark.parametrize("name", SEEN)
def test_the_poorest_clouds_of_the_environment_are_no_trouble(name):
    """Few distinct points without noise: each is seen many times."""
    env = gymnasium.make(
        PLAN, objects="spanner", depth_camera={"sigma": 0.0, "sigma_quadratic": 0.0, "width": 16, "height": 16}
    )
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        assert observation["count"] < 100
        action, _ = load_policy(PLAN, name).predict(observation)
        assert env.action_space.contains(action)


def test_other_errors_are_not_swallowed(observations):
    def faulty(cloud: Any, rng: np.random.Generator) -> Grasp | None:
        raise ValueError("not the cloud's fault")

    with pytest.raises(ValueError, match="not the cloud's fault"):
        GraspPolicy(faulty).predict(observations[0])
    with pytest.raises(ValueError, match="no 'noise'"):
        load_policy(PLAN, "gpis").predict({key: value for key, value in observations[0].items() if key != "noise"})
    spoiled = {**observations[0], "points": np.full(1536, np.nan, np.float32)}
    with pytest.raises(ValueError, match="points"):
        load_policy(PLAN, "gpis").predict(spoiled)


@pytest.mark.parametrize("name", SEEN)
def test_grasps_farther_than_an_action_says_are_passed_over(name, observations):
    """The object at the edge of what an action reaches: some grasps are beyond, and what is left is said rightly."""
    observation = observations[0]
    near = decode_action(load_policy(PLAN, "gpis").predict(observation)[0], GripperConfig())
    assert near is not None
    shift = np.array([REACH - near.center[0], 0.0, 0.0])  # the best grasp at the edge
    for beyond in (0.0, 0.2):
        moves = (shift + [beyond, 0.0, 0.0]).astype(np.float32)
        points = observation["points"].reshape(-1, 3) + moves
        changed = with_points(observation, points, viewpoint=observation["viewpoint"] + moves)
        action, _ = load_policy(PLAN, name).predict(changed)
        assert np.abs(action).max() <= 1.0
        if beyond:
            assert not action.any()
    found = planner("gpis")(unpack_cloud(changed), np.random.default_rng(0))
    assert len(found) == 0 and found.context.shape[0] == 0


# the oracle -----------------------------------------------------------------------------------------


def test_the_oracle_has_to_be_told_what_to_watch(worlds, observations):
    policy = MeshOracle()
    with pytest.raises(RuntimeError, match="expected 1 worlds to watch, got 0"):
        policy.predict(observations[0])
    policy.watch(worlds[:2])
    with pytest.raises(RuntimeError, match="expected 3 worlds to watch, got 2"):
        policy.predict(batch(observations))


def test_the_oracle_is_told_by_the_evaluation_and_holds_a_box():
    result = evaluate(PLAN, "oracle-mesh", 3, 0, {"objects": [box()]})
    assert result.success.all()


def test_the_oracles_grasp_moves_with_the_object():
    item = box()
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, :3, :3] = [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]
    poses[1, :3, 3] = [0.02, -0.03, 0.01]
    policy = MeshOracle()
    actions = []
    for T in poses:
        policy.watch([SimpleNamespace(object=item, T_cloud_object=T)])
        actions.append(policy.predict({"points": np.zeros(1536)})[0])
    first, second = (decode_action(action, GripperConfig()) for action in actions)
    assert first is not None and second is not None
    expected = moved(first, poses[1])
    for name in ("center", "closing_axis", "approach_axis", "width"):
        np.testing.assert_allclose(getattr(second, name), getattr(expected, name), atol=1e-6)


def test_the_oracle_says_nothing_where_no_action_reaches_or_nothing_fits_and_forgets_objects():
    policy = MeshOracle()
    far = np.eye(4)
    far[0, 3] = 0.4
    items = [box(), box((0.3, 0.3, 0.3))]
    for item, T in zip(items, (far, np.eye(4)), strict=True):
        policy.watch([SimpleNamespace(object=item, T_cloud_object=T)])
        np.testing.assert_array_equal(policy.predict({"points": np.zeros(1536)})[0], np.zeros(10))
    assert len(policy._found) == 2
    policy.watch([])
    del item, items
    gc.collect()
    assert len(policy._found) == 0


# by name --------------------------------------------------------------------------------------------


def test_the_reference_policy_is_gpis(observations):
    action, _ = aerograsp_env.reference_policy(PLAN).predict(observations[0])
    np.testing.assert_array_equal(action, load_policy(PLAN, "gpis").predict(observations[0])[0])


def test_an_evaluation_is_the_same_when_it_is_run_again():
    first, again = (evaluate(PLAN, "gpis", 3, 11) for _ in range(2))
    np.testing.assert_array_equal(first.returns, again.returns)
    assert set(first.metrics) >= {"held", "strict", "survived"} and (first.lengths == 1).all()


def test_analytic_policies_act_without_torch():
    code = (
        "import sys\n"
        "class Blocked:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.partition('.')[0] in ('torch', 'safetensors', 'stable_baselines3'): raise ImportError(name)\n"
        "sys.meta_path.insert(0, Blocked())\n"
        "import gymnasium, aerograsp_env\n"
        "from agents import load_policy\n"
        f"env = gymnasium.make({PLAN!r}); observation, _ = env.reset(seed=0)\n"
        f"for name in {NAMES!r}:\n"
        f"    policy = load_policy({PLAN!r}, name)\n"
        "    if hasattr(policy, 'watch'): policy.watch([env.unwrapped])\n"
        "    assert env.action_space.contains(policy.predict(observation)[0]), name\n"
        "print('all')\n"
    )
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert run.stdout.split() == ["all"]
