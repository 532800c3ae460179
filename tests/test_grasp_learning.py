"""Learning which grasps hold: labels are the judge's, trainings go on bit for bit, and what they write is read back."""

from __future__ import annotations

import json
import sys
import warnings
import zipfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import aerograsp_env  # noqa: F401  registers the ids
from aerograsp_env.envs.grasp_plan import decode_action, unpack_cloud
from aerograsp_env.interfaces import Grasp
from aerograsp_env.sim.gripper import GripperConfig, gripper_pose
from agents import cli, grasp_dataset, grasp_policy, grasp_training, load_policy
from agents.checkpoint import SCORER_KIND, CheckpointError, load_checkpoint, save_checkpoint
from agents.grasp_dataset import Labelled, collect, read_block, write_block
from agents.grasp_policy import LearnedPlan, layout_of, load_grasp_policy
from agents.grasp_training import BEST, LATEST, GraspTrainConfig, default_folder, standardisation, train_scorer
from agents.networks.grasp_fit import batch_of, fit
from agents.networks.grasp_scorer import GraspScorer, ScorerLayout
from agents.policies import PolicyUnavailable
from baselines.policies.grasp_plan import CONTEXT, planner

PLAN = "aerograsp/GraspPlan-v0"
FIRST_SEED = 3_000_000


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grasp_dataset, "BLOCK", 1)


