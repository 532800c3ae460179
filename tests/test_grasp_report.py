"""The comparison of grasp planners: scoring, oracles, paired verdicts, objects, outcomes and calibration."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import toy_env
from PIL import Image
from scipy.stats import binomtest, norm

from agents import cli, grasp_plots, grasp_report, table
from agents.bench_setup import GRASP_PLAN, Measured, setup_of
from agents.evaluation import EvaluationResult
from agents.files import dumps
from agents.grasp_calibration import across, bin_of, curves, judge_candidates, reliability
from agents.play import play
from agents.report import html_report, paired, pairings
from agents.scoring import GRASPING, HOLDING, is_learned, scoring_of
from agents.statistics import mcnemar, wilson_interval
from agents.table import Row, best_row, table_data, table_text, with_pooled, without_trainings

OUTCOMES = ("dropped", "slipped away", "missed", "collision", "degenerate", "too wide")
PNG = b"\x89PNG"


def row(policy: str, held: list[int] | np.ndarray, oracle: bool = False, strict: Any = None) -> Row:
    """Rows whose failures go through the outcomes in turn."""
    held = np.asarray(held, dtype=bool)
    ends = np.array([OUTCOMES[k % len(OUTCOMES)] for k in range(held.size)])
    terminations = np.where(held, "held", ends)
    strict = held if strict is None else np.asarray(strict, dtype=bool)
    metrics = {
        "held": held.astype(float),
        "strict": strict.astype(float),
        "slip": np.where(held, 0.001 * (1 + np.arange(held.size)), np.nan),
        "turn": np.where(held, 0.1, np.nan),
        "survived": held.astype(float),
    }
    zeros = np.zeros(held.size)
    result = EvaluationResult(
        GRASP_PLAN, policy, 0, {}, held, held.astype(float), zeros.astype(np.int64) + 1, terminations, metrics
    )
    return Row.of(result, oracle=oracle)


def drawn(rate: float, episodes: int = 200, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random(episodes) < rate


GPIS, COM = row("gpis", drawn(0.9, seed=1)), row("com", drawn(0.6, seed=2))
ORACLE, LEARNED = row("oracle-mesh", np.ones(200), oracle=True), row("learned-seed0", drawn(0.97, seed=3))
ROWS = [COM, GPIS, LEARNED, ORACLE, Row("learned", note="no checkpoint")]


def test_the_kind_of_task_is_told_by_its_values() -> None:
    assert scoring_of(GPIS.values) is GRASPING
    assert scoring_of({"error", "success"}) is HOLDING
    assert scoring_of({"returns"}).primary is None


def test_outcomes_are_a_partition() -> None:
    shares = grasp_report.outcome_shares(COM)
    assert set(shares) == set(grasp_plots.OUTCOME_COLORS)
    assert sum(shares.values()) == pytest.approx(1.0)
    assert GPIS.values["no grasp"].sum() + GPIS.values["collision"].sum() > 0


def test_an_oracle_is_labelled_and_never_the_best() -> None:
    assert best_row(ROWS) is LEARNED  # the highest, the oracle aside
    assert GRASPING.reference(ROWS) is GPIS  # the best that is neither oracle nor learned
    assert best_row([ORACLE]) is None
    text = table_text(ROWS)
    assert "oracle-mesh (oracle)" in text and table.ORACLE_NOTE in text
    assert [r["oracle"] for r in table_data(ROWS)["rows"]] == [False, False, False, True, False]


def test_the_table_shows_shares_with_wilson_intervals_and_medians_of_the_held() -> None:
    few = row("p", [1, 1, 0, 1])
    held, strict, slip, turn, *_ = table.columns([few])
    low, high = wilson_interval(3, 4)
    assert table.cell(few, held) == f"75.0 [{100 * low:.1f}, {100 * high:.1f}]"
    assert table.cell(few, slip).startswith("2.0 [")  # the median of 1, 2, 4 mm; the third did not hold
    assert table.cell(few, turn).startswith("5.7 [")
    assert "(3)" not in table_text([few])
    assert table.cell(row("q", [0, 0]), slip) == "—"
    assert table.cell(row("q", [0, 0]), strict).startswith("0.0 [0.0, ")
    summary = table_data([few])["rows"][0]["summary"]
    assert summary["slip"]["median"] == pytest.approx(0.002) and summary["slip"]["given"] == "held"
    assert summary["held"]["mean"] == 0.75


def test_trainings_are_pooled_by_their_shares() -> None:
    rows = with_pooled([GPIS, row("learned-seed0", [1] * 200), row("learned-seed1", [1, 0] * 100)])
    assert rows[-1].policy == "learned (2 seeds)" and is_learned(rows[-1].policy) and not is_learned("gpis")
    assert rows[-1].values["held"].mean() == 0.75
    text = table_text(rows)
    assert "75.0 [" in text
    assert [r.policy for r in without_trainings(rows)] == ["gpis", "learned (2 seeds)"]
    tests = {pair.policy: pair.test for pair in pairings(rows) if pair.column.name == "held"}
    assert tests["learned-seed0"] is not None and tests["learned (2 seeds)"] is None  # shares are not 0 or 1


def test_wilson_interval_solves_its_equation() -> None:
    z = norm.ppf(0.975)
    for successes, trials in ((0, 7), (3, 10), (7, 7), (350, 375)):
        interval = wilson_interval(successes, trials)
        assert 0.0 <= interval.low <= successes / trials <= interval.high <= 1.0
        for bound in interval:  # |p̂ − p| = z √(p (1 − p) / n)
            if 0.0 < bound < 1.0:
                deviation = abs(successes / trials - bound)
                assert deviation == pytest.approx(z * np.sqrt(bound * (1.0 - bound) / trials), rel=1e-9)
    for bad in ((1, 0), (-1, 3), (4, 3)):
        with pytest.raises(ValueError, match="successes"):
            wilson_interval(*bad)
    with pytest.raises(ValueError, match="level"):
        wilson_interval(1, 2, 1.0)


def test_mcnemar_is_a_sign_test_of_the_discordant_pairs() -> None:
    a = np.array([1] * 9 + [0] * 2 + [1] * 5 + [0] * 4)
    b = np.array([0] * 9 + [1] * 2 + [1] * 5 + [0] * 4)
    assert mcnemar(a, b) == (9, 2, binomtest(9, 11, 0.5).pvalue)
    assert mcnemar(b, a).p == mcnemar(a, b).p
    by_hand = 2.0 * (1 + 11 + 55) / 2**11  # P(X ≤ 2) of 11 fair coins, twice
    assert mcnemar(a, b).p == pytest.approx(by_hand, rel=1e-12)
    assert mcnemar(a, a).p == 1.0
    with pytest.raises(ValueError, match="0 or 1"):
        mcnemar([0.5], [1.0])
    with pytest.raises(ValueError, match="shape"):
        mcnemar([1, 0], [1])


def test_every_row_is_paired_with_the_best_analytic_one() -> None:
    found = {(pair.policy, pair.column.name): pair for pair in pairings(ROWS)}
    assert {policy for policy, _ in found} == {"com", "learned-seed0", "oracle-mesh"}
    worse, better = found["com", "held"], found["oracle-mesh", "strict"]
    assert worse.verdict == "worse" and worse.difference < 0.0 and worse.reference == "gpis"
    assert better.verdict == "better" and better.test is not None and better.test.only_b == 0
    same = [GPIS, row("cloud", np.roll(GPIS.values["held"], 1))]
    assert {pair.verdict for pair in pairings(same)} == {"not resolved"}
    text = "".join(paired(ROWS))
    assert "Paired with gpis" in text and "McNemar p" in text and "&lt; 0.0001" in text
    restored = json.loads(dumps([pair.to_dict() for pair in pairings(ROWS)]))
    assert restored[0]["column"] == "held" and restored[0]["test"]["p"] == worse.test.p  # type: ignore[union-attr]


def test_holding_rows_are_paired_the_other_way_round() -> None:
    low, high = (Row(name, {"error": e + 0.001 * drawn(0.5)}) for name, e in (("a", 0.01), ("b", 0.02)))
    (pair,) = pairings([low, high])
    assert (pair.policy, pair.verdict, pair.test) == ("b", "worse", None)


def test_the_lead_names_the_best_row() -> None:
    page = html_report(title="t", rows=ROWS, provenance={}, sections=["<h2>More</h2>"])
    share = 100.0 * LEARNED.values["held"].mean()
    assert "<strong>learned-seed0</strong> holds the most" in page and f"<strong>{share:.1f} %</strong>" in page
    assert "<h2>More</h2>" in page and page.count('<tr class="oracle">') == 1
    assert "2 policies." in html_report(title="t", rows=[ORACLE, row("zero", [0, 0], oracle=True)], provenance={})


class World:
    """An unwrapped environment of two objects in turn whose judge holds a grasp with probability `truth(pfc)`."""

    def __init__(self, truth: Any = None) -> None:
        self.truth = truth

    def reset(self, *, seed: int) -> tuple[dict[str, Any], dict[str, Any]]:
        tags = (frozenset({"concave", "elongated"}), frozenset[str]())[seed % 2]
        self.object = SimpleNamespace(
            name=("mug", "ball")[seed % 2], tags=tags, center_of_mass=np.array([0.0, 0.0, 1.0])
        )
        self.T_cloud_object = np.diag([1.0, -1.0, -1.0, 1.0])
        self.rng = np.random.default_rng(seed)
        return {"x": np.zeros(1, np.float32)}, {}

    def judge(self, grasp: Any) -> SimpleNamespace:
        held = bool(self.rng.random() < self.truth(grasp.pfc))
        return SimpleNamespace(held=held, strict=False, outcome="held" if held else "collision")


def test_shares_by_object_and_group() -> None:
    episodes = grasp_report.episode_objects(World(), range(4))
    assert episodes.objects == ["mug", "ball", "mug", "ball"]
    rates = grasp_report.object_rates([row("p", [1, 1, 0, 1])], episodes)
    assert rates["mug"]["p"] == 0.5 and rates["ball"]["p"] == 1.0
    assert rates["concave"]["p"] == rates["elongated"]["p"] == 0.5 and rates["all"]["p"] == 0.75
    assert "off-balance" not in rates
    html = "".join(grasp_report.objects_section([row("p", [1, 1, 0, 1])], episodes))
    assert html.count("color-mix") == 5 and "concave, elongated" in html and html.count("<tr") == 6


def test_groups_weigh_their_objects_equally() -> None:
    episodes = grasp_report.Episodes(["a", "a", "a", "b"], {"a": frozenset(), "b": frozenset()})
    assert grasp_report.object_rates([row("p", [1, 1, 1, 0])], episodes)["all"]["p"] == 0.5


def test_planning_time_is_processor_time_of_predict() -> None:
    calls: list[int] = []

    class Planner:
        def predict(self, observation: Any, **_: Any) -> tuple[np.ndarray, None]:
            assert observation["x"].shape == (1, 1)
            calls.append(1)
            sum(range(50_000))
            return np.zeros((1, 10)), None

    times = grasp_report.planning_times(World(), {"p": Planner()}, range(4))
    assert len(calls) == 4 + grasp_report.WARM_UP and times["p"].views == 4
    assert 0.0 < times["p"].median <= times["p"].p95 < 1.0
    assert "95th" in "".join(grasp_report.times_section(times)) and grasp_report.times_section({}) == []


def test_calibrated_predictions_are_found_calibrated() -> None:
    rng = np.random.default_rng(0)
    p = rng.random(20_000)
    right = reliability(p, rng.random(p.size) < p)
    assert len(right.bins) == 10 and sum(of.samples for of in right.bins) == p.size
    inside = [of.interval.low <= of.predicted <= of.interval.high for of in right.bins]
    assert sum(inside) >= 8
    assert right.brier == pytest.approx(1 / 6, abs=0.005)  # E p (1 − p) of uniform p
    assert right.calibration_error < 0.02 and right.brier_base == pytest.approx(0.25, abs=0.001)
    wrong = reliability(p, rng.random(p.size) < 0.5 * p)  # overconfident by a factor of two
    assert wrong.calibration_error == pytest.approx(0.25, abs=0.02)
    assert all(of.observed == pytest.approx(0.5 * of.predicted, abs=0.05) for of in wrong.bins)


def test_reliability_edges_and_errors() -> None:
    perfect = reliability([0.0, 1.0, 1.0], [0, 1, 1])
    assert perfect.brier == perfect.calibration_error == 0.0
    assert [(of.low, of.high, of.samples) for of in perfect.bins] == [(0.0, 0.1, 1), (0.9, 1.0, 2)]
    assert json.loads(dumps(perfect.to_dict()))["bins"][1]["observed"] == 1.0
    bad: list[tuple[Any, Any, int]] = [
        ([], [], 3), ([0.5], [0.5], 3), ([1.5], [1], 3), ([np.nan], [1], 3), ([0.5], [1, 0], 3), ([0.5], [1], 0),
    ]  # fmt: skip
    for predicted, outcome, bins in bad:
        with pytest.raises(ValueError):
            reliability(predicted, outcome, bins)


def test_candidates_are_drawn_across_the_range() -> None:
    p = np.array([0.99] * 50 + [0.5] * 50 + [0.01] * 50)
    chosen = across(p, 6, np.random.default_rng(0))
    assert np.bincount(bin_of(p[chosen], 10))[[0, 5, 9]].tolist() == [2, 2, 2] and len(set(chosen)) == 6
    assert sorted(across(p[:3], 6, np.random.default_rng(0))) == [0, 1, 2]
    assert across(np.empty(0), 6, np.random.default_rng(0)).size == 0


def test_candidates_are_judged_and_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("aerograsp_env.envs.grasp_plan.unpack_cloud", lambda observation: observation)

    along = np.array([0.0, 1.0, 0.0])

    def propose(cloud: Any, rng: np.random.Generator) -> SimpleNamespace:  # half of the lines are 30 mm too low
        pfc, low = rng.random(40), 0.03 * rng.integers(0, 2, 40)
        return SimpleNamespace(
            pfc=pfc,
            grasp=lambda i: SimpleNamespace(pfc=pfc[i], center=np.array([0.0, 5.0, -1.0 - low[i]]), closing_axis=along),
        )

    judged = judge_candidates(World(lambda pfc: pfc), range(100), propose, 8)
    assert judged.pfc.size == 800 and len(set(judged.view)) == 100
    found = curves(judged)
    assert found["held"].calibration_error < 0.08
    assert set(np.round(judged.offset, 9)) == {0.0, 0.03}
    near = found["held, closed near the centre of mass"]
    assert near.base_rate == 1.0 and near.samples == np.sum(judged.held[judged.offset < 0.02])  # the others collided
    assert grasp_plots.reliability_diagram(found, dark=True)[:4] == PNG
    html = "".join(grasp_report.calibration_section(found, 100))
    assert "Brier" in html and "800 candidates" in html and grasp_report.calibration_section({}, 0) == []
    nothing = judge_candidates(World(), range(2), lambda *_: SimpleNamespace(pfc=np.empty(0)), 8)
    assert curves(nothing) == {}


def test_figures_are_pictures() -> None:
    rows = [r for r in ROWS if r.values]
    assert grasp_plots.rates(rows, GRASPING.paired, dark=False)[:4] == PNG
    assert grasp_plots.outcome_bars({r.label: grasp_report.outcome_shares(r) for r in rows}, dark=False)[:4] == PNG


def test_the_environment_is_given_by_name_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setattr("baselines.policies.POLICIES", toy_env.POLICIES)
    out = str(tmp_path / "out")
    assert cli.main(["bench", "--env", toy_env.TOY, "--policy", "p", "--episodes", "2", "--out", out]) == 0
    assert json.loads((tmp_path / "out" / "results.json").read_text())["settings"]["environment"] == toy_env.TOY
    assert cli.main(["bench", toy_env.TOY, "--env", GRASP_PLAN]) == 2
    assert "given twice" in capsys.readouterr().err


def test_a_single_step_is_filmed_as_it_was_judged(tmp_path: Path) -> None:
    small = {"width": 64, "height": 48}
    options: dict[str, Any] = {"seconds": 0.5, "fps": 10.0, "env_kwargs": small}
    for policy, frames in (("random", 1 + 5), ("zero", 1 + 1)):  # the view and its judgement; zeros are not tried
        film = tmp_path / f"{policy}.gif"
        (ending,) = play(GRASP_PLAN, policy, film, **options)
        assert ending.outcome in OUTCOMES
        with Image.open(film) as gif:
            assert gif.size == (64, 48) and gif.n_frames == frames  # type: ignore[attr-defined]


def test_the_study_of_a_short_run() -> None:
    rows = [row("random", [0, 0, 0])]
    setup = setup_of(GRASP_PLAN)
    assert setup.options == {"objects": "test"} and setup.episodes == 375

    class Still:
        def predict(self, observation: Any, **_: Any) -> tuple[np.ndarray, None]:
            return np.zeros((1, 10), np.float32), None

    measured = Measured(GRASP_PLAN, dict(setup.options), 0, 3, rows, {"random": Still()}, quick=True, progress=False)
    found = grasp_report.study(measured)
    assert len(found.data["objects"]) == 3 and found.data["calibration"] == {}
    assert found.data["planning_time"]["random"]["views"] == 3
    json.loads(dumps(found.data))
