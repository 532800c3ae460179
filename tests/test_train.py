"""Training: the adapter's bookkeeping, exact resumption, interruption, learning, and users' mistakes."""

import json
import os
import signal

import numpy as np
import pytest
import toy_environment as toy
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from aerograsp_env.wrappers import BASE_ACTION, ResidualActionVector
from agents import evaluate, load_policy, ppo
from agents.checkpoint import CheckpointError, load_checkpoint
from agents.network_policy import NetworkPolicy
from agents.sb3_env import SB3VecEnv, make_learner_env
from agents.seeds import TRAIN_SEEDS
from agents.train import main, train
from agents.train_config import BEST, LATEST, TrainConfig, TrainingInterrupted
from agents.training import world_seed

toy.register()
ROLLOUT = 64
SMALL = {"num_envs": 4, "n_steps": 16, "batch_size": 32, "epochs": 2, "hidden": (8,), "eval_episodes": 2}
SMALL |= {"checkpoint_every": 2 * ROLLOUT, "eval_every": 2 * ROLLOUT}


def sync(n: int) -> SyncVectorEnv:
    import gymnasium

    make = [lambda: gymnasium.make(toy.SINGLE)] * n
    return SyncVectorEnv(make, autoreset_mode=AutoresetMode.SAME_STEP)


ADAPTED = {
    "native same step": lambda n: toy.Points(n, autoreset_mode=AutoresetMode.SAME_STEP),
    "native next step": lambda n: toy.Points(n, autoreset_mode=AutoresetMode.NEXT_STEP),
    "sync": sync,
}


@pytest.mark.parametrize("kind", ADAPTED)
@pytest.mark.parametrize("base", [None, toy.Integral()], ids=["direct", "residual"])
def test_adapter_equals_worlds_stepped_one_by_one(kind, base):
    """Observations, rewards, ends and final observations are those of single worlds that are reset by hand."""
    n, scale, keys = 3, 0.5, ("velocity", "error")
    venv = ADAPTED[kind](n)
    env = SB3VecEnv(venv if base is None else ResidualActionVector(venv, base, scale), keys)
    env.seed(7)
    observation = env.reset()
    rng = np.random.default_rng(0)
    singles = [toy.Points(1, max_episode_steps=toy.LIMIT, autoreset_mode=AutoresetMode.DISABLED) for _ in range(n)]
    seen = [single.reset(seed=7 + i)[0] for i, single in enumerate(singles)]
    states, totals, ended = [None] * n, np.zeros((n, 2)), 0
    width = 4 if base is None else 6
    assert env.observation_space.shape == (width,)

    def row(i, start):
        parts = [seen[i][key][0] for key in keys]
        if base is None:
            return np.concatenate(parts), None
        action, states[i] = base.predict(seen[i], None if start else states[i])
        return np.concatenate([*parts, action[0]]), action[0]

    bases = []
    for i in range(n):
        expected, base_action = row(i, True)
        np.testing.assert_array_equal(observation[i], expected)
        bases.append(base_action)
    for _ in range(3 * toy.LIMIT):
        actions = rng.uniform(-1, 1, (n, 2)).astype(np.float32)
        observation, reward, dones, infos = env.step(actions)
        for i, single in enumerate(singles):
            executed = actions[i] if base is None else np.clip(bases[i] + scale * actions[i], -1, 1)
            seen[i], r, crashed, late, info = single.step(executed[None].astype(np.float32))
            totals[i] += [r[0], 1]
            assert reward[i] == pytest.approx(r[0], abs=1e-6) and dones[i] == (crashed[0] or late[0])
            expected, bases[i] = row(i, False)
            if dones[i]:
                ended += 1
                np.testing.assert_allclose(infos[i]["terminal_observation"], expected, atol=1e-6)
                assert infos[i]["TimeLimit.truncated"] == (late[0] and not crashed[0])
                assert infos[i]["is_success"] == info["success"][0]
                assert infos[i]["episode"]["r"] == pytest.approx(totals[i, 0], abs=1e-4)
                assert infos[i]["episode"]["l"] == totals[i, 1]
                totals[i] = 0.0
                seen[i], _ = single.reset()
                expected, bases[i] = row(i, True)
            else:
                assert infos[i] == {}
            np.testing.assert_allclose(observation[i], expected, atol=1e-6)
    assert ended >= 3 * n