def synthetic(views: int = 40, grasps: int = 4, points: int = 64, features: int = 3, seed: int = 0) -> Labelled:
    """Held where the first feature is positive, strictly where the second one is too; some grasps are missing."""
    rng = np.random.default_rng(seed)
    normals = rng.standard_normal((views, points, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    poses = np.tile(np.eye(4), (views, grasps, 1, 1))
    poses[..., :3, :3] = Rotation.random(views * grasps, rng=rng).as_matrix().reshape(views, grasps, 3, 3)
    poses[..., :3, 3] = rng.normal(0.0, 0.02, (views, grasps, 3))
    context = rng.normal(5.0, 3.0, (views, grasps, features))
    held = context[..., 0] > 5.0
    labels = np.stack([held, held & (context[..., 1] > 5.0)], axis=2)
    valid = rng.random((views, grasps)) < 0.9
    cloud = rng.normal(0.0, 0.03, (views, points, 3))
    parts: list[Any] = [np.asarray(part, np.float32) for part in (cloud, normals, poses, context, labels)]
    return Labelled._make([*parts, valid])


def training(folder: Path, config: GraspTrainConfig, resume: bool = False, export: Path | None = None) -> dict:
    folder.mkdir(exist_ok=True)
    return fit(config, synthetic(), synthetic(10, seed=1), folder, resume, export, False, ["test"])


# labels ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def labelled(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Labelled]:
    folder = tmp_path_factory.mktemp("labels")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(grasp_dataset, "BLOCK", 1)
        return folder, collect(folder, "train", FIRST_SEED, 3, 4)


def test_labels_are_the_judges_and_the_parts_are_of_one_view(labelled):
    _, data = labelled
    assert data.points.shape == (3, 512, 3) and data.poses.shape == (3, 4, 4, 4)
    assert data.context.shape == (3, 4, len(CONTEXT)) and data.labels.shape == (3, 4, 2) and data.valid.any()
    env: Any = gymnasium.make(PLAN, objects="train").unwrapped
    for row in range(3):
        cloud = unpack_cloud(env.reset(seed=FIRST_SEED + row)[0])
        np.testing.assert_allclose(data.points[row], cloud.points, atol=2e-4)  # half precision
        np.testing.assert_allclose(data.normals[row], cloud.normals, atol=1e-3)
        found = planner("gpis")(cloud, np.random.default_rng(FIRST_SEED + row))
        for k in np.flatnonzero(data.valid[row]):
            apart = np.abs(found.context.astype(np.float32) - data.context[row, k]).max(axis=1)
            index = int(apart.argmin())
            grasp = found.grasp(index)
            assert apart[index] == 0.0 and (k >= 2 or index == k)  # the best half comes first
            np.testing.assert_allclose(data.poses[row, k], gripper_pose(grasp), atol=1e-6)
            judgement = env.judge(grasp)
            np.testing.assert_array_equal(data.labels[row, k], [judgement.held, judgement.strict])
    missing = ~data.valid
    assert (data.labels[missing] == 0.0).all() and (data.context[missing] == 0.0).all()


def test_collecting_again_reads_what_is_there(labelled, monkeypatch):
    folder, data = labelled
    assert [path.name for path in sorted(folder.iterdir())] == [f"train-{FIRST_SEED}-{b:05d}-4.npz" for b in range(3)]
    monkeypatch.setattr(grasp_dataset, "label_block", lambda *job: pytest.fail("labelled again"))
    for again, expected in zip(collect(folder, "train", FIRST_SEED, 3, 4), data, strict=True):
        np.testing.assert_array_equal(again, expected)
    assert len(collect(folder, "train", FIRST_SEED, 2, 4).points) == 2


def test_only_a_damaged_block_is_labelled_again(labelled, monkeypatch):
    folder, data = labelled
    path = sorted(folder.iterdir())[1]
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    made = []

    def label(target: Path, *rest: Any) -> Path:
        made.append(target)
        target.write_bytes(whole)
        return target

    monkeypatch.setattr(grasp_dataset, "label_block", label)
    again = collect(folder, "train", FIRST_SEED, 3, 4)
    assert made == [path]
    np.testing.assert_array_equal(again.labels, data.labels)


def test_what_cannot_be_read_back_is_an_error_and_not_fewer_views(tmp_path, monkeypatch):
    monkeypatch.setattr(grasp_dataset, "label_block", lambda path, *rest: path)
    with pytest.raises(OSError, match="expected 2 blocks of labels, 2 cannot be read back"):
        collect(tmp_path, "train", 0, 2, 4)


def test_blocks_hold_plain_arrays_and_any_damage_is_noticed(tmp_path):
    path = tmp_path / "a.npz"
    block = synthetic(2)
    write_block(path, block)
    with np.load(path, allow_pickle=False) as data:
        assert not any(data[name].dtype.hasobject for name in data.files)
    back = read_block(path)
    assert back is not None
    for name in ("poses", "context", "labels", "valid"):
        np.testing.assert_array_equal(getattr(back, name), getattr(block, name))
    np.testing.assert_allclose(back.points, block.points, atol=1e-4)
    whole = path.read_bytes()
    for content in (b"", b"PK", b"something else", whole[:-30], whole[:100]):
        path.write_bytes(content)
        assert read_block(path) is None
    assert read_block(tmp_path / "none.npz") is None
    rng = np.random.default_rng(0)
    for place in rng.integers(0, len(whole), 150):  # a flipped byte: noticed, or of no consequence; never a crash
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :])
        read = read_block(path)
        assert read is None or all(np.array_equal(a, b) for a, b in zip(read, back, strict=True))


def test_blocks_of_another_version_and_pickles_are_not_read(tmp_path):
    path = tmp_path / "a.npz"
    parts = synthetic(1)._asdict()
    np.savez(path, version=grasp_dataset.VERSION + 1, **parts)
    assert read_block(path) is None
    np.savez(path, version=grasp_dataset.VERSION, **{**parts, "valid": np.array([object()])})
    assert read_block(path) is None
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("version.npy", b"")
    assert read_block(path) is None


def test_a_view_that_says_nothing_has_no_grasps(tmp_path, monkeypatch):
    monkeypatch.setattr("baselines.grasping.planning.usable", lambda points: False)
    data = collect(tmp_path, "validation", 2_000_000, 1, 4)
    assert not data.valid.any() and (data.labels == 0.0).all()
    with pytest.raises(ValueError, match="views: expected some that have labelled grasps"):
        fit(GraspTrainConfig(epochs=1), data, data, tmp_path, False, None, False, [])


