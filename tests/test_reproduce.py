"""Reproductions: their figures on answers known, the command line, a tiny run of each."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerograsp_env.sim.docking_tool import DockingToolConfig
from agents import cli, table_5_3
from agents.figure_5_15 import run as workspace
from agents.firefly_motion import Flight, airborne, calmest, data_folder, read_flight, simulate, statistics
from agents.published import TABLE_5_3
from agents.reproduce import TABLES, reproduce
from agents.reproduction import Request, text_table
from agents.seeds import TEST_SEED
from agents.step_response import STEP, respond, step_metrics
from baselines.kinematics import DockingTool

NANS = ",".join(["nan"] * 17) + "\n"
PNG = b"\x89PNG\r\n\x1a\n"


# step response ------------------------------------------------------------------------------------


def test_metrics_of_a_first_order_step():
    time = np.linspace(0.0, 10.0, 20001)
    m = step_metrics(time, 0.5 * (1.0 - np.exp(-time / 0.7)), 0.5)
    assert m.rise_time == pytest.approx(0.7 * np.log(9.0), rel=1e-4)
    assert m.settling_time == pytest.approx(0.7 * np.log(20.0), abs=1e-3)
    assert m.overshoot == 0.0
    assert m.final_error == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("target", [0.5, -2.0])
def test_metrics_of_a_second_order_step(target):
    zeta, omega = 0.5, 3.0
    damped = omega * np.sqrt(1 - zeta**2)
    time = np.linspace(0.0, 15.0, 30001)
    phase = np.arccos(zeta)
    y = 1.0 - np.exp(-zeta * omega * time) / np.sqrt(1 - zeta**2) * np.sin(damped * time + phase)
    m = step_metrics(time, target * y, target)
    assert m.overshoot == pytest.approx(np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2)), rel=1e-4)
    assert m.peak_time == pytest.approx(np.pi / damped, abs=1e-3)
    assert np.all(np.abs(y[time > m.settling_time] - 1.0) <= 0.05)
    assert np.abs(np.interp(m.settling_time - 2e-3, time, y) - 1.0) >= 0.05


def test_a_response_that_never_arrives_has_no_figures():
    time = np.linspace(0.0, 1.0, 11)
    m = step_metrics(time, np.zeros(11), 1.0)
    assert np.isnan(m.rise_time) and np.isnan(m.settling_time)
    assert (m.overshoot, m.final_error) == (0.0, -1.0)
    for bad in ((time, np.zeros(3), 1.0), (time, np.zeros(11), 0.0), (time[:1], np.zeros(1), 1.0)):
        with pytest.raises(ValueError, match=r"response|target"):
            step_metrics(*bad)


@pytest.mark.parametrize("airframe", ["belerofonte", "firefly"])
def test_velocity_steps_of_both_airframes(airframe):
    for axis in range(3):
        time, velocity = respond(airframe, axis, seed=0, duration=12.0)
        m = step_metrics(time, velocity[:, axis], STEP)
        assert 0.1 < m.rise_time < 1.5
        assert 0.0 < m.overshoot < 0.15  # PX4's default gains overshoot by some 9 %
        assert m.settling_time < 8.0
        assert abs(m.final_error) < 0.02


# Table 5.3 ----------------------------------------------------------------------------------------


def test_table_5_3_holds_what_evaluation_gives(monkeypatch):
    from agents.evaluation import evaluate

    def short(env_id, policy, episodes, seed, options, progress=False):
        return evaluate(env_id, policy, episodes, seed, {**options, "max_episode_steps": 300})

    monkeypatch.setattr(table_5_3, "evaluate", short)
    result = table_5_3.run(Request(seed=7, episodes=2))
    assert len(result.data["figures"]) == 18
    assert {(f["source"], f["axis"], f["statistic"]) for f in result.data["figures"]} == {
        (source, axis, statistic) for source in TABLE_5_3 for axis in "xyz" for statistic in "μσ"
    }
    direct = evaluate("aerograsp/Dock-v0", "pid", 2, 7, table_5_3.conditions("gps") | {"max_episode_steps": 300})
    for figure in result.data["figures"]:
        row = TABLE_5_3[figure["source"]]["μσ".index(figure["statistic"])]
        assert figure["published"] == row["xyz".index(figure["axis"])]
        assert figure["ratio"] == figure["measured"] / figure["published"]
        assert figure["within"] == (0.75 <= figure["ratio"] <= 1.25)
        if figure["source"] == "gps":
            metric = {"μ": "error", "σ": "std"}[figure["statistic"]]
            assert figure["measured"] == direct.mean(f"{metric}_{figure['axis']}")
    within = sum(f["within"] for f in result.data["figures"])
    assert f"{within} of 18 figures within 25 %" in result.text
    assert result.text.count("✓") == within and result.text.count("✗") == 18 - within
    assert "calibrated to this table, on other seeds" in result.text


def test_conditions_are_those_of_the_thesis():
    assert table_5_3.conditions("gps")["docked"] is False
    assert table_5_3.conditions("vision")["docked"] is False
    assert table_5_3.conditions("dock")["docked"] is True
    assert {table_5_3.conditions(source)["wind"] for source in TABLE_5_3} == {"light"}
    assert table_5_3.EPISODES == 20


def test_calibration_and_test_seeds_never_meet():
    from agents.calibrate import SEED
    from agents.seeds import TEST_SEEDS

    assert SEED not in TEST_SEEDS and TEST_SEED in TEST_SEEDS


# figure 5.15 --------------------------------------------------------------------------------------


def test_the_workspace_map_is_the_tools():
    result = workspace(Request(picture=True), resolution=0.03)
    config = DockingToolConfig()
    tool = DockingTool(joint_centers=config.centers, lengths=config.lengths)
    grid = tool.workspace(0.03)
    assert result.data["best_quality"] == grid.quality.max()
    assert result.data["reachable_volume"] == pytest.approx((grid.quality > 0).sum() * 0.03**3)
    assert 0.0 < result.data["docked_quality"] <= 1.0
    assert result.picture is not None and result.picture.startswith(PNG)
    assert workspace(Request(), resolution=0.05).picture is None


# a real flight ------------------------------------------------------------------------------------


def circling(seconds: float = 20.0, rate: float = 50.0) -> Flight:
    """Radius 2 m at 0.5 rad/s, climbing at 0.3 m/s, the nose along the way."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    angle = 0.5 * t
    velocity = np.stack([-np.sin(angle), np.cos(angle), np.full_like(t, 0.3)], axis=1)
    position = np.stack([2 * np.cos(angle), 2 * np.sin(angle), 0.3 * t], axis=1)
    return Flight(
        t, position, Rotation.from_rotvec(angle[:, None] * [0.0, 0.0, 1.0]).as_quat(scalar_first=True), velocity
    )