def test_adapter_keeps_a_dict_and_copies_it():
    venv = toy.Points(2, autoreset_mode=AutoresetMode.SAME_STEP)
    env = SB3VecEnv(ResidualActionVector(venv, toy.Integral(), 0.3))
    first = env.reset()
    assert first.keys() == {*toy.SIZES, BASE_ACTION} == env.observation_space.spaces.keys()
    kept = {key: value.copy() for key, value in first.items()}
    env.step(np.ones((2, 2), np.float32))
    for key, value in kept.items():
        np.testing.assert_array_equal(first[key], value)
    assert env.get_attr("num_envs", [0, 1]) == [2, 2] and env.env_is_wrapped(object) == [False, False]
    for keys, word in ((("nothing",), "nothing"), (("error", "error"), "twice"), ((), "at least one")):
        with pytest.raises(ValueError, match=word):
            SB3VecEnv(toy.Points(2), keys)


@pytest.mark.parametrize("residual", [None, "pi"])
@pytest.mark.parametrize("env_id", [toy.SINGLE, toy.BATCHED])
def test_a_resumed_run_is_the_uninterrupted_one(tmp_path, env_id, residual):
    options = SMALL | {
        "residual": residual,
        "learning_rate": 1e-3,
        "final_learning_rate": 1e-3,
        "normalize_reward": True,
    }
    whole = train(env_id, out=tmp_path / "whole", steps=4 * ROLLOUT, **options)
    train(env_id, out=tmp_path / "parts", steps=2 * ROLLOUT, **options)
    resumed = train(env_id, resume=tmp_path / "parts", steps=4 * ROLLOUT)
    assert whole.steps == resumed.steps == 4 * ROLLOUT
    assert [row["steps"] for row in resumed.curve] == [2 * ROLLOUT, 4 * ROLLOUT]
    assert [row["score"] for row in resumed.curve] == [row["score"] for row in whole.curve]
    a, b = (load_checkpoint(tmp_path / name / LATEST) for name in ("whole", "parts"))
    assert a.tensors.keys() == b.tensors.keys()
    for name in a.tensors:
        np.testing.assert_array_equal(a.tensors[name], b.tensors[name], err_msg=name)
    assert a.tensors["optimizer.step.log_std"] == 4 * 2 * 2  # rollouts × epochs × minibatches
    assert resumed.wall_time > 0 and b.card["training"]["config"]["steps"] == 4 * ROLLOUT


def test_state_round_trips_exactly(tmp_path):
    train(toy.BATCHED, out=tmp_path, steps=ROLLOUT, **SMALL)
    saved = load_checkpoint(tmp_path / LATEST).tensors
    config = TrainConfig(**SMALL, seed=99)
    model, env = ppo.build(config, make_learner_env(toy.BATCHED, config))
    ppo.restore(model, env, saved)
    again = ppo.training_tensors(model, env)
    assert again.keys() == saved.keys() and {"optimizer.exp_avg_sq.actor.0.weight", "rng.torch"} < again.keys()
    for name, value in saved.items():
        np.testing.assert_array_equal(again[name], value, err_msg=name)
    np.testing.assert_array_equal(saved["counters"], [ROLLOUT, 2])


def test_it_learns(tmp_path):
    options = SMALL | {"num_envs": 16, "n_steps": 64, "batch_size": 256, "epochs": 10, "hidden": (32,), "log_std": -0.5}
    options |= {"learning_rate": 1e-3, "eval_episodes": 10, "eval_every": 10**6, "checkpoint_every": 10**6}
    before = evaluate(toy.BATCHED, load_policy(toy.BATCHED, "zero"), 10, 10**6).mean("error")
    export = tmp_path / "small" / "point.safetensors"
    result = train(
        toy.BATCHED, out=tmp_path / "run", steps=30 * 1024, export=export, env_kwargs={"wind": 0.3}, **options
    )
    policy = load_policy(toy.BATCHED, str(export))
    after = evaluate(toy.BATCHED, policy, 10, 10**6, {"wind": 0.3}).mean("error")
    assert after < 0.6 * before
    card = load_checkpoint(export).card
    assert card["kind"] == "policy" and card["env_kwargs"] == {"wind": 0.3} and card["steps"] == result.steps
    assert card["validation_error"] == result.best["metrics"]["error"] and card["training"]["curve"] == result.curve
    assert all(value.dtype == np.float32 for value in load_checkpoint(export).tensors.values())
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["seconds_per_million_steps"] > 0
    assert list((tmp_path / "run" / "tensorboard").iterdir())