def test_chosen_are_the_best_half_and_others_once_each():
    score = np.array([0.1, 0.9, 0.5, 0.7, 0.3, 0.2])
    rng = np.random.default_rng(0)
    for _ in range(10):
        chosen = grasp_dataset._chosen(score, 5, rng)
        assert chosen[:3].tolist() == [1, 3, 2] and len(set(chosen.tolist())) == 5
    assert grasp_dataset._chosen(score[:2], 5, rng).tolist() == [1, 0]
    assert len(grasp_dataset._chosen(score[:0], 5, rng)) == 0


@pytest.mark.parametrize("name", ["views", "grasps", "workers"])
def test_numbers_below_one_are_refused(tmp_path, name):
    numbers: Any = {"views": 1, "grasps": 1, "workers": 1, name: 0}
    with pytest.raises(ValueError, match=f"{name}: expected at least 1, got 0"):
        collect(tmp_path, "train", 0, **numbers)


# the network ----------------------------------------------------------------------------------------


def test_the_network_does_not_care_about_the_order_of_points():
    torch.manual_seed(0)
    network = GraspScorer(ScorerLayout(context=5)).eval()
    positions, normals, context = 0.05 * torch.randn(6, 80, 3), torch.randn(6, 80, 3), torch.randn(6, 5)
    order = torch.randperm(80)
    with torch.no_grad():
        logits = network(positions, normals, context)
        shuffled = network(positions[:, order], normals[:, order], context)
        other = network(positions, normals[:, order], context)
    assert logits.shape == (6, 2)
    torch.testing.assert_close(shuffled, logits, rtol=0.0, atol=1e-5)
    assert not torch.allclose(other, logits, atol=1e-4)  # points keep their normals


def test_points_come_in_the_grippers_frame_whatever_the_clouds():
    data, layout = synthetic(4, points=64), ScorerLayout(context=3, points=64)
    views, slots = np.nonzero(np.ones_like(data.valid))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.random(rng=np.random.default_rng(5)).as_matrix(), [0.1, -0.2, 0.05]
    turned = data._replace(
        points=(data.points @ T[:3, :3].T + T[:3, 3]).astype(np.float32),
        normals=(data.normals @ T[:3, :3].T).astype(np.float32),
        poses=(T @ data.poses).astype(np.float32),
    )
    here, there = (batch_of(part, views, slots, layout, None) for part in (data, turned))
    for a, b in zip(here, there, strict=True):
        torch.testing.assert_close(a, b, rtol=0.0, atol=1e-6)
    view, slot = views[5], slots[5]
    inverse = np.linalg.inv(data.poses[view, slot])
    expected = data.points[view] @ inverse[:3, :3].T + inverse[:3, 3]
    np.testing.assert_allclose(here[0][5].numpy(), expected, atol=1e-6)


def test_augmentation_swaps_the_fingers_of_about_half():
    data, layout = synthetic(50, points=1), ScorerLayout(context=3, points=1)
    views, slots = np.nonzero(np.ones_like(data.valid))
    plain = batch_of(data, views, slots, layout, None)
    mixed = batch_of(data, views, slots, layout, np.random.default_rng(0))
    swapped = (mixed[0][:, 0, 0] * plain[0][:, 0, 0] < 0.0).numpy()
    assert 0.35 < swapped.mean() < 0.65
    sign = torch.where(torch.from_numpy(swapped)[:, None, None], torch.tensor([-1.0, -1.0, 1.0]), torch.ones(3))
    for a, b in zip(mixed[:2], plain[:2], strict=True):
        torch.testing.assert_close(a, b * sign, rtol=0.0, atol=1e-7)


