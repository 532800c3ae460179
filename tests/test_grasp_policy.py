"""grasp-dls and dual-dls: what they do with an observation, with none, and with objects that they have not seen."""

import gymnasium
import numpy as np
import pytest

import aerograsp_env  # noqa: F401
from aerograsp_env.envs.grasp import GraspEnv
from aerograsp_env.envs.grasp_dual import GraspDualEnv
from aerograsp_env.sim.arms.vehicles import AQUILES, BELEROFONTE_ARMS
from aerograsp_env.spatial import so3_exp, transform
from baselines.grasping.on_bars import grasps_on_bars
from baselines.grasping.scenes import Scene
from baselines.kinematics.arm import Arm
from baselines.policies.grasp import GraspPolicy, alike, grasp_dls
from baselines.policies.grasp_dual import crawler_surface, dual_dls
from baselines.policies.grasp_margins import depth_after
from baselines.policies.grasp_pilot import Flight
from baselines.policies.grasp_reading import read, rigid
from baselines.policies.grasp_state import Phase, PilotSettings

ONE, TWO = grasp_dls(), dual_dls()
CALM = {"wind": "calm", "level": {"mass": (0.2, 0.2), "spread": (0.0, 0.0, 0.0)}, "objects": "capsule"}


@pytest.fixture(scope="module")
def env():
    return GraspEnv(**CALM)


def fly(env, policy: GraspPolicy, seed: int, steps: int, change=lambda step, observation: observation):
    """Phases passed, the last info, observation and state."""
    observation, info = env.reset(seed=seed)
    state, phases = None, []
    for step in range(steps):
        action, state = policy.predict(change(step, observation), state)
        assert action.dtype == np.float32 and action.shape == env.action_space.shape
        assert env.action_space.contains(action)
        if not phases or phases[-1] != state[0].phase:
            phases.append(state[0].phase)
        observation, _, terminated, _, info = env.step(action)
        if terminated or info["success"]:
            break
    return phases, info, observation, state


def frozen(age_from: int):
    """The estimate stops arriving at that step."""
    kept = {}

    def change(step, observation):
        if step == age_from:
            kept.update({name: observation[name].copy() for name in ("object", "object_age", "support")})
        if step < age_from:
            return observation
        age = kept["object_age"] + np.float32(0.02 * (step - age_from))
        return observation | kept | {"object_age": age}

    return change


# --- flights ----------------------------------------------------------------------------------------------------------


def test_one_arm_takes_an_object_and_lifts_it(env):
    phases, info, _, _ = fly(env, ONE, 10000, 700)
    assert info["success"], info
    order = [Phase.LOOK, Phase.TRANSIT, Phase.ALIGN, Phase.APPROACH, Phase.CLOSE, Phase.LIFT]
    assert phases == order
    assert info["metrics"]["contacts"] == 0.0 and info["metrics"]["slip"] < 0.01


def test_two_arms_take_the_crawler_and_lift_it():
    env = GraspDualEnv(wind="calm")
    phases, info, _, _ = fly(env, TWO, 10000, 900)
    assert info["success"], info
    assert phases[-1] == Phase.LIFT


def test_a_grasp_that_misses_is_let_go_and_tried_again(env):
    class Blind(Flight):
        """Believes until the first miss that the object stands 6 cm higher."""

        def step(self, r, pilot):
            if pilot is None or not pilot.attempts:
                lifted = r.T_body_object.copy()
                lifted[2, 3] += 0.06
                r = r._replace(T_body_object=lifted)
            return super().step(r, pilot)

    flight = Blind(ONE.flight.arms, ONE.flight.planner)
    phases, info, _, state = fly(env, GraspPolicy(flight), 10000, 1000)
    assert Phase.RELEASE in phases and phases.index(Phase.RETREAT) < len(phases) - 1
    assert len(state[0].attempts) >= 1
    assert info["success"], (phases, info)


# --- no estimate ------------------------------------------------------------------------------------------------------


def test_the_arm_holds_without_an_estimate_and_then_backs_off(env):
    policy, change = ONE, frozen(60)
    observation, _ = env.reset(seed=10001)
    state, rates, climbs, drives = None, {}, {}, {}
    for step in range(150):
        seen = change(step, observation)
        action, state = policy.predict(seen, state)
        age = float(seen["object_age"][0])
        rates[age], climbs[age], drives[age] = np.abs(action[3:9]).max(), action[2], action[9]
        observation, _, terminated, _, _ = env.step(action)
        assert not terminated
    held = [age for age in rates if age > 0.31]
    assert max(rates[age] for age in held) == 0.0
    assert max(rates[age] for age in rates if age < 0.29) > 0.05
    assert all(abs(climbs[age]) < 0.1 and drives[age] == 0.0 for age in held if age < 0.99)
    assert all(climbs[age] > 0.1 and drives[age] == -1.0 for age in held if age > 1.01)


def test_a_returning_estimate_is_grasped_after_all(env):
    def gap(step, observation):
        return hidden(step, observation) if step < 140 else observation

    hidden = frozen(60)
    phases, info, _, _ = fly(env, ONE, 10002, 1000, gap)
    assert info["success"], (phases, info)
    assert phases[:3] == [Phase.LOOK, Phase.TRANSIT, Phase.LOOK]  # it began anew


# --- the policies' interface ------------------------------------------------------------------------------------------