def test_a_residual_begins_as_its_base(tmp_path):
    config = TrainConfig(**SMALL, residual="pi")
    env = make_learner_env(toy.SINGLE, config)
    model, normalized = ppo.build(config, env)
    policy = NetworkPolicy(
        ppo.layout(config, env), ppo.actor_tensors(model, normalized), base=toy.Integral(), scale=0.3
    )
    a, b = (evaluate(toy.SINGLE, actor, 3, 5).returns for actor in (policy, toy.Integral()))
    np.testing.assert_allclose(a, b, atol=1e-6)


def test_keyboard_interrupt_leaves_a_checkpoint_that_resumes(tmp_path, monkeypatch):
    steps = []
    step = toy.Points.step

    def interrupting(self, actions):
        steps.append(1)
        if len(steps) == 40:
            os.kill(os.getpid(), signal.SIGINT)
        return step(self, actions)

    monkeypatch.setattr(toy.Points, "step", interrupting)
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(TrainingInterrupted, match=f"resume with: aerograsp train {toy.BATCHED} --resume"):
        train(toy.BATCHED, out=tmp_path, steps=100 * ROLLOUT, **SMALL | {"eval_episodes": 0})
    assert signal.getsignal(signal.SIGINT) is handler
    found = load_checkpoint(tmp_path / LATEST)
    assert found.card["steps"] == 40 * 4 == found.tensors["counters"][0]
    result = train(toy.BATCHED, resume=tmp_path, steps=4 * ROLLOUT, eval_episodes=0)
    assert result.steps == 40 * 4 + 2 * ROLLOUT and result.best is None  # whole rollouts only


def test_an_interrupt_raised_by_the_environment(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(toy.Points, "step", lambda self, actions: (_ for _ in ()).throw(KeyboardInterrupt))
    assert (
        main([toy.BATCHED, "--out", str(tmp_path), "--num-envs", "4", "--n-steps", "16", "--batch-size", "32"]) == 130
    )
    message = capsys.readouterr().err.strip().splitlines()[-1]
    assert "interrupted after 0 steps" in message and f"--resume {tmp_path}" in message
    load_checkpoint(tmp_path / LATEST)


def test_command_line(tmp_path, capsys):
    arguments = [
        toy.BATCHED,
        "--out",
        str(tmp_path / "run"),
        "--num-envs",
        "4",
        "--n-steps",
        "16",
        "--batch-size",
        "32",
    ]
    arguments += ["--epochs", "1", "--hidden", "8,8", "--keys", "error,velocity", "--eval-episodes", "1"]
    arguments += ["--env-kwarg", "wind=0.2", "--residual", "pi"]
    report = tmp_path / "report.json"
    assert main([*arguments, "--steps", "64", "--json", str(report), "--export", str(tmp_path / "p.safetensors")]) == 0
    written = json.loads(report.read_text())
    assert written["steps"] == 64 and written["best"]["steps"] == 64
    assert "s per million" in capsys.readouterr().out
    card = load_checkpoint(tmp_path / "run" / BEST).card
    assert card["network"]["keys"] == ["error", "velocity", BASE_ACTION] and card["network"]["hidden"] == [8, 8]
    assert card["base"] == {"env_id": toy.BATCHED, "name": "pi", "scale": 0.3}
    assert card["training"]["command"][:3] == ["aerograsp", "train", toy.BATCHED]
    assert main([*arguments, "--steps", "1e2", "--resume"]) == 0  # alone: the run in --out
    assert load_checkpoint(tmp_path / "run" / LATEST).card["steps"] == 128
    with pytest.raises(SystemExit) as exit:
        main(["--help"])
    assert exit.value.code == 0
    help = capsys.readouterr().out
    assert "--residual-scale" in help and "(default: 0.0003)" in help and "(default: 64,64)" in help


def test_a_resumed_policy_that_never_improves_keeps_the_best(tmp_path):
    train(toy.BATCHED, out=tmp_path, steps=ROLLOUT, **SMALL)
    best = load_checkpoint(tmp_path / BEST).tensors
    export = tmp_path / "x.safetensors"
    train(
        toy.BATCHED,
        resume=tmp_path,
        steps=2 * ROLLOUT,
        learning_rate=1e-12,
        log_std=0.0,
        metric="success",
        export=export,
    )
    card = load_checkpoint(export).card
    assert card["steps"] == card["training"]["best"]["steps"] and len(card["training"]["curve"]) == 2
    if card["steps"] == ROLLOUT:
        np.testing.assert_array_equal(load_checkpoint(export).tensors["actor.0.weight"], best["actor.0.weight"])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"steps": 0}, "steps"),
        ({"num_envs": -1}, "num_envs"),
        ({"batch_size": 33}, "batch_size.*divisor"),
        ({"gamma": 1.5}, "gamma"),
        ({"learning_rate": float("nan")}, "learning_rate"),
        ({"activation": "gelu"}, "activation"),
        ({"hidden": (0,)}, "hidden"),
        ({"keys": ("nothing",)}, "nothing.*error, velocity, wind"),
        ({"residual": "pid"}, "pid.*valid: pi"),
        ({"metric": "eror"}, "did you mean 'error'"),
        ({"env_kwargs": {"gusts": 1}}, "gusts"),
        ({"env_kwargs": {"wind": object()}}, "JSON"),
        ({"nonsense": 1}, "nonsense"),
        ({"export": "policy.pt"}, "safetensors"),
        ({"resume": "nowhere.safetensors"}, "nowhere"),
    ],
)
def test_mistakes_are_one_line(tmp_path, changes, words):
    with pytest.raises(ValueError, match=words) as error:
        train(toy.BATCHED, out=tmp_path, **{"steps": ROLLOUT, **SMALL, **changes})
    assert "\n" not in str(error.value)
    assert not (tmp_path / LATEST).exists() or "metric" in changes


