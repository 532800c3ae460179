"""The judge's own check: grasps that must hold and grasps that must not."""

import numpy as np

from aerograsp_env.sim.objects import test_objects as named_objects
from agents.grasp_judge_gate import pairs_through, run, trials
from agents.reproduction import Request
from baselines.grasping.antipodal import closing_angles

OBJECTS = {item.name: item for item in named_objects()}


def test_good_grasps_of_a_can_hold_and_wrong_ones_mostly_do_not():
    tried, held, strict = trials(OBJECTS["can"], True, 8, np.random.default_rng(0))
    assert (tried, held, strict) == (8, 8, 8)
    tried, held, _ = trials(OBJECTS["can"], False, 12, np.random.default_rng(0))
    assert tried == 12 and held <= 3


def test_pairs_lie_on_the_object_and_fit_the_jaws():
    pairs = pairs_through(OBJECTS["bottle"], "oblique", np.random.default_rng(1))
    width = np.linalg.norm(pairs.positions[:, 1] - pairs.positions[:, 0], axis=1)
    assert len(width) > 100 and width.max() < 0.1 and width.min() > 0.0
    assert (closing_angles(pairs.positions, pairs.normals) <= np.pi).all()


def test_every_object_is_in_the_table_and_the_sums_agree():
    result = run(Request(), count=1)
    assert all(name in result.text for name in OBJECTS)
    for kind in ("good", "wrong"):
        rows = [np.array(row[kind]) for name, row in result.data.items() if name != "all"]
        np.testing.assert_array_equal(np.sum(rows, axis=0), result.data["all"][kind])