def test_motion_statistics_of_a_circle():
    flight = circling()
    s = statistics(flight)
    expected = (1.0, 0.3, 0.5, 0.0, 0.0, 0.5)  # v = ωr, a = ω²r
    np.testing.assert_allclose(s, expected, atol=1e-4)
    mounted = Rotation.from_quat(flight.attitude, scalar_first=True) * Rotation.from_euler("xyz", [0.3, 1.2, -2.0])
    turned = flight._replace(attitude=mounted.as_quat(scalar_first=True))
    np.testing.assert_allclose(statistics(turned), expected, atol=1e-4)  # whatever the sensor's mounting


def test_airborne_and_calmest_parts():
    flight = circling(40.0)
    slow = np.where((flight.time > 12.0) & (flight.time < 24.0), 0.2, 1.0)[:, None]
    still = np.where((flight.time < 3.0) | (flight.time > 36.0), 0.0, 1.0)[:, None]
    flight = flight._replace(velocity=flight.velocity * slow * still)
    flying = airborne(flight)
    assert flying.time[0] == 0.0 and flying.time[-1] == pytest.approx(33.0, abs=0.05)
    part = calmest(flying)
    assert flying.time[part.start] >= 9.0 and flying.time[part.stop - 1] <= 21.0
    assert calmest(flight, 100.0) == slice(0, len(flight.time))
    with pytest.raises(ValueError, match="nothing in it moves"):
        airborne(flight._replace(velocity=np.zeros_like(flight.velocity)))