def test_standardisation_is_of_the_grasps_that_there_are():
    data = synthetic()
    data.context[~data.valid] = 1e6
    mean, scale = standardisation(data.context, data.valid)
    np.testing.assert_allclose(mean, data.context[data.valid].mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(scale, data.context[data.valid].std(axis=0), rtol=1e-5)
    assert (standardisation(np.ones((2, 3, 4)), np.ones((2, 3), bool))[1] > 0.0).all()


# training -------------------------------------------------------------------------------------------


def test_a_rule_is_learned_and_everything_is_on_disk(tmp_path):
    export = tmp_path / "given" / "scorer.safetensors"
    config = GraspTrainConfig(epochs=6, batch_size=16, learning_rate=5e-3)
    card = training(tmp_path / "run", config, export=export)
    losses = [row["loss"] for row in card["curve"]]
    held_out = [row["validation_loss"] for row in card["curve"]]
    assert losses[-1] < 0.6 * losses[0] and min(held_out) < 0.4
    assert card["validation_loss"] == min(held_out) and len(held_out) == 6
    best = load_checkpoint(tmp_path / "run" / BEST, PLAN)
    assert best.card["validation_loss"] == min(held_out) and best.card["kind"] == SCORER_KIND
    exported = load_checkpoint(export, PLAN)
    assert exported.card["curve"] == card["curve"]
    for name, value in best.tensors.items():
        np.testing.assert_array_equal(exported.tensors[name], value)
    latest = load_checkpoint(tmp_path / "run" / LATEST)
    assert latest.card["kind"] == f"{SCORER_KIND}-training"
    assert any(name.startswith("optimizer.") for name in latest.tensors)


def equal(a: Path, b: Path) -> None:
    one, two = load_checkpoint(a), load_checkpoint(b)
    assert one.tensors.keys() == two.tensors.keys() and one.card["curve"] == two.card["curve"]
    for name, value in one.tensors.items():
        np.testing.assert_array_equal(value, two.tensors[name], err_msg=name)


def test_a_resumed_training_is_the_uninterrupted_one_to_the_bit(tmp_path, monkeypatch):
    config = GraspTrainConfig(epochs=4, batch_size=32)
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    training(whole, config, export=tmp_path / "a.safetensors")
    from agents.networks import grasp_fit

    validate, epochs = grasp_fit.validate, []

    def interrupted(*args: Any) -> dict[str, float]:
        epochs.append(1)
        if len(epochs) == 3:
            raise KeyboardInterrupt
        return validate(*args)

    monkeypatch.setattr(grasp_fit, "validate", interrupted)
    with pytest.raises(KeyboardInterrupt):
        training(broken, config)
    monkeypatch.setattr(grasp_fit, "validate", validate)
    assert len(load_checkpoint(broken / LATEST).card["curve"]) == 2
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        training(broken, config, resume=True, export=tmp_path / "b.safetensors")
    for name in (LATEST, BEST):
        equal(whole / name, broken / name)
    equal(tmp_path / "a.safetensors", tmp_path / "b.safetensors")
    # Nothing left to do: what is asked for is still exported.
    card = training(broken, config, resume=True, export=tmp_path / "c.safetensors")
    equal(tmp_path / "a.safetensors", tmp_path / "c.safetensors")
    assert len(card["curve"]) == 4


@pytest.mark.parametrize("batch_size", [1000, 8])
def test_trainings_of_a_few_steps_are_trainings(tmp_path, batch_size):
    data = synthetic(20, 4)._replace(valid=np.ones((20, 4), dtype=bool))  # 1 or 10 steps an epoch
    config = GraspTrainConfig(epochs=2, batch_size=batch_size)
    card = fit(config, data, data, tmp_path, False, None, False, [])
    assert len(card["curve"]) == 2  # two steps in all, and the twenty at which a warm-up would last none


def test_what_is_no_such_training_cannot_be_resumed(tmp_path):
    config = GraspTrainConfig(epochs=2, batch_size=64)
    training(tmp_path, config)
    with pytest.raises(CheckpointError, match="same options, got another epochs, learning_rate"):
        training(tmp_path, GraspTrainConfig(epochs=3, batch_size=64, learning_rate=0.1), resume=True)
    latest = load_checkpoint(tmp_path / LATEST)
    save_checkpoint(tmp_path / LATEST, latest.tensors, {**latest.card, "env_id": "aerograsp/Dock-v0"})
    with pytest.raises(CheckpointError, match=r"it is for aerograsp/Dock-v0"):
        training(tmp_path, config, resume=True)
    best = load_checkpoint(tmp_path / BEST)
    save_checkpoint(tmp_path / LATEST, best.tensors, best.card)
    with pytest.raises(CheckpointError, match="expected a grasp-scorer-training, got 'grasp-scorer'"):
        training(tmp_path, config, resume=True)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("views", 0),
        ("views", 2.5),
        ("epochs", True),
        ("grasps", "6"),
        ("batch_size", -1),
        ("learning_rate", 0.0),
        ("learning_rate", float("nan")),
        ("weight_decay", -1e-3),
        ("seed", -1),
        ("seed", 2**32),
    ],
)
def test_options_out_of_range_are_refused_by_name(name, value):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        GraspTrainConfig(**{name: value})