def test_a_batch_is_its_rows(env):
    observations = [env.reset(seed=seed)[0] for seed in (1, 2)]
    batch = {name: np.stack([o[name] for o in observations]) for name in observations[0]}
    singles, states = [None, None], None
    for _ in range(30):
        action, states = ONE.predict(batch, states)
        assert action.shape == (2, 10)
        for k, observation in enumerate(observations):
            alone, singles[k] = ONE.predict(observation, singles[k])
            np.testing.assert_array_equal(alone, action[k])


def test_predict_changes_neither_state_nor_observation(env):
    observation, _ = env.reset(seed=3)
    copies = {name: value.copy() for name, value in observation.items()}
    state = None
    for _ in range(25):
        first, after = ONE.predict(observation, state)
        again, _ = ONE.predict(observation, state)
        np.testing.assert_array_equal(first, again)
        state = after
    for name, value in copies.items():
        np.testing.assert_array_equal(observation[name], value)


def test_episode_start_begins_anew_row_by_row(env):
    observations = [env.reset(seed=seed)[0] for seed in (1, 2)]
    batch = {name: np.stack([o[name] for o in observations]) for name in observations[0]}
    state = None
    for _ in range(20):
        _, state = ONE.predict(batch, state, np.array([state is None] * 2))
    assert [pilot.track.step for pilot in state] == [19, 19]
    _, state = ONE.predict(batch, state, np.array([False, True]))
    assert [pilot.track.step for pilot in state] == [20, 0]


@pytest.mark.parametrize(("name", "policy"), [("grasp-dls", GraspPolicy), ("dual-dls", GraspPolicy)])
def test_both_are_found_by_name(name, policy):
    from agents import load_policy

    env_id = "aerograsp/Grasp-v0" if name == "grasp-dls" else "aerograsp/GraspDual-v0"
    assert env_id in gymnasium.registry
    assert isinstance(load_policy(env_id, name), policy)


def test_rotations_are_made_orthonormal():
    R = so3_exp([0.4, -1.0, 0.3])
    nine = np.concatenate([[0.1, 0.2, 0.3], R[:, 0], R[:, 1]])
    np.testing.assert_allclose(rigid(nine), transform(R, [0.1, 0.2, 0.3]), atol=1e-12)
    noisy = rigid(nine + np.r_[np.zeros(3), 0.01 * np.sin(np.arange(6.0))])
    np.testing.assert_allclose(noisy[:3, :3].T @ noisy[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(noisy[:3, :3]) == pytest.approx(1.0)


def test_what_is_read_is_what_the_arm_does(env):
    observation, _ = env.reset(seed=4)
    reading = read({name: value[None] for name, value in observation.items()}, 0, (6,))
    arm = Arm.from_config(BELEROFONTE_ARMS.mount("right").arm, BELEROFONTE_ARMS.mount("right").T_body_base)
    np.testing.assert_allclose(arm.forward(reading.hands[0].q), reading.hands[0].tool, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(reading.cloud[:, 3:], axis=1), 1.0, atol=1e-6)
    assert reading.hands[0].opening == pytest.approx(0.10, abs=1e-3)


def test_grasps_are_alike_by_place_and_approach():
    T = transform(so3_exp([0.1, 0.2, 0.3]), [0.0, 0.0, 0.1])
    swapped = T @ transform(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    assert alike(T, T) and alike(T, swapped)
    assert not alike(T, T @ transform(np.eye(3), [0.03, 0.0, 0.0]))
    assert not alike(T, T @ transform(so3_exp([1.0, 0.0, 0.0]), np.zeros(3)))


def test_going_deeper_stops_short_of_the_support(env):
    observation, _ = env.reset(seed=10000)
    state = None
    for _ in range(18):
        _, state = ONE.predict(observation, state)
    settings, grasp = PilotSettings(), state[0].grasps[0]
    T = np.eye(4)
    T[:3, :3] = state[0].track.attitude
    reading = read({name: value[None] for name, value in observation.items()}, 0, (6,))
    scene = Scene(
        T @ reading.T_body_object, reading.cloud[:, :3], reading.cloud[:, 3:], reading.support[1], reading.support[0]
    )
    depths = [depth_after(k, scene, grasp, settings) for k in range(5)]
    assert depths[0] == 0.0 and depths == sorted(depths) and depths[-1] <= 2.0 * settings.deeper
    tool = scene.T_level_object @ grasp.T_object_grasp
    for depth in depths:
        tip = tool[:3, 3] + depth * tool[:3, 2]
        assert depth == 0.0 or (tip - scene.support) @ scene.up >= settings.tip_room - 1e-9


def test_the_crawlers_points_lie_on_it_evenly():
    points = crawler_surface(2000)
    np.testing.assert_allclose(np.linalg.norm(points[:, 3:], axis=1), 1.0, atol=1e-9)
    assert np.array_equal(points, crawler_surface(2000))
    with pytest.raises(ValueError, match="normals"):
        grasps_on_bars([(np.zeros(3), np.ones(3), 0.01)], points[:, :3], points[:, :2])


def test_a_vehicle_without_the_arms_is_refused():
    with pytest.raises(ValueError, match="left"):
        grasp_dls(AQUILES, side="left")
    with pytest.raises(ValueError, match="left"):
        dual_dls(AQUILES)
