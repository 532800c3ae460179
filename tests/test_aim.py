"""Grasps that are aimed: features of displaced tools, the belief, flights as data, the fit, and the file."""

import json

import numpy as np
import pytest

from aerograsp_env.envs.grasp import GraspEnv
from aerograsp_env.spatial import so3_exp, transform
from agents import aim_dataset
from agents.aim_choice import (
    EMPTY,
    GONE,
    HELD,
    OUTCOMES,
    AimPlanner,
    Outcomes,
    shifted,
)
from agents.aim_dataset import Attempts, collect, read_block
from agents.aim_features import NAMES, grasp_features
from agents.aim_policy import aim_shapes, load_aim_policy
from agents.aim_training import AimConfig, guess_loss, train_aim
from agents.bench_setup import GRASP
from agents.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from agents.policies import CHECKPOINTS, checkpoints, load_policy
from agents.train import main as train_main
from baselines.grasping.reaching import Reached
from baselines.grasping.scenes import Scene
from baselines.policies.grasp_state import Attempt, Phase

DOWN = np.diag([1.0, -1.0, -1.0])  # a gripper that comes from above, in level axes


def bar(half=(0.02, 0.05, 0.03), spacing=0.004) -> Scene:
    """A box on a level seat, its middle 0.6 m below the body."""
    points, normals = [], []
    for axis in range(3):
        u, v = (k for k in range(3) if k != axis)
        for sign in (-1.0, 1.0):
            grid = np.meshgrid(
                np.arange(-half[u], half[u] + 1e-9, spacing), np.arange(-half[v], half[v] + 1e-9, spacing)
            )
            face = np.zeros((grid[0].size, 3))
            face[:, u], face[:, v], face[:, axis] = grid[0].ravel(), grid[1].ravel(), sign * half[axis]
            normal = np.zeros_like(face)
            normal[:, axis] = sign
            points.append(face)
            normals.append(normal)
    T = transform(np.eye(3), np.array([0.2, 0.0, -0.6]))
    return Scene(
        T, np.concatenate(points), np.concatenate(normals), T[:3, 3] - (0.0, 0.0, half[2]), np.array([0, 0, 1.0])
    )


SCENE = bar()
GRASP_ON_BAR = Reached(
    transform(DOWN, np.zeros(3)), 0.04, 0.08, np.zeros(6), np.zeros(6), SCENE.T_level_object, 0.5
)  # fmt: skip


def features(*displacements) -> dict[str, np.ndarray]:
    grasp = GRASP_ON_BAR
    found = grasp_features(
        SCENE, grasp.T_object_grasp, grasp.width, grasp.opening, grasp.score, np.array(displacements), False
    )
    assert found.shape == (len(displacements), len(NAMES)) and np.isfinite(found).all()
    return dict(zip(NAMES, found.T, strict=True))


def test_features_of_a_box_are_its_measures():
    at = features((0.0, 0.0, 0.0), (0.005, 0.0, 0.0), (0.0, 0.07, 0.0), (0.0, 0.0, -0.05), (0.0, 0.0, 0.01))
    np.testing.assert_allclose(at["width_here"][[0, 1]], 0.04, atol=1e-9)
    np.testing.assert_allclose(at["off_middle"][[0, 1]], (0.0, 0.005), atol=1e-9)
    np.testing.assert_allclose(at["gap"][[0, 1]], (0.02, 0.015), atol=1e-9)
    assert at["width_here"][2] == at["width_here"][3] == 0.0  # beside it, and over it
    assert at["facing_more"][0] > 1.0 > at["facing_more"][2] and at["facing_more"][3] < 0.1
    np.testing.assert_allclose(at["height"], (0.03, 0.03, 0.03, 0.08, 0.02), atol=1e-9)
    np.testing.assert_allclose(at["below_top"][[0, 4]], (0.03, 0.04), atol=2e-3)
    np.testing.assert_allclose(at["lever"][[0, 2, 3]], (0.0, 0.07, 0.05), atol=2e-3)
    assert (at["down"] == 1.0).all() and (at["fingers_hit"] == 0.0).all()


