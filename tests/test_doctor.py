"""The doctor reports what is there and what is not, and survives whatever it probes."""

import dataclasses
import json
import os
import subprocess
import sys

import pytest

from aerograsp_env.own_process import fault_of
from agents import doctor
from agents.doctor import Check


@pytest.fixture(scope="module")
def checks():
    return doctor.diagnose()


def test_everything_is_named_once_with_a_known_status(checks):
    names = [check.name for check in checks]
    assert len(set(names)) == len(names)
    for name in ("Python", "numpy", "mujoco", "torch (learn)", "pytest (dev)", "compiled kernel", "renderer ray"):
        assert name in names
    for name in (
        "renderer gl, egl",
        "renderer gl, osmesa",
        "renderer gl, glfw",
        "processors",
        "BLAS threads",
        "display",
    ):
        assert name in names
    assert {check.status for check in checks} <= {"ok", "warning", "missing"}
    assert all(check.detail and "\n" not in check.detail for check in checks)
    assert not any("PyFlyt" in name for name in names)  # peers live in an interpreter of their own


def test_what_these_tests_run_on_is_ok(checks):
    status = {check.name: check.status for check in checks}
    for name in ("Python", "gymnasium", "mujoco", "numpy", "opencv-python-headless", "pin", "pillow", "renderer ray"):
        assert status[name] == "ok"


def test_checks_are_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        Check("a", "ok", "b").name = "c"  # type: ignore[misc]


@pytest.mark.parametrize(("found", "status"), [("ok", 0), ("warning", 0), ("missing", 1)])
def test_exit_status_table_and_json(monkeypatch, capsys, tmp_path, found, status):
    pretended = [Check("Python", "ok", "3.11"), Check("a long name", found, "because")]
    monkeypatch.setattr(doctor, "diagnose", lambda: pretended)
    assert doctor.main(["--json", str(tmp_path / "d.json")]) == status
    lines = capsys.readouterr().out.splitlines()
    assert [line.index(word) for line, word in zip(lines[1:3], ("3.11", "because"), strict=True)] == [
        lines[0].index("detail")
    ] * 2
    assert ("Missing: a long name." in lines) == (status == 1)
    document = json.loads((tmp_path / "d.json").read_text())
    assert document["ok"] == (status == 0)
    assert [Check(**check) for check in document["checks"]] == pretended


def test_wrong_arguments(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(doctor, "diagnose", lambda: [Check("Python", "ok", "3.11")])
    assert doctor.main(["--json", str(tmp_path / "nowhere" / "d.json")]) == 2
    assert "nowhere" in capsys.readouterr().err
    assert doctor.main(["--json", str(tmp_path)]) == 2  # a folder
    assert len(capsys.readouterr().err.splitlines()) == 1
    with pytest.raises(SystemExit) as stop:
        doctor.main(["--colour"])
    assert stop.value.code == 2


def test_packages_that_are_absent_old_or_broken():
    absent = doctor._package(("no-such-package-at-all", "1.0", ""))
    assert (absent.status, "pip install" in absent.detail) == ("missing", True)
    assert doctor._package(("no-such-package-at-all", "1.0", "learn")).status == "warning"
    old = doctor._package(("numpy", "99.0", ""))
    assert old.status == "missing" and "too old" in old.detail and "numpy>=99.0" in old.detail
    assert doctor._numbers("2.13.0+cpu") == (2, 13, 0, 0)
    assert doctor._numbers("2.0rc1") >= doctor._numbers("2")


def test_trials_report_errors_crashes_and_hangs_in_one_line():
    assert fault_of("pass") is None
    assert fault_of("raise ValueError('what is wrong')") == "ValueError: what is wrong"
    assert fault_of("import sys; sys.exit(7)") == "exit status 7"
    if os.name == "posix":
        assert fault_of("import os; os.abort()") == "crashed with signal 6"
    assert fault_of("import time; time.sleep(30)", seconds=0.3) == "no answer within 0.3 s"


def test_a_wrong_mujoco_gl_does_not_stop_it():
    """MuJoCo refuses to be imported then; the renderers are tried with settings of their own."""
    program = "from agents import doctor; print(doctor._renderer('ray', 'disable').status)"
    program += "; print(doctor._package(('mujoco', '3', '')).detail)"
    environment = {**os.environ, "MUJOCO_GL": "nonsense"}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, timeout=120)
    status, detail = done.stdout.splitlines()
    assert status == "ok"
    assert "MUJOCO_GL: nonsense" in detail