def test_mistakes_with_files(tmp_path):
    with pytest.raises(ValueError, match="toy/Pont-v0"):
        train("toy/Pont-v0", out=tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        train(toy.BATCHED, out=tmp_path / "file" / "run", steps=ROLLOUT, **SMALL)
    run = tmp_path / "run"
    train(toy.BATCHED, out=run, steps=ROLLOUT, **SMALL)
    with pytest.raises(ValueError, match="already holds a run"):
        train(toy.BATCHED, out=run, steps=ROLLOUT, **SMALL)
    with pytest.raises(ValueError, match="more than the 64"):
        train(toy.BATCHED, resume=run, steps=ROLLOUT)
    with pytest.raises(CheckpointError, match=r"latest.*actor\.0\.weight"):
        train(toy.BATCHED, resume=run, steps=2 * ROLLOUT, hidden=(9,))
    with pytest.raises(CheckpointError, match="inference only"):
        train(toy.BATCHED, resume=run / BEST, steps=2 * ROLLOUT)
    with pytest.raises(CheckpointError, match="not toy/Point-v0"):
        train(toy.SINGLE, resume=run, steps=2 * ROLLOUT)
    content = (run / LATEST).read_bytes()
    (run / LATEST).write_bytes(content[:1000])
    with pytest.raises(CheckpointError, match="corrupt"):
        train(toy.BATCHED, resume=run, steps=2 * ROLLOUT)


def test_seeds_stay_in_their_range():
    config = TrainConfig(num_envs=64)
    seeds = {world_seed(config, steps) for steps in range(2000)}
    assert len(seeds) > 1990 and all(s in TRAIN_SEEDS and s + 63 in TRAIN_SEEDS for s in seeds)
    assert world_seed(config, 5) == world_seed(config, 5) != world_seed(TrainConfig(seed=1), 5)


def test_a_configuration_survives_its_card():
    config = TrainConfig(
        keys=("a", "b"), hidden=(3,), target_kl=0.02, env_kwargs={"delay": (0.06, 0.1), "wind": "gusty"}
    )
    again = TrainConfig.from_card(json.loads(json.dumps(config.to_card())))
    assert again == config and again.env_kwargs["delay"] == (0.06, 0.1)
    with pytest.raises(ValueError, match="unknown fields colour"):
        TrainConfig.from_card({"colour": 1})
