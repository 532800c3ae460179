"""The NumPy actor equals the torch one it was trained as, alone and as a residual."""

import numpy as np
import pytest
import toy_environment as toy
from gymnasium.vector import AutoresetMode

from aerograsp_env.wrappers import BASE_ACTION
from agents import load_policy, ppo
from agents.checkpoint import NetworkLayout, save_checkpoint
from agents.network_policy import NetworkPolicy, load_network_policy
from agents.sb3_env import SB3VecEnv
from agents.train_config import TrainConfig

toy.register()
LAYOUT = NetworkLayout(keys=("error", "velocity"), sizes=(2, 2), actions=2, hidden=(5,), clip=3.0)


def observations(n: int, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {key: rng.normal(0.0, 2.0, (n, size)).astype(np.float32) for key, size in toy.SIZES.items()}


def random_tensors(layout: NetworkLayout, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    tensors = {name: rng.normal(0.0, 0.5, shape) for name, shape in layout.shapes().items()}
    return tensors | {"observation.var": rng.uniform(0.5, 2.0, sum(layout.sizes))}


@pytest.mark.parametrize(("activation", "hidden"), [("tanh", (64, 64)), ("relu", (16,)), ("tanh", ())])
def test_equals_stable_baselines(activation, hidden):
    config = TrainConfig(
        num_envs=4, n_steps=8, batch_size=32, hidden=hidden, activation=activation, keys=("velocity", "error")
    )
    env = SB3VecEnv(toy.Points(4, autoreset_mode=AutoresetMode.SAME_STEP), config.keys)
    model, normalized = ppo.build(config, env)
    normalized.obs_rms.mean = np.array([0.3, -0.2, 1.0, 0.0])
    normalized.obs_rms.var = np.array([2.0, 0.01, 1.0, 4.0])
    import torch

    with torch.no_grad():  # far from the small initial output, so that the test sees every layer
        for parameter in model.policy.parameters():
            parameter += 0.3 * torch.randn(parameter.shape)
    observation = observations(200)
    flat = np.concatenate([observation["velocity"], observation["error"]], axis=1)
    expected, _ = model.predict(normalized.normalize_obs(flat), deterministic=True)
    tensors = ppo.actor_tensors(model, normalized)
    for dtype in (np.float64, np.float32):
        policy = NetworkPolicy(ppo.layout(config, env), tensors, dtype=dtype)
        action, state = policy.predict(observation)
        assert state is None and action.dtype == np.float32
        np.testing.assert_allclose(action, expected, rtol=0, atol=1e-6 if dtype is np.float64 else 1e-5)
    assert np.mean(np.abs(expected) < 1.0) > 0.05  # not all saturated


def test_single_observations_equal_rows_of_a_batch():
    policy = NetworkPolicy(LAYOUT, random_tensors(LAYOUT))
    batch = observations(6)
    together, _ = policy.predict(batch)
    for i in range(6):
        alone, _ = policy.predict({key: value[i] for key, value in batch.items()})
        assert alone.shape == (2,)
        np.testing.assert_allclose(alone, together[i], atol=1e-7)


def test_normalisation_and_clipping_by_hand():
    layout = NetworkLayout(keys=("error",), sizes=(2,), actions=2, hidden=(), clip=0.5, epsilon=0.0)
    tensors = {
        "observation.mean": np.array([1.0, 0.0]),
        "observation.var": np.array([4.0, 0.01]),
        "actor.0.weight": np.eye(2),
        "actor.0.bias": np.array([0.0, 0.75]),
        "log_std": np.zeros(2),
    }
    action, _ = NetworkPolicy(layout, tensors).predict({"error": np.array([1.8, 3.0])})
    np.testing.assert_allclose(action, [0.4, 1.0], rtol=1e-6)  # (1.8 − 1)/2; 30 clipped to 0.5, 1.25 clipped to 1


def test_sampling_has_the_trained_deviation_and_its_own_generator():
    tensors = random_tensors(LAYOUT) | {"log_std": np.log([0.1, 0.2])}
    tensors["actor.1.weight"] = np.zeros((2, 5))
    tensors["actor.1.bias"] = np.array([0.1, -0.1])
    batch = observations(20000)
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    a, _ = NetworkPolicy(LAYOUT, tensors, seed=1).predict(batch, deterministic=False)
    b, _ = NetworkPolicy(LAYOUT, tensors, seed=1).predict(batch, deterministic=False)
    np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(before, np.random.get_state()[1])  # noqa: NPY002
    np.testing.assert_allclose(a.mean(axis=0), [0.1, -0.1], atol=0.006)
    np.testing.assert_allclose(a.std(axis=0), [0.1, 0.2], rtol=0.03)


def test_residual_restarts_its_base_and_equals_the_formula():
    layout = NetworkLayout(keys=("error", BASE_ACTION), sizes=(2, 2), actions=2, hidden=(4,))
    tensors, base = random_tensors(layout, 3), toy.Integral()
    policy = NetworkPolicy(layout, tensors, base=base, scale=0.4)
    plain = NetworkPolicy(NetworkLayout(("error", "x"), (2, 2), 2, (4,)), tensors)
    state = base_state = None
    for step in range(5):
        observation = observations(3, step)
        start = np.array([False, step == 3, False])
        action, state = policy.predict(observation, state, start)
        base_action, base_state = base.predict(observation, base_state, start)
        correction, _ = plain.predict({"error": observation["error"], "x": base_action})
        np.testing.assert_allclose(action, np.clip(base_action + 0.4 * correction, -1, 1), atol=1e-6)
        np.testing.assert_array_equal(state, base_state)


def test_load(tmp_path):
    card = {"env_id": toy.SINGLE, "base": None, "network": LAYOUT.__dict__}
    path = save_checkpoint(tmp_path / "a.safetensors", random_tensors(LAYOUT), card)
    batch = observations(4)
    expected, _ = NetworkPolicy(LAYOUT, random_tensors(LAYOUT)).predict(batch)
    for policy in (load_network_policy(path), load_policy(toy.SINGLE, path)):
        np.testing.assert_array_equal(policy.predict(batch)[0], expected)
    layout = NetworkLayout(keys=("error", BASE_ACTION), sizes=(2, 2), actions=2)
    base = {"env_id": toy.SINGLE, "name": "pi", "scale": 0.5}
    card = {"env_id": toy.SINGLE, "base": base, "network": layout.__dict__}
    path = save_checkpoint(tmp_path / "b.safetensors", random_tensors(layout), card)
    assert isinstance(load_network_policy(path).base, toy.Integral)
    card["base"] = base | {"name": "toy_environment:Integral"}  # a file must not name code to run
    with pytest.raises(ValueError, match="valid: pi"):
        load_network_policy(save_checkpoint(path, random_tensors(layout), card))


def test_bad_input():
    tensors = random_tensors(LAYOUT)
    policy = NetworkPolicy(LAYOUT, tensors)
    with pytest.raises(ValueError, match="'velocity'"):
        policy.predict({"error": np.zeros(2)})
    with pytest.raises(ValueError, match=r"observation\['error'\].*\(3,\)"):
        policy.predict({"error": np.zeros(3), "velocity": np.zeros(2)})
    with pytest.raises(ValueError, match="dimensions"):
        policy.predict({"error": np.zeros((4, 2)), "velocity": np.zeros(2)})
    with pytest.raises(ValueError, match=r"actor\.0\.weight"):
        NetworkPolicy(LAYOUT, tensors | {"actor.0.weight": np.zeros((4, 5))})
    with pytest.raises(ValueError, match="base"):
        NetworkPolicy(LAYOUT, tensors, base=toy.Integral())
    with pytest.raises(ValueError, match="dtype"):
        NetworkPolicy(LAYOUT, tensors, dtype=np.int32)
