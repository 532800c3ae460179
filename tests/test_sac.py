"""Soft actor-critic: its actor in NumPy, hindsight, its memory on disk, exact resumption, learning, users' mistakes."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import toy_environment as toy
import toy_goal as goal

from aerograsp_env.wrappers import BASE_ACTION
from agents import evaluate, load_policy, sac
from agents.checkpoint import CheckpointError, NetworkLayout, load_checkpoint
from agents.derived_inputs import DERIVED, derive
from agents.network_policy import NetworkPolicy, load_network_policy
from agents.sac_config import SacConfig
from agents.sac_training import REPLAY, load_replay
from agents.sb3_env import make_learner_env
from agents.train import main, train
from agents.train_config import BEST, LATEST, TrainConfig, TrainingInterrupted

toy.register()
goal.register()
SMALL = {"num_envs": 4, "hidden": (8,), "batch_size": 16, "learning_starts": 120, "gradient_steps": 1}
SMALL |= {"eval_episodes": 2, "eval_every": 200, "checkpoint_every": 200, "replay_size": 1000, "algorithm": "sac"}
FIELDS = {key: value for key, value in SMALL.items() if key != "algorithm"}
READ = ("achieved_goal", "desired_goal", "observation", *DERIVED)


def built(env_id: str, **options):
    config = SacConfig(**FIELDS | options)
    env = make_learner_env(env_id, config, flatten=False)
    model, normalized = sac.build(config, env)
    return config, env, model, normalized


def observations(n: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {key: rng.normal(0.0, 2.0, (n, size)).astype(np.float32) for key, size in goal.SIZES.items()}


# --- the actor without torch ------------------------------------------------


@pytest.mark.parametrize(("keys", "hidden", "activation"), [((), (16, 8), "relu"), (("observation",), (), "tanh")])
def test_the_numpy_actor_equals_stable_baselines(keys, hidden, activation):
    import torch

    config, env, model, normalized = built(goal.SINGLE, keys=keys, hidden=hidden, activation=activation)
    for k, rms in enumerate(normalized.obs_rms.values()):
        rms.mean, rms.var = rms.mean + 0.3 * k, rms.var * (1.0 + k)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter += 0.1 * torch.randn(parameter.shape)
    observation = observations(200)
    goals = (observation["achieved_goal"], observation["desired_goal"])
    read = observation | {key: derive(key, *goals, goals[1]) for key in DERIVED}  # of an episode's first step
    normal = normalized.normalize_obs({key: read[key] for key in env.keys})
    expected, _ = model.predict(normal, deterministic=True)
    layout, tensors = sac.layout(config, env), sac.actor_tensors(model, normalized)
    assert layout.squash and layout.keys == (keys or READ)
    for dtype in (np.float64, np.float32):
        action, _ = NetworkPolicy(layout, tensors, dtype=dtype).predict(observation)
        np.testing.assert_allclose(action, expected, rtol=0, atol=1e-5)
    assert np.std(expected) > 0.1 and np.mean(np.abs(expected) < 0.99) > 0.2


def test_sampling_has_the_deviation_of_the_state_and_is_squashed():
    layout = NetworkLayout(keys=("x",), sizes=(1,), actions=1, hidden=(), epsilon=0.0, squash=True)
    tensors = {
        "observation.mean": np.zeros(1),
        "observation.var": np.ones(1),
        "actor.0.weight": np.zeros((1, 1)),
        "actor.0.bias": np.array([0.3]),
        "log_std.weight": np.ones((1, 1)),
        "log_std.bias": np.array([-2.0]),
    }
    policy = NetworkPolicy(layout, tensors, seed=0)
    np.testing.assert_allclose(policy.predict({"x": np.array([1.0])})[0], np.tanh([0.3]), atol=1e-7)
    for x, std in ((0.0, np.exp(-2.0)), (1.0, np.exp(-1.0)), (9.0, np.exp(2.0))):  # the last at its bound
        batch = {"x": np.full((40_000, 1), x)}
        action = np.clip(policy.predict(batch, deterministic=False)[0].astype(float), -1 + 1e-7, 1 - 1e-7)
        if x < 9.0:
            drawn = np.arctanh(action)
            assert drawn.mean() == pytest.approx(0.3, abs=0.01) and drawn.std() == pytest.approx(std, rel=0.02)
        else:
            assert np.mean(action > np.tanh(0.3 + std)) == pytest.approx(0.1587, abs=0.01)


def test_cards_without_squash_are_of_networks_that_do_not():
    network = {"keys": ["x"], "sizes": [1], "actions": 1, "hidden": [], "activation": "tanh", "clip": 1, "epsilon": 0}
    assert NetworkLayout.from_card({"network": network}).squash is False
    assert NetworkLayout.from_card({"network": network | {"squash": True}}).squash is True
    with pytest.raises(ValueError, match="squash"):
        NetworkLayout.from_card({"network": network | {"squash": "yes"}})


def test_a_residual_begins_as_its_base_and_reads_what_the_network_does_not():
    config, env, model, normalized = built(goal.BATCHED, residual="servo", goals=4)
    assert env.keys == (*READ, BASE_ACTION) and not sac.hindsight(config, env)
    layout, tensors = sac.layout(config, env), sac.actor_tensors(model, normalized)
    policy = NetworkPolicy(layout, tensors, base=goal.Servo(), scale=0.3)
    a, b = (evaluate(goal.SINGLE, actor, 3, 5).returns for actor in (policy, goal.Servo()))
    np.testing.assert_allclose(a, b, atol=1e-6)


# --- experience -------------------------------------------------------------


@pytest.mark.parametrize("env_id", [goal.SINGLE, goal.BATCHED])
def test_hindsight_goals_were_reached_later_in_the_same_episode_and_earn_the_environments_reward(env_id):
    config, env, model, _ = built(env_id, goals=10**6, seed=3)  # hindsight alone
    assert sac.hindsight(config, env)
    model.learn(4 * 3 * goal.LIMIT)
    replay = model.replay_buffer
    rows = {tuple(replay.next_observations["achieved_goal"][t, i]): (t, i) for t in range(replay.pos) for i in range(4)}
    sample = replay.sample(300)
    reward = goal.Goal().compute_reward(
        sample.next_observations["achieved_goal"], sample.observations["desired_goal"], {}
    )
    np.testing.assert_allclose(sample.rewards[:, 0], reward, atol=1e-6)
    for k in range(1, 300):  # the first one really happened
        t, i = rows[tuple(sample.next_observations["achieved_goal"][k].numpy())]
        later, other = rows[tuple(sample.observations["desired_goal"][k].numpy())]
        assert other == i and later >= t and later // goal.LIMIT == t // goal.LIMIT


def test_goals_of_hindsight_move_as_the_true_ones_did(monkeypatch):
    """They are the episode's, shifted; what is derived from them is theirs; their reward is the next observation's."""
    step = goal.Goal.step

    def moving(self, action):
        self.goal = self.goal + np.array([0.03, -0.02])
        return step(self, action)

    monkeypatch.setattr(goal.Goal, "step", moving)
    _, _, model, normalized = built(goal.BATCHED, goals=10**6, seed=3)
    model.learn(4 * 3 * goal.LIMIT)
    sample = model.replay_buffer.sample(200)
    now, later = ({key: rows.numpy() for key, rows in part.items()} for part in (sample[0], sample[2]))
    for part, before in ((now, None), (later, now["desired_goal"])):
        for key in DERIVED[:2]:
            expected = derive(key, part["achieved_goal"], part["desired_goal"], part["desired_goal"])
            np.testing.assert_allclose(part[key], expected, atol=1e-6)
        if before is not None:
            np.testing.assert_allclose(part["goal_step"], part["desired_goal"] - before, atol=1e-5)
            np.testing.assert_allclose(part["goal_step"], np.tile([0.03, -0.02], (200, 1)), atol=1e-5)
    distance = np.linalg.norm(later["desired_goal"] - later["achieved_goal"], axis=1)
    np.testing.assert_allclose(sample.rewards.numpy()[:, 0], -distance, atol=1e-6)
    assert 0 < np.sum(distance[1:] < 1e-6) < 100  # met at once, or later
    normal = model.replay_buffer.sample(100, normalized).observations["goal_offset_fine"]
    assert float(normal.abs().max()) <= normalized.clip_obs and float(normal.std()) > 0.1


def test_no_hindsight_without_goals():
    for env_id, options in ((toy.BATCHED, {}), (goal.SINGLE, {"goals": 0}), (goal.SINGLE, {"keys": ("observation",)})):
        config, env, model, _ = built(env_id, **options)
        assert not sac.hindsight(config, env) and type(model.replay_buffer).__name__ == "DictReplayBuffer"


def test_a_limit_is_no_end():
    """The value after a time limit counts, that after a crash does not."""
    _, _, model, _ = built(toy.BATCHED)
    model.learn(4 * 3 * toy.LIMIT)
    replay = model.replay_buffer
    ended = replay.dones[: replay.pos] > 0
    last = replay.next_observations["error"][: replay.pos]
    crashed = np.linalg.norm(last, axis=-1) > 4.0
    assert ended.any() and np.array_equal(replay.timeouts[: replay.pos] > 0, ended & ~crashed)


# --- runs -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("env_id", "residual"), [(goal.BATCHED, None), (goal.SINGLE, "servo"), (toy.BATCHED, None)], ids=str
)
def test_a_resumed_run_is_the_uninterrupted_one(tmp_path, env_id, residual):
    options = SMALL | {"residual": residual, "final_learning_rate": 1e-3, "replay_size": 300, "normalize_reward": True}
    whole = train(env_id, out=tmp_path / "whole", steps=600, **options)
    train(env_id, out=tmp_path / "parts", steps=200, **options)
    train(env_id, resume=tmp_path / "parts", steps=400)
    resumed = train(env_id, resume=tmp_path / "parts", steps=600)
    assert whole.steps == resumed.steps == 600 and [row["steps"] for row in resumed.curve] == [200, 400, 600]
    assert [row["score"] for row in resumed.curve] == [row["score"] for row in whole.curve]
    a, b = (load_checkpoint(tmp_path / name / LATEST) for name in ("whole", "parts"))
    assert a.tensors.keys() == b.tensors.keys()
    for name in a.tensors:
        np.testing.assert_array_equal(a.tensors[name], b.tensors[name], err_msg=name)
    assert a.tensors["optimizer.step.temperature.log"] == a.tensors["counters"][1] > 0
    with np.load(tmp_path / "whole" / REPLAY) as first, np.load(tmp_path / "parts" / REPLAY) as second:
        assert first.files == second.files
        for name in first.files:
            np.testing.assert_array_equal(first[name], second[name], err_msg=name)


def test_state_round_trips_exactly(tmp_path):
    train(goal.BATCHED, out=tmp_path, steps=400, **SMALL)
    saved = load_checkpoint(tmp_path / LATEST).tensors
    _, _, model, env = built(goal.BATCHED, seed=99)
    sac.restore(model, env, saved)
    again = sac.training_tensors(model, env)
    assert again.keys() == saved.keys()
    assert {"optimizer.exp_avg_sq.critic.qf1.0.weight", "critic_target.qf0.0.bias", "temperature.log"} < again.keys()
    for name, value in saved.items():
        np.testing.assert_array_equal(again[name], value, err_msg=name)


def test_without_its_memory_a_run_gathers_experience_first(tmp_path):
    train(goal.BATCHED, out=tmp_path, steps=200, **SMALL, replay_saved=False)
    assert not (tmp_path / REPLAY).exists()
    before = load_checkpoint(tmp_path / LATEST).tensors["counters"][1]
    train(goal.BATCHED, resume=tmp_path, steps=300)
    assert load_checkpoint(tmp_path / LATEST).tensors["counters"][1] == before  # 100 new steps are less than 120
    train(goal.BATCHED, resume=tmp_path, steps=500)
    assert load_checkpoint(tmp_path / LATEST).tensors["counters"][1] > before


@pytest.mark.parametrize(
    ("reward_mode", "steps"), [("dense", 2000), pytest.param("sparse", 6000, marks=pytest.mark.slow)]
)
def test_it_learns_to_reach(tmp_path, reward_mode, steps):
    """With hindsight also where the reward says hardly anything; by success, since no metric is named "error"."""
    export = tmp_path / "reach.safetensors"
    options = {"num_envs": 4, "hidden": (32, 32), "batch_size": 64, "learning_starts": 300, "gradient_steps": 2}
    options |= {"eval_every": 1000, "eval_episodes": 20, "gamma": 0.9, "learning_rate": 3e-3}
    result = train(
        goal.BATCHED, SacConfig(**options, steps=steps, env_kwargs={"reward_mode": reward_mode}),
        out=tmp_path / "run", export=export,
    )  # fmt: skip
    card = load_checkpoint(export).card
    assert card["algorithm"] == "sac-her" and card["kind"] == "policy" and card["network"]["squash"] is True
    assert card["network"]["keys"] == list(READ)  # not the cloud
    assert card["validation_error"] is None and card["validation_score"] == result.best["score"]
    policy = load_policy(goal.SINGLE, str(export))
    assert evaluate(goal.SINGLE, policy, 20, 10**6).mean("success") > 0.8
    assert evaluate(goal.SINGLE, "zero", 20, 10**6).mean("success") < 0.2
    assert (tmp_path / "run" / BEST).exists() and list((tmp_path / "run" / "tensorboard").iterdir())


def test_an_exported_policy_acts_without_torch(tmp_path):
    export = tmp_path / "p.safetensors"
    train(goal.BATCHED, out=tmp_path / "run", steps=200, export=export, residual="servo", **SMALL)
    code = (
        "import sys; sys.modules['torch'] = None; sys.path.insert(0, sys.argv[1])\n"
        "import toy_goal; toy_goal.register()\n"
        "from agents import evaluate; print(evaluate(toy_goal.SINGLE, sys.argv[2], 2, 7).returns.tolist())"
    )
    command = [sys.executable, "-c", code, str(Path(__file__).parent), str(export)]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    expected = evaluate(goal.SINGLE, load_network_policy(export, goal.BATCHED), 2, 7).returns
    np.testing.assert_allclose(json.loads(printed), expected)


def test_keyboard_interrupt_leaves_a_checkpoint_that_resumes(tmp_path, monkeypatch):
    steps = []
    step = goal.Goals.step

    def interrupting(self, actions):
        steps.append(1)
        if len(steps) == 70:
            os.kill(os.getpid(), signal.SIGINT)
        return step(self, actions)

    monkeypatch.setattr(goal.Goals, "step", interrupting)
    with pytest.raises(TrainingInterrupted, match=f"resume with: aerograsp train {goal.BATCHED} --resume"):
        train(goal.BATCHED, out=tmp_path, steps=10_000, **SMALL | {"eval_episodes": 0})
    assert load_checkpoint(tmp_path / LATEST).card["steps"] == 280
    assert train(goal.BATCHED, resume=tmp_path, steps=400, eval_episodes=0).steps == 400


def test_command_line(tmp_path, capsys):
    run = tmp_path / "run"
    arguments = [goal.BATCHED, "--num-envs", "4", "--hidden", "8", "--batch-size", "16", "--eval-episodes", "1"]
    arguments += ["--learning-starts", "100", "--goals", "2", "--out", str(run)]
    assert main([*arguments, "--algorithm", "sac", "--steps", "200", "--no-replay-saved"]) == 0
    assert load_checkpoint(run / LATEST).card["algorithm"] == "sac-her"
    assert main([*arguments, "--resume", "--steps", "240"]) == 0  # the run says which algorithm it is of
    assert main([goal.BATCHED, "--resume", str(run / LATEST), "--goals", "3", "--steps", "280"]) == 0
    assert load_checkpoint(run / LATEST).card["training"]["config"]["goals"] == 3
    for algorithm, option in (("sac", "--replay-size"), ("ppo", "--clip-range")):
        with pytest.raises(SystemExit):
            main(["--help", "--algorithm", algorithm])
        text = capsys.readouterr().out
        assert option in text and ("--tau" in text) == (algorithm == "sac") and "object_cloud" in text


# --- PPO on the same environments ---------------------------------------------


@pytest.mark.parametrize("residual", [None, "servo"])
@pytest.mark.parametrize("env_id", [goal.SINGLE, goal.BATCHED])
def test_ppo_takes_goals_and_leaves_clouds(tmp_path, env_id, residual):
    options = {"num_envs": 4, "n_steps": 16, "batch_size": 32, "hidden": (8,), "eval_episodes": 2}
    train(env_id, TrainConfig(**options, steps=64, residual=residual), out=tmp_path / "run")
    card = load_checkpoint(tmp_path / "run" / BEST).card
    assert card["network"]["keys"] == [*READ, *([BASE_ACTION] if residual else [])]
    assert load_policy(env_id, tmp_path / "run" / BEST).predict(observations(3))[0].shape == (3, 2)
    train(env_id, TrainConfig(**options, steps=64, keys=("object_cloud", "observation")), out=tmp_path / "cloud")
    assert load_checkpoint(tmp_path / "cloud" / BEST).card["network"]["sizes"] == [goal.CLOUD, 2]


# --- mistakes -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"algorithm": "td3"}, "algorithm.*'td3'.*ppo, sac"),
        ({"algorithm": "ppo", "config": SacConfig()}, "algorithm.*ppo, sac"),
        ({"goals": -1}, "goals"),
        ({"replay_size": 2}, "replay_size.*4, got 2"),
        ({"tau": 0.0}, "tau"),
        ({"tau": 1.5}, "tau"),
        ({"entropy": 0.0}, "entropy"),
        ({"target_entropy": float("nan")}, "target_entropy"),
        ({"gradient_steps": 0}, "gradient_steps"),
        ({"n_steps": 16}, "n_steps"),
        ({"keys": ("nothing",)}, "nothing.*desired_goal"),
        ({"residual": "pid"}, "pid.*valid: servo"),
    ],
)
def test_mistakes_are_one_line(tmp_path, changes, words):
    with pytest.raises(ValueError, match=words) as error:
        train(goal.BATCHED, out=tmp_path, **{"steps": 200, **SMALL, **changes})
    assert "\n" not in str(error.value)


def test_mistakes_with_files(tmp_path):
    train(goal.BATCHED, out=tmp_path, steps=200, **SMALL)
    with pytest.raises(ValueError, match=r"algorithm.*ppo, sac"):
        train(goal.BATCHED, resume=tmp_path, steps=400, algorithm="ppo")
    with pytest.raises(CheckpointError, match=r"actor\.0\.weight"):
        train(goal.BATCHED, resume=tmp_path, steps=400, hidden=(9,))
    with pytest.raises(CheckpointError, match=r"replay\.npz.*achieved|replay\.npz.*shape"):
        train(goal.BATCHED, resume=tmp_path, steps=400, num_envs=8)
    with pytest.raises(CheckpointError, match=r"replay\.npz.*step 200, not 100"):
        load_replay(tmp_path / REPLAY, built(goal.BATCHED)[2].replay_buffer, 100)
    (tmp_path / REPLAY).write_bytes((tmp_path / REPLAY).read_bytes()[:500])
    with pytest.raises(CheckpointError, match=r"replay\.npz"):
        train(goal.BATCHED, resume=tmp_path, steps=400)
    (tmp_path / REPLAY).unlink()
    assert train(goal.BATCHED, resume=tmp_path, steps=240).steps == 240


def test_a_configuration_survives_its_card():
    config = SacConfig(keys=("a",), hidden=(3,), target_entropy=-2.0, env_kwargs={"delay": (0.06, 0.1)})
    assert SacConfig.from_card(json.loads(json.dumps(config.to_card()))) == config
    assert config.algorithm == "sac" and SacConfig(residual="dls").algorithm == "sac-residual"


# --- the arm of the suite -------------------------------------------------------


def test_reach_is_trained_with_hindsight(tmp_path):
    env_id = "aerograsp/Reach-v0"
    options = {"max_episode_steps": 20, "wind": "calm", "localization": "truth"}
    config = SacConfig(
        **FIELDS | {"num_envs": 2, "learning_starts": 40, "eval_episodes": 1}, steps=80, env_kwargs=options
    )
    export = tmp_path / "reach.safetensors"
    result = train(env_id, config, out=tmp_path / "run", export=export)
    card = load_checkpoint(export).card
    assert card["algorithm"] == "sac-her" and card["network"]["keys"] == [*READ]
    assert load_checkpoint(tmp_path / "run" / LATEST).tensors["counters"][1] > 0
    score = evaluate(env_id, str(export), 1, 2_000_000, options).returns[0]
    assert score == pytest.approx(result.best["return"], rel=1e-3)  # single and batched worlds, torch's export