# policies from networks -----------------------------------------------------------------------------


def random_scorer(path: Path, **changes: Any) -> Path:
    torch.manual_seed(1)
    layout = ScorerLayout(context=len(CONTEXT))
    network = GraspScorer(layout)
    card = {"env_id": PLAN, "kind": SCORER_KIND, "scorer": layout._asdict(), **changes}
    return save_checkpoint(path, network.state_dict(), card)


def test_a_saved_network_chooses_the_grasp_that_it_scores_best(tmp_path):
    path = random_scorer(tmp_path / "a.safetensors")
    torch.manual_seed(1)
    fresh = LearnedPlan(GraspScorer(ScorerLayout(context=len(CONTEXT))))
    policy: Any = load_grasp_policy(path)
    env = gymnasium.make(PLAN)
    observation, _ = env.reset(seed=2)
    cloud = unpack_cloud(observation)
    proposals = planner("gpis")(cloud, np.random.default_rng(0))
    score = policy.plan.score(cloud, proposals)
    np.testing.assert_array_equal(score, fresh.score(cloud, proposals))
    assert len(score) == min(len(proposals), grasp_policy.SCORED)
    assert (score > 0.0).all() and (score < 1.0).all() and np.ptp(score) > 0.0
    grasp = policy.plan(cloud, np.random.default_rng(0))
    assert isinstance(grasp, Grasp)
    np.testing.assert_array_equal(grasp.center, proposals.grasp(int(score.argmax())).center)
    action, state = load_policy(PLAN, path).predict(observation)
    assert state is None and env.action_space.contains(action)
    assert decode_action(action, GripperConfig()) is not None
    together, _ = policy.predict({key: np.stack([value, value]) for key, value in observation.items()})
    np.testing.assert_array_equal(together, [action, action])
    nothing = {**observation, "points": np.zeros_like(observation["points"])}
    np.testing.assert_array_equal(policy.predict(nothing)[0], np.zeros(10))


def test_networks_that_do_not_fit_are_refused(tmp_path):
    path = tmp_path / "a.safetensors"
    layout = ScorerLayout(context=len(CONTEXT))._asdict()
    for changes, why in (
        ({"kind": f"{SCORER_KIND}-training"}, "expected a grasp-scorer, got 'grasp-scorer-training'"),
        ({"env_id": "aerograsp/Dock-v0"}, "it is for aerograsp/Dock-v0"),
        ({"scorer": {**layout, "context": 3}}, "the weights do not fit the card"),
        ({"scorer": {**layout, "point_widths": [48, 96]}}, "the weights do not fit the card"),
        ({"scorer": {"context": 3}}, "the weights do not fit the card"),
        ({"scorer": None}, "the weights do not fit the card"),
    ):
        random_scorer(path, **changes)
        with pytest.raises(CheckpointError, match=why):
            load_grasp_policy(path)
    small = ScorerLayout(context=3)
    card = {"env_id": PLAN, "kind": SCORER_KIND, "scorer": small._asdict()}
    save_checkpoint(path, GraspScorer(small).state_dict(), card)
    with pytest.raises(CheckpointError, match=f"expected {len(CONTEXT)} context values as the planner has, got 3"):
        load_grasp_policy(path)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(CheckpointError, match="corrupt"):
        load_policy(PLAN, path)