def test_fingers_that_come_down_on_the_object_are_seen():
    at = features((0.0, 0.0, 0.0), (0.03, 0.0, 0.0))
    assert at["fingers_hit"][0] == 0.0 and at["fingers_hit"][1] > 1.0
    assert at["finger_top"][1] == pytest.approx(0.034, abs=0.004)  # the object's top over the fingers' tips


def test_features_are_the_same_with_an_axis_reversed():
    rng = np.random.default_rng(0)
    points, normals = SCENE.points + 0.002 * rng.standard_normal(SCENE.points.shape), SCENE.normals
    tilted = transform(so3_exp([0.2, 0.3, 0.4]) @ DOWN, np.array([0.004, 0.01, 0.006]))
    e = rng.uniform(-0.02, 0.02, (20, 3))
    scene = SCENE._replace(points=points)
    found = grasp_features(scene, tilted, 0.04, 0.08, 0.5, e, True)
    turned = tilted.copy()
    turned[:3, :3] = tilted[:3, :3] @ np.diag([-1.0, -1.0, 1.0])
    np.testing.assert_allclose(
        grasp_features(scene._replace(normals=normals), turned, 0.04, 0.08, 0.5, e * (-1.0, -1.0, 1.0), True),
        found, atol=1e-9,
    )  # fmt: skip


def test_an_aimed_grasp_is_aside_by_the_aim_and_the_arm_does_it_in_the_same_posture():
    aim = np.array([0.004, -0.012, 0.02])
    moved = shifted(GRASP_ON_BAR, aim)
    T = np.linalg.inv(GRASP_ON_BAR.T_object_grasp) @ moved.T_object_grasp
    np.testing.assert_allclose(T, transform(np.eye(3), aim), atol=1e-12)
    before, after = (grasp.T_level_object @ grasp.T_object_grasp for grasp in (GRASP_ON_BAR, moved))
    np.testing.assert_allclose(after, before, atol=1e-12)


LENGTHS = np.array([0.0, 0.02, 0.03])


class Known(Outcomes):
    """Holds exactly where the tool is within 12 mm of the grasp, across it and along it."""

    def __init__(self) -> None:
        pass

    def __call__(self, features):
        aside, deeper = features[:, NAMES.index("aside_y")], features[:, NAMES.index("deeper")]
        held = (aside < 0.012) & (np.abs(deeper) < 0.012)
        chances = np.zeros((len(features), len(OUTCOMES)))
        chances[:, HELD], chances[:, EMPTY] = held, ~held
        return chances


class OneGrasp:
    """A planner that always finds the same."""

    def plan(self, scene, friction):
        del scene, friction
        return type("Plan", (), {"grasps": (GRASP_ON_BAR,)})()


def test_attempts_that_fail_tell_where_the_error_is():
    planner = AimPlanner(OneGrasp(), Known(), LENGTHS)
    even = planner.belief(())
    np.testing.assert_allclose(even, even[0])
    missed = Attempt(SCENE, GRASP_ON_BAR, np.zeros(3), Phase.CLOSE, 0.0)
    belief = planner.belief((missed,))
    errors = planner.particles @ DOWN
    inside = (np.abs(errors[:, 1]) < 0.012) & (np.abs(errors[:, 2]) < 0.012)
    assert belief.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(belief[inside] / belief[~inside].max(), 0.02 / 1.02, rtol=1e-9)
    lengths = np.linalg.norm(planner.particles, axis=1)
    np.testing.assert_allclose(np.quantile(lengths, (0.0, 0.5, 1.0)), LENGTHS, atol=2e-3)


def test_the_next_aim_is_where_it_has_not_been_tried():
    planner = AimPlanner(OneGrasp(), Known(), LENGTHS)
    first = planner(SCENE, ())
    assert first is not None
    missed = Attempt(SCENE, first.hands[0], np.zeros(3), Phase.CLOSE, 0.0)
    second = planner(SCENE, (missed,))
    assert second is not None
    between = np.linalg.inv(first.hands[0].T_object_grasp) @ second.hands[0].T_object_grasp
    assert np.linalg.norm(between[1:3, 3]) > 0.008
    values = [planner.best_aim(SCENE, GRASP_ON_BAR, planner.belief(tried))[1] for tried in ((), (missed,))]
    assert 0.0 < values[1] < values[0] < 1.0


