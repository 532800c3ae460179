"""The command line: statuses, one-line errors, results on disk."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import toy_env
from toy_env import TOY

from agents import arguments, benchmark, cli, rows
from agents.benchmark import bench
from agents.policies import PolicyUnavailable


@pytest.fixture(autouse=True)
def toy_policies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("baselines.policies.POLICIES", toy_env.POLICIES, raising=False)


def run(*argv: str) -> int:
    return cli.main(list(argv))


def test_help_is_quick_and_lists_every_command() -> None:
    code = (
        "import sys, time; began = time.perf_counter(); from agents.cli import main; status = main(['--help'])\n"
        "assert time.perf_counter() - began < 0.5 and 'numpy' not in sys.modules and 'gymnasium' not in sys.modules"
    )
    output = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert all(f"\n  {name} " in output for name in cli.COMMANDS)


@pytest.mark.parametrize("command", ["list", "smoke", "bench", "eval"])
def test_every_command_has_help(command: str, capsys: pytest.CaptureFixture) -> None:
    assert run(command, "--help") == 0
    output = capsys.readouterr().out
    assert output.startswith(f"usage: aerograsp {command}")
    assert "--json" in output
    assert command == "list" or "--seed" in output


@pytest.mark.parametrize(
    ("argv", "status", "message"),
    [
        (["bnch"], 2, "aerograsp: error: unknown command 'bnch'; did you mean 'bench'?"),
        (["eval", "toy/Hod-v0"], 2, "aerograsp eval: error: unknown id 'toy/Hod-v0'"),
        (["eval", TOY, "--policy", "pdi"], 2, "aerograsp eval: error: unknown policy of toy/Hold-v0 'pdi'"),
        (["eval", TOY, "--episodes", "0"], 2, "expected an integer of at least 1, got '0'"),
        (["eval", TOY, "--episodes", "many"], 2, "got 'many'"),
        (["eval", TOY, "--seed", "-1"], 2, "expected an integer of at least 0, got '-1'"),
        (["eval", TOY, "--env-kwarg", "noise"], 2, "expected KEY=VALUE, got 'noise'"),
        (["eval", TOY, "--env-kwarg", "noise=-1"], 2, "noise: expected at least 0, got -1"),
        (["eval", TOY, "--env-kwarg", "nose=1"], 2, "did you mean 'noise'?"),
        (["eval", TOY, "--policy", "none.safetensors"], 2, "no such file: none.safetensors"),
        (["eval", TOY, "--json", "/no/such/folder/x.json"], 2, "no such folder: /no/such/folder"),
        (["eval"], 2, "required: ID"),
        (["eval", TOY, "--polcy", "p"], 2, "unrecognized arguments"),
        (["bench", TOY, "--out", f"{__file__}/below"], 1, "aerograsp bench: error: "),
        (["smoke", "toy/None-v0"], 2, "unknown id"),
    ],
)
def test_mistakes_are_one_line_and_a_status(
    argv: list[str], status: int, message: str, capsys: pytest.CaptureFixture
) -> None:
    assert run(*argv) == status
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1 and error.endswith("\n")


def test_no_command_is_misuse_and_the_version_is_told(capsys: pytest.CaptureFixture) -> None:
    assert run() == 2
    assert run("--version") == 0
    assert capsys.readouterr().out.startswith("aerograsp ")


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (ValueError("a\n  b"), 2),
        (PolicyUnavailable("a b"), 2),
        (FileNotFoundError("a b"), 2),
        (PermissionError("a b"), 1),
        (ModuleNotFoundError("a b"), 1),
        (RuntimeError("a b"), 1),
        (KeyboardInterrupt(), 130),
    ],
)
def test_what_a_command_raises_becomes_one_line(
    error: BaseException, status: int, capsys: pytest.CaptureFixture
) -> None:
    def main(argv: list[str]) -> int:
        raise error

    assert arguments.guarded("aerograsp x", main, []) == status
    message = capsys.readouterr().err
    assert message.count("\n") == 1 and "Traceback" not in message
    assert ("a b" if status != 130 else "aerograsp x: interrupted") in message


def test_debug_lets_the_exception_through(capsys: pytest.CaptureFixture) -> None:
    for argv in (["--debug", "eval", "toy/None-v0"], ["eval", "toy/None-v0", "--debug"]):
        with pytest.raises(ValueError, match="unknown id"):
            run(*argv)


def test_environment_options_are_json_values() -> None:
    parser = arguments.Parser(prog="x")
    arguments.add_env_kwargs(parser)
    argv = ["wind=gusty", "command_delay=[0.06, 0.1]", "docked=true", "x=1", "n=null", 'wind="calm"']
    found = parser.parse_args([part for pair in argv for part in ("--env-kwarg", pair)]).env_kwargs
    assert found == {"wind": "calm", "command_delay": (0.06, 0.1), "docked": True, "x": 1, "n": None}
    assert parser.parse_args([]).env_kwargs == {}


def test_eval_prints_a_table_and_writes_json(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    out = tmp_path / "eval.json"
    assert run("eval", TOY, "--policy", "p", "--policy", "zero", "--episodes", "3", "--json", str(out)) == 0
    assert "|error| x [mm]" in capsys.readouterr().out
    data = json.loads(out.read_text())
    assert [result["policy"] for result in data["results"]] == ["p", "zero"]
    assert data["results"][0]["seed"] == 1_000_000
    assert data["provenance"]["command"].startswith("aerograsp eval toy/Hold-v0")
    assert run("eval", TOY, "--episodes", "1", "--json", "-") == 0
    assert json.loads(capsys.readouterr().out)["results"][0]["policy"] == "p"


def test_list_tells_ids_and_policies(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    monkeypatch.setattr("agents.listing.env_ids", lambda: [TOY])
    assert run("list") == 0
    output = capsys.readouterr().out
    assert "toy/Hold-v0  (batched)" in output and "Hold a point" in output and "zero, random, p" in output
    assert run("list", "--json", "-") == 0
    assert json.loads(capsys.readouterr().out)[0]["max_episode_steps"] == toy_env.STEPS


def test_bench_writes_table_data_and_report(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    out = tmp_path / "deep" / "out"
    assert run("bench", TOY, "--episodes", "3", "--policy", "p", "--policy", "ppo", "--out", str(out)) == 0
    assert f"report: {out / 'report.html'}" in capsys.readouterr().out
    data = json.loads((out / "results.json").read_text())
    assert data["rows"][0]["episodes"] == 3
    assert "no checkpoint" in data["rows"][1]["note"]
    assert "| p |" in (out / "table.md").read_text()
    assert "<!doctype html>" in (out / "report.html").read_text()


def test_bench_goes_on_where_it_was_interrupted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[str] = []
    evaluate = rows.evaluate

    def counting(env_id, policy, *args):
        if len(ran) == 1 and not interrupted:
            interrupted.append(True)
            raise KeyboardInterrupt
        ran.append(type(policy).__name__)
        return evaluate(env_id, policy, *args)

    interrupted: list[bool] = []
    monkeypatch.setattr(rows, "evaluate", counting)
    options: dict[str, Any] = {
        "env_id": TOY,
        "policies": ["p", "zero"],
        "episodes": 2,
        "out_dir": tmp_path,
        "progress": False,
    }
    with pytest.raises(KeyboardInterrupt):
        bench(**options)
    assert not (tmp_path / "report.html").exists()
    first = bench(**options)
    assert ran == ["Proportional", "ZeroPolicy"]  # each once
    assert bench(**options).table == first.table and len(ran) == 2
    bench(**{**options, "env_kwargs": {"noise": 0.1}})
    bench(**{**options, "seed": 7})
    bench(**options, fresh=True)
    assert len(ran) == 8
    for file in (tmp_path / "rows").iterdir():
        file.write_text("{")
    assert bench(**options).table == first.table and len(ran) == 10  # damaged rows are measured again


def test_a_row_of_a_changed_factory_is_measured_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    source = tmp_path / "changing_policy.py"
    source.write_text("from toy_env import Proportional as make\n")
    before = rows.content_hash(TOY, "changing_policy:make")
    source.write_text("from toy_env import Forgetful as make\n")
    assert before != rows.content_hash(TOY, "changing_policy:make") != ""
    assert rows.content_hash(TOY, "p") == ""


def test_default_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    assert benchmark.default_rows(TOY, quick=True) == ["zero", "random", "ppo"]
    assert benchmark.default_rows(TOY, quick=False) == ["zero", "random", "p", "ppo", "ppo-residual"]
    shipped = {"ppo": Path("a"), "ppo-seed0": Path("a"), "ppo-seed1": Path("b")}
    monkeypatch.setattr("agents.bench_setup.checkpoints", lambda env_id: shipped)
    assert benchmark.default_rows(TOY, quick=False)[3:] == ["ppo-seed0", "ppo-seed1", "ppo-residual"]


def test_ctrl_c_ends_a_run_with_one_line() -> None:
    code = (  # a shell's background jobs ignore the signal: heed it, as on a terminal
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "import baselines.policies, toy_env; baselines.policies.POLICIES = toy_env.POLICIES\n"
        "from agents.cli import main; print('ready', flush=True)\n"
        "raise SystemExit(main(['eval', toy_env.TOY, '--episodes', '100000', '--num-envs', '1']))"
    )
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    process = subprocess.Popen(
        [sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None and process.stdout.readline() == "ready\n"
        time.sleep(2.0)
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=20)
    finally:
        process.kill()
    assert process.returncode == 130
    assert error == "aerograsp eval: interrupted\n"