def test_layouts_survive_their_card():
    layout = ScorerLayout(context=7, points=11, point_widths=(3, 4), head_widths=(5,), length=0.1)
    assert layout_of(json.loads(json.dumps(layout._asdict()))) == layout


def test_a_missing_extra_is_said(tmp_path, monkeypatch):
    path = random_scorer(tmp_path / "a.safetensors")
    monkeypatch.setitem(sys.modules, "agents.grasp_policy", None)
    with pytest.raises(PolicyUnavailable, match=r"aerograsp\[learn\]"):
        load_policy(PLAN, path)


# the command ----------------------------------------------------------------------------------------

TINY = ["--views", "2", "--validation-views", "1", "--grasps", "3", "--epochs", "2", "--batch-size", "2"]


def test_the_command_labels_trains_resumes_and_exports(tmp_path, labelled, capsys):
    out, export, report = tmp_path / "run", tmp_path / "x.safetensors", tmp_path / "r.json"
    arguments = ["train", PLAN, *TINY, "--out", str(out)]
    assert cli.main([*arguments, "--json", str(report)]) == 0
    assert len(list((out / "labels").glob("train-*.npz"))) == 2
    assert "validation loss" in capsys.readouterr().out
    data = json.loads(report.read_text())
    assert data["config"]["views"] == 2 and len(data["curve"]) == 2
    assert cli.main(arguments) == 2
    assert "already holds a run" in capsys.readouterr().err
    assert cli.main([*arguments, "--resume", "--export", str(export)]) == 0
    assert load_grasp_policy(export).predict(gymnasium.make(PLAN).reset(seed=0)[0])[0].shape == (10,)
    assert cli.main([*arguments, "--overwrite"]) == 0


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--views", "0"], "views: expected"),
        (["--views", "many"], "invalid int value"),
        (["--learning-rate", "nan"], "learning_rate: expected"),
        (["--residual", "gpis"], "unrecognized arguments"),
        (["--export", "x.npz"], "ends in .safetensors"),
        (["--workers", "0"], "workers: expected at least 1"),
    ],
)
def test_misuse_is_refused_in_one_line(arguments, why, tmp_path, capsys):
    status: Any
    try:
        status = cli.main(["train", PLAN, "--out", str(tmp_path), *arguments])
    except SystemExit as exit:
        status = exit.code
    error = capsys.readouterr().err
    assert status == 2 and why in error and error.count("\n") == 1


def test_the_runs_folder_and_interruptions(tmp_path, monkeypatch, capsys):
    assert default_folder(GraspTrainConfig(seed=3)) == Path("runs/GraspPlan-v0-learned-3")

    def interrupt(*args: Any) -> Labelled:
        raise KeyboardInterrupt

    monkeypatch.setattr(grasp_training, "collect", interrupt)
    assert cli.main(["train", PLAN, "--out", str(tmp_path)]) == 130
    assert "--resume goes on" in capsys.readouterr().err


def test_a_bad_export_is_refused_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setattr(grasp_training, "collect", lambda *args: pytest.fail("worked"))
    blocked = tmp_path / "file"
    blocked.touch()
    with pytest.raises(OSError, match="file"):
        train_scorer(GraspTrainConfig(), tmp_path / "run", export=blocked / "x.safetensors")