def test_what_stays_is_worth_something_and_what_falls_is_not():
    class Risky(Known):
        def __call__(self, features):
            chances = super().__call__(features)
            chances[:, GONE], chances[:, EMPTY] = chances[:, EMPTY], 0.0
            return chances

    belief = AimPlanner(OneGrasp(), Known(), LENGTHS).belief(())
    kind, risky = (
        AimPlanner(OneGrasp(), outcomes, LENGTHS).best_aim(SCENE, GRASP_ON_BAR, belief, 0.5)[1]
        for outcomes in (Known(), Risky())
    )
    assert kind == pytest.approx(risky + 0.5 * (1.0 - risky))


def test_outcomes_are_probabilities_of_the_network_on_file():
    rng = np.random.default_rng(0)
    tensors = {name: rng.standard_normal(shape).astype(np.float32) for name, shape in aim_shapes(3, [8, 4]).items()}
    tensors["input.scale"] = np.abs(tensors["input.scale"]) + 0.5
    x = rng.standard_normal((5, len(NAMES)))
    found = Outcomes(tensors)(x)
    expected = np.zeros((5, len(OUTCOMES)))
    for m in range(3):
        h = np.clip((x - tensors["input.mean"]) / tensors["input.scale"], -5, 5)
        for k in range(2):
            h = np.maximum(h @ tensors[f"layer.{k}.weight"][m] + tensors[f"layer.{k}.bias"][m], 0.0)
        h = np.exp(h @ tensors["layer.2.weight"][m] + tensors["layer.2.bias"][m])
        expected += h / h.sum(axis=1, keepdims=True) / 3.0
    np.testing.assert_allclose(found, expected, rtol=1e-4)
    np.testing.assert_allclose(found.sum(axis=1), 1.0, rtol=1e-5)


# --- flights, the fit, the file ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def flights(tmp_path_factory):
    """A block of two flights with training objects, and one with validation objects, that training finds."""
    folder, before = tmp_path_factory.mktemp("flights"), aim_dataset.BLOCK
    aim_dataset.BLOCK = 2
    try:
        data = collect(folder, "train", "combined", 3_000_000, 2)
        collect(folder, "validation", "combined", 2_000_000, 2)
        yield folder, data
    finally:
        aim_dataset.BLOCK = before


def test_flights_are_recorded_and_read_back(flights):
    folder, data = flights
    count = len(data.outcome)
    assert count >= 1 and set(data.episode) <= {3_000_000, 3_000_001}
    for name, shape in (("cloud", (256, 6)), ("T_level_object", (4, 4)), ("moved", (3,)), ("bias", (3,))):
        assert getattr(data, name).shape == (count, *shape)
    lengths = np.linalg.norm(data.bias, axis=1)
    assert ((lengths >= 0.015) & (lengths <= 0.030)).all()
    path = next(folder.glob("train-*.npz"))
    again = read_block(path)
    assert again is not None
    for name in Attempts._fields:
        np.testing.assert_array_equal(getattr(again, name), getattr(data, name))
    stamp = path.stat().st_mtime_ns
    np.testing.assert_array_equal(collect(folder, "train", "combined", 3_000_000, 2).outcome, data.outcome)
    assert path.stat().st_mtime_ns == stamp  # not flown again
    damaged = folder / "damaged.npz"
    damaged.write_bytes(path.read_bytes()[:1000])
    assert read_block(damaged) is None and read_block(folder / "none.npz") is None