def write_recording(path: Path, flight: Flight) -> None:
    rows = [
        ",".join([str(int(1.4e18 + 1e9 * t)), *(repr(float(x)) for x in (*p, *q, *v)), *["0.0"] * 6])
        for t, p, q, v in zip(*flight, strict=True)
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("#time(ns),px,py,pz,qw,qx,qy,qz,vx,vy,vz,bwx,bwy,bwz,bax,bay,baz\n" + "\n".join(rows) + "\n")


def test_recordings_are_read_back(tmp_path):
    flight = circling(2.0)
    write_recording(tmp_path / "flight.csv", flight)
    for read, written in zip(read_flight(tmp_path / "flight.csv"), flight, strict=True):
        np.testing.assert_allclose(read, written, atol=1e-6)


@pytest.mark.parametrize(
    "content", ["", "#only,a,header\n", "1,2,3\n4,5,6\n", "hello\nworld\n", "#t\n" + ",".join(["nan"] * 17) + "\n"]
)
def test_foreign_files_are_refused(tmp_path, content):
    path = tmp_path / "flight.csv"
    path.write_text(content)
    with pytest.raises(ValueError, match=r"flight\.csv"):
        read_flight(path)


def test_the_simulated_firefly_follows_recorded_velocities():
    flight = circling(12.0, rate=20.0)
    gentle = flight._replace(velocity=0.4 * flight.velocity)
    flown = simulate(gentle.time, gentle.velocity, seed=0)
    late = flown.time > 4.0
    assert np.sqrt(np.mean((flown.velocity - gentle.velocity)[late] ** 2)) < 0.15
    np.testing.assert_allclose(np.linalg.norm(flown.attitude, axis=1), 1.0)


def test_firefly_motion_on_a_recording(tmp_path, monkeypatch, capsys):
    write_recording(tmp_path / "drone_euroc_gt" / "V1_01_easy.csv", circling(15.0, rate=20.0))
    monkeypatch.setenv("AEROGRASP_DATA", str(tmp_path))
    assert data_folder() == tmp_path
    assert cli.main(["reproduce", "firefly-motion", "--json", str(tmp_path / "out.json")]) == 0
    written = json.loads((tmp_path / "out.json").read_text())
    assert written["statistics"]["flight"]["real"]["speed"] == pytest.approx(1.0, abs=1e-3)
    assert written["statistics"]["flight"]["simulated"]["speed"] == pytest.approx(1.0, abs=0.15)
    assert "calmest" in capsys.readouterr().out


# the command --------------------------------------------------------------------------------------


def test_absent_data_is_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("AEROGRASP_DATA", str(tmp_path))
    assert cli.main(["reproduce", "firefly-motion"]) in (1, 2)
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "AEROGRASP_DATA" in error and "Traceback" not in error


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["table-5.4"], "table-5.3"),
        (["table-5.3", "--episodes", "0"], "at least 1"),
        (["table-5.3", "--seed", "-1"], "at least 0"),
        (["table-5.3", "--out", "a.png"], "no picture"),
        (["step-response", "--episodes", "3"], "does not count episodes"),
        (["figure-5.15", "--out", "a.jpg"], ".png"),
        (["figure-5.15", "--out", "no/such/folder/a.png"], "no such folder"),
        (["figure-5.15", "--json", "no/such/folder/a.json"], "no such folder"),
        ([], "TABLE"),
    ],
)
def test_misuse_is_one_line_and_status_two(arguments, words, capsys):
    assert cli.main(["reproduce", *arguments]) == 2
    captured = capsys.readouterr()
    assert words in captured.err and captured.err.count("\n") == 1 and captured.out == ""


def test_step_response_writes_text_json_and_picture(tmp_path, capsys):
    picture, record = tmp_path / "a.png", tmp_path / "a.json"
    assert cli.main(["reproduce", "step-response", "--out", str(picture), "--json", str(record)]) == 0
    out = capsys.readouterr().out
    assert "overshoot" in out and "firefly" in out
    assert picture.read_bytes().startswith(PNG)
    data = json.loads(record.read_text())
    assert data["table"] == "step-response" and "commit" in data["provenance"]
    assert data["responses"]["belerofonte"]["z"]["rise_time"] > 0.0


def test_help_names_every_table(capsys):
    assert cli.main(["reproduce", "--help"]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in TABLES)
    with pytest.raises(ValueError, match=r"did you mean 'table-5\.3'"):
        reproduce("tabel-5.3")


def test_text_tables_align():
    lines = text_table([["a", "b", "c"], ["long", "x", "1"], ["s", "yy", "22"]]).splitlines()
    assert lines[0] == "a     b    c" and lines[2] == "long  x    1" and lines[3] == "s     yy  22"
    assert set(lines[1]) == set(lines[-1]) == {"─"}
