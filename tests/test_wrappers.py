"""Residual actions: the sum that reaches the environment, the base policy's memory, and autoreset."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Dict
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from aerograsp_env.wrappers import ResidualAction, ResidualActionVector

TOY = "aerograsp-test/Toy-v0"


class Toy(gymnasium.Env[Any, Any]):
    """A point pushed about in the plane, in episodes of random length; it remembers the action that reached it."""

    metadata = {"render_modes": []}  # noqa: RUF012  # Gymnasium's own form
    observation_space = Dict(
        {"position": Box(-10.0, 10.0, (2,), np.float32), "velocity": Box(-1.0, 1.0, (2,), np.float32)}
    )
    action_space = Box(-1.0, 1.0, (2,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.position = self.np_random.uniform(-1, 1, 2)
        self.velocity = np.zeros(2)
        self.remaining = int(self.np_random.integers(3, 8))
        return self._observe(), {}

    def step(self, action: np.ndarray) -> Any:
        self.received = action.copy()
        self.velocity = np.clip(self.velocity + 0.1 * action, -1, 1)
        self.position = np.clip(self.position + self.velocity, -10, 10)
        self.remaining -= 1
        return (
            self._observe(),
            -float(np.abs(self.position).sum()),
            False,
            self.remaining == 0,
            {"left": self.remaining},
        )

    def _observe(self) -> dict[str, np.ndarray]:
        return {"position": self.position.astype(np.float32), "velocity": self.velocity.astype(np.float32)}


class Integrator:
    """A PI controller, batched: its state counts and sums, so that any missed or doubled restart shows at once."""

    def __init__(self, gain: float = 0.2) -> None:
        self.gain = gain
        self.calls: list[tuple[dict[str, np.ndarray], Any, Any, bool]] = []

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> Any:
        self.calls.append((observation, state, episode_start, deterministic))
        position = observation["position"]
        total, steps = (np.zeros_like(position), np.zeros(position.shape[:-1])) if state is None else state
        if episode_start is not None:
            total, steps = np.where(episode_start[:, None], 0, total), np.where(episode_start, 0, steps)
        total, steps = total + position, steps + 1
        action = -self.gain * position - 0.05 * total + 0.01 * steps[..., None]
        return np.clip(action, -1, 1).astype(np.float32), (total, steps)


class Answer:
    """Always answers the same."""

    def __init__(self, action: Any) -> None:
        self.action = action

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> Any:
        return self.action, None


@pytest.fixture(autouse=True)
def toy() -> Iterator[None]:
    gymnasium.register(TOY, entry_point=lambda **_: Toy())
    yield
    gymnasium.registry.pop(TOY)


def assert_same(a: Any, b: Any) -> None:
    assert a.keys() == b.keys()
    for key in a:
        np.testing.assert_array_equal(a[key], b[key], err_msg=key)


# --- single environments -----------------------------------------------------


def test_gymnasiums_check_finds_nothing() -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(ResidualAction(gymnasium.make(TOY), Integrator()))
    # A wrapper is not the unwrapped environment, which is all there is to say.
    assert [str(w.message) for w in caught if "different from the unwrapped version" not in str(w.message)] == []


def test_spaces_and_first_observation() -> None:
    env = ResidualAction(Toy(), Integrator())
    assert env.action_space == Toy.action_space
    assert isinstance(env.observation_space, Dict)
    assert env.observation_space["base_action"] == Box(-1.0, 1.0, (2,), np.float32)
    assert Toy.observation_space.keys() == {"position", "velocity"}
    observation, info = env.reset(seed=0)
    assert observation in env.observation_space
    expected, _ = Integrator().predict({"position": observation["position"]})
    np.testing.assert_array_equal(observation["base_action"], expected)
    np.testing.assert_array_equal(info["base_action"], expected)


def test_the_environment_receives_base_plus_scaled_action_clipped() -> None:
    toy = Toy()
    env = ResidualAction(toy, Integrator(), scale=0.4)
    observation, _ = env.reset(seed=1)
    for action in ([0.5, -1.0], [0.0, 0.0], [1.0, 1.0]):
        base = observation["base_action"]
        observation, *_, info = env.step(np.array(action, np.float32))
        np.testing.assert_allclose(toy.received, np.clip(base + 0.4 * np.array(action), -1, 1), atol=1e-7)
        np.testing.assert_array_equal(info["base_action"], observation["base_action"])
        assert "left" in info
    full = ResidualAction(Toy(), Answer([0.9, -0.9]), scale=0.3)
    full.reset(seed=0)
    full.step(np.array([1, -1], np.float32))
    np.testing.assert_array_equal(full.unwrapped.received, [1.0, -1.0])  # type: ignore[attr-defined]


def test_zero_agent_equals_the_base_policy_alone() -> None:
    policy, plain = Integrator(), Toy()
    env = ResidualAction(Toy(), policy)
    observation, _ = env.reset(seed=3)
    expected, _ = plain.reset(seed=3)
    state = None
    for _ in range(3):
        action, state = Integrator().predict(expected, state)
        expected, reward, *_ = plain.step(action)
        observation, wrapped_reward, *_ = env.step(np.zeros(2, np.float32))
        assert reward == wrapped_reward
        assert_same({k: v for k, v in observation.items() if k != "base_action"}, expected)


def test_the_policy_is_asked_once_for_each_observation_and_starts_afresh() -> None:
    policy = Integrator()
    env = ResidualAction(Toy(), policy)
    first, _ = env.reset(seed=5)
    env.step(np.zeros(2, np.float32))
    env.step(np.zeros(2, np.float32))
    again, _ = env.reset(seed=5)
    assert [state is None for _, state, _, _ in policy.calls] == [True, False, False, True]
    assert all(deterministic and "base_action" not in seen for seen, _, _, deterministic in policy.calls)
    assert_same(first, again)


def test_what_is_returned_can_be_changed_without_harm() -> None:
    toy = Toy()
    env = ResidualAction(toy, Answer(np.array([0.5, 0.5], np.float32)))
    observation, info = env.reset(seed=0)
    observation["base_action"][:] = 9
    info["base_action"][:] = 9
    observation, *_ = env.step(np.zeros(2, np.float32))
    np.testing.assert_array_equal(toy.received, [0.5, 0.5])
    np.testing.assert_array_equal(observation["base_action"], [0.5, 0.5])


def test_spec_makes_the_same_environment() -> None:
    env = ResidualAction(gymnasium.make(TOY), Integrator(gain=0.7), scale=0.1)
    assert env.spec is not None
    twin = gymnasium.make(env.spec)
    assert_same(env.reset(seed=2)[0], twin.reset(seed=2)[0])


def test_misuse() -> None:
    with pytest.raises(ValueError, match="policy: expected an object with a predict method"):
        ResidualAction(Toy(), lambda observation: observation)  # type: ignore[arg-type]
    for scale in (-0.1, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="scale: expected a finite value ≥ 0"):
            ResidualAction(Toy(), Integrator(), scale)
    with pytest.raises(ValueError, match="'base_action' yet, got one"):
        ResidualAction(ResidualAction(Toy(), Integrator()), Integrator())
    with pytest.raises(ValueError, match="env: expected a Dict observation space"):
        ResidualAction(gymnasium.make("Pendulum-v1"), Integrator())
    wide = Toy()
    wide.action_space = Box(-2.0, 2.0, (2,), np.float32)
    with pytest.raises(ValueError, match=r"env: expected a Box action space of \[-1, 1\]"):
        ResidualAction(wide, Integrator())
    env = ResidualAction(Toy(), Integrator())
    with pytest.raises(ResetNeeded):
        env.step(np.zeros(2, np.float32))
    env.reset()
    with pytest.raises(ValueError, match=r"action: expected shape \(2,\), got \(\)"):
        env.step(np.float32(0))  # type: ignore[arg-type]
    for answer in ([0.0], [np.nan, 0.0]):
        with pytest.raises(ValueError, match="policy: expected finite actions of shape"):
            ResidualAction(Toy(), Answer(answer)).reset()


# --- vector environments -----------------------------------------------------

WORLDS = 4


def worlds_wrapped(mode: AutoresetMode) -> SyncVectorEnv:
    return SyncVectorEnv([lambda: ResidualAction(Toy(), Integrator())] * WORLDS, autoreset_mode=mode)


def wrapped_worlds(mode: AutoresetMode, policy: Any = None) -> ResidualActionVector:
    env = SyncVectorEnv([Toy] * WORLDS, autoreset_mode=mode)
    return ResidualActionVector(env, policy or Integrator())


@pytest.mark.parametrize("mode", AutoresetMode)
def test_wrapping_worlds_together_equals_wrapping_each(mode: AutoresetMode) -> None:
    """Through many episodes of different lengths: observations, rewards, ends, and the base actions of both kinds."""
    each, together = worlds_wrapped(mode), wrapped_worlds(mode)
    assert together.observation_space == each.observation_space
    assert together.single_observation_space == each.single_observation_space
    assert together.action_space == each.action_space
    rng = np.random.default_rng(0)
    expected, expected_info = each.reset(seed=10)
    observations, infos = together.reset(seed=10)
    ends = 0
    for _ in range(60):
        assert_same(observations, expected)
        assert observations in together.observation_space
        np.testing.assert_array_equal(infos["base_action"], observations["base_action"])
        assert infos["_base_action"].all()
        actions = rng.uniform(-1, 1, (WORLDS, 2)).astype(np.float32)
        expected, *expected_rest, expected_info = each.step(actions)
        observations, *rest, infos = together.step(actions)
        np.testing.assert_array_equal(rest, expected_rest)
        done = rest[1] | rest[2]
        ends += done.sum()
        if mode is AutoresetMode.SAME_STEP and done.any():
            for i in np.flatnonzero(done):
                assert_same(infos["final_obs"][i], expected_info["final_obs"][i])
                assert infos["final_obs"][i] in together.single_observation_space
        if mode is AutoresetMode.DISABLED and done.any():
            assert_same(observations, expected)
            # Gymnasium's environments take the mask out of the options, so each gets its own.
            expected, _ = each.reset(options={"reset_mask": done.copy()})
            observations, infos = together.reset(options={"reset_mask": done.copy()})
    assert ends > 20


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_restarts_are_announced_with_the_first_observation(mode: AutoresetMode) -> None:
    policy = Integrator()
    env = wrapped_worlds(mode, policy)
    env.reset(seed=0)
    done_before = np.zeros(WORLDS, bool)
    for _ in range(30):
        asked = len(policy.calls)
        *_, terminated, truncated, _ = env.step(np.zeros((WORLDS, 2), np.float32))
        done = terminated | truncated
        start = policy.calls[-1][2]
        np.testing.assert_array_equal(start, done if mode is AutoresetMode.SAME_STEP else done_before)
        # One question a step, and one more about final observations, which restarts nothing.
        final = mode is AutoresetMode.SAME_STEP and done.any()
        assert len(policy.calls) - asked == 1 + final
        if final:
            assert not policy.calls[-2][2].any()
        done_before = done
    np.testing.assert_array_equal(policy.calls[0][2], np.ones(WORLDS, bool))


def test_a_full_reset_in_mid_episode_restarts_every_world() -> None:
    env = wrapped_worlds(AutoresetMode.NEXT_STEP)
    first, _ = env.reset(seed=4)
    for _ in range(5):
        env.step(np.ones((WORLDS, 2), np.float32))
    again, _ = env.reset(seed=4)
    assert_same(first, again)


def test_vector_misuse() -> None:
    env = SyncVectorEnv([Toy] * WORLDS)
    env.metadata.pop("autoreset_mode")
    with pytest.raises(ValueError, match=r"env: expected metadata\[.autoreset_mode.\]"):
        ResidualActionVector(env, Integrator())
    wrapped = wrapped_worlds(AutoresetMode.NEXT_STEP)
    with pytest.raises(ResetNeeded):
        wrapped.step(np.zeros((WORLDS, 2), np.float32))
    wrapped.reset()
    with pytest.raises(ValueError, match=r"action: expected shape \(4, 2\), got \(2,\)"):
        wrapped.step(np.zeros(2, np.float32))
    with pytest.raises(ValueError, match=r"policy: expected finite actions of shape \(4, 2\)"):
        ResidualActionVector(SyncVectorEnv([Toy] * WORLDS), Answer([0.0, 0.0])).reset()