def test_training_exports_a_policy_that_flies(flights, tmp_path):
    folder, data = flights
    config = AimConfig(episodes=2, validation_episodes=2, epochs=2, copies=2, members=2, hidden=(8,))
    path = tmp_path / "aim.safetensors"
    card = train_aim(config, tmp_path / "run", flights=folder, export=path, command=["aerograsp", "train"])
    assert card["env_id"] == GRASP and card["training"]["seed"] == 0 and card["algorithm"] == "aim"
    assert sum(card["training"]["attempts"].values()) == len(data.outcome)
    assert card["validation_score"] == min(row["validation_loss"] for row in card["training"]["epochs"])
    again = train_aim(config, tmp_path / "again", flights=folder)
    for name, tensor in load_checkpoint(path).tensors.items():
        np.testing.assert_array_equal(load_checkpoint(tmp_path / "again" / "best.safetensors").tensors[name], tensor)
    assert again["training"]["epochs"] == card["training"]["epochs"]
    policy = load_policy(GRASP, path)
    env = GraspEnv(level="combined", objects="validation")
    observation, _ = env.reset(seed=2_000_000)
    state = None
    for _ in range(40):
        action, state = policy.predict(observation, state)
        assert env.action_space.contains(action)
        observation, *_ = env.step(action)
    assert state[0].phase != Phase.LOOK


def test_training_by_command(flights, tmp_path, capsys):
    folder, _ = flights
    argv = ["--algorithm", "aim", "--flights", str(folder), "--out", str(tmp_path / "run"), "--epochs", "1"]
    argv += ["--episodes", "2", "--validation-episodes", "2", "--copies", "1", "--members", "1"]
    assert train_main([GRASP, *argv]) == 0
    assert "validation loss" in capsys.readouterr().out
    assert json.loads((tmp_path / "run" / "best.json").read_text())["training"]["command"][:2] == ["aerograsp", "train"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"level": "hard"}, "unknown level 'hard'"),
        ({"episodes": 0}, "episodes"),
        ({"episodes": 801}, "at most 800"),
        ({"members": 1.5}, "members"),
        ({"hidden": ()}, "hidden"),
        ({"learning_rate": float("nan")}, "learning_rate"),
    ],
)
def test_options_out_of_range_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        AimConfig(**changes)


def test_files_of_another_kind_or_shape_are_refused(tmp_path):
    good = {name: np.zeros(shape, np.float32) for name, shape in aim_shapes(1, [4]).items()}
    card = {
        "kind": "grasp-aim", "env_id": GRASP, "features": list(NAMES), "outcomes": list(OUTCOMES), "members": 1,
        "hidden": [4],
    }  # fmt: skip
    path = save_checkpoint(tmp_path / "a.safetensors", good, card)
    assert load_aim_policy(path) is not None
    for changes, tensors, message in (
        ({"features": ["x"]}, good, "features"),
        ({"hidden": "wide"}, good, "wired"),
        ({"members": 2}, good, "layer.0.weight"),
        ({"kind": "grasp-aimed"}, good, "grasp-aimed"),
        ({}, good | {"layer.1.bias": np.zeros((1, 2, 5), np.float32)}, "layer.1.bias"),
    ):
        save_checkpoint(path, tensors, card | changes)
        with pytest.raises(CheckpointError, match=message):
            load_aim_policy(path)


def test_guessing_is_as_good_as_the_shares_of_the_outcomes(flights):
    _, data = flights
    many = data.take(np.zeros(1000, dtype=np.int64))
    assert guess_loss(many, many) == pytest.approx(-np.log(1001 / 1005))


def test_shipped_policies_are_what_their_cards_say():
    shipped = {name: path for name, path in checkpoints(GRASP).items() if name.startswith("learned-seed")}
    assert len(shipped) >= 3 and all(path.parent == CHECKPOINTS for path in shipped.values())
    for name, path in shipped.items():
        card = load_checkpoint(path, GRASP).card
        assert json.loads(path.with_suffix(".json").read_text()) == card
        training = card["training"]
        assert training["seed"] == int(name.removeprefix("learned-seed")) and card["env_kwargs"]["objects"] == "train"
        assert card["validation_score"] < training["guess_loss"]  # it has learned something
        assert not any(part.startswith("/") for part in training["command"])
        assert hasattr(load_policy(GRASP, name), "predict")
