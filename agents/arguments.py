"""What the commands share: a parser with one-line errors, argument types, and the guard around a command's `main`."""

import argparse
import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

MISUSED, FAILED, INTERRUPTED = 2, 1, 130


class Parser(argparse.ArgumentParser):
    """An `ArgumentParser` whose errors are one line on standard error and exit status 2."""

    def __init__(self, **options: Any) -> None:
        options.setdefault("allow_abbrev", False)
        options.setdefault("formatter_class", argparse.ArgumentDefaultsHelpFormatter)
        super().__init__(**options)

    def error(self, message: str) -> NoReturn:
        self.exit(MISUSED, f"{self.prog}: error: {one_line(message)} (see {self.prog} --help)\n")


def one_line(message: object) -> str:
    """The message with line breaks and runs of blanks collapsed."""
    return " ".join(str(message).split())


def positive_int(text: str) -> int:
    """An argument type: an integer of at least 1."""
    return _integer(text, 1)


def seed_int(text: str) -> int:
    """An argument type: a non-negative integer."""
    return _integer(text, 0)


def _integer(text: str, minimum: int) -> int:
    try:
        value = int(text)
    except ValueError:
        value = minimum - 1
    if value < minimum:
        raise argparse.ArgumentTypeError(f"expected an integer of at least {minimum}, got {text!r}")
    return value


def key_value(text: str) -> tuple[str, Any]:
    """An argument type: KEY=VALUE, the value as JSON, or else as a plain string; arrays become tuples."""
    key, separator, value = text.partition("=")
    if not separator or not key.isidentifier():
        raise argparse.ArgumentTypeError(f"expected KEY=VALUE, got {text!r}")
    try:
        return key, _tuples(json.loads(value))
    except json.JSONDecodeError:
        return key, value


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


class _CollectKeyValues(argparse.Action):
    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        setattr(namespace, self.dest, {**(getattr(namespace, self.dest) or {}), values[0]: values[1]})


def add_env_kwargs(parser: argparse.ArgumentParser) -> None:
    """`--env-kwarg KEY=VALUE` (repeatable) → `args.env_kwargs: dict[str, Any]`."""
    parser.add_argument(
        "--env-kwarg",
        dest="env_kwargs",
        metavar="KEY=VALUE",
        type=key_value,
        action=_CollectKeyValues,
        default={},
        help="option of the environment, its value as JSON: wind=gusty, command_delay=[0.06,0.1]; repeatable",
    )


def add_policy(parser: argparse.ArgumentParser, default: str) -> None:
    """`--policy NAME` (repeatable) → `args.policies: list[str] | None`, None if not given."""
    parser.add_argument(
        "--policy",
        dest="policies",
        metavar="NAME",
        action="append",
        default=argparse.SUPPRESS,
        help=f"zero, random, an analytic or a shipped policy, a .safetensors path, or module:function; repeatable "
        f"(default: {default})",
    )
    parser.set_defaults(policies=None)


def add_episodes(parser: argparse.ArgumentParser, default: int | None = 100) -> None:
    """`--episodes N`, N ≥ 1."""
    parser.add_argument("--episodes", metavar="N", type=positive_int, default=default, help="episodes a policy")


def add_seed(parser: argparse.ArgumentParser, default: int) -> None:
    """`--seed S`, S ≥ 0."""
    parser.add_argument("--seed", metavar="S", type=seed_int, default=default, help="episode k resets with S + k")


def add_json(parser: argparse.ArgumentParser) -> None:
    """`--json FILE` → `args.json: str | None`."""
    parser.add_argument(
        "--json", metavar="FILE", type=_json_target, default=None, help="write the result as JSON; - is standard output"
    )


def _json_target(text: str) -> str:
    if text != "-" and not Path(text).absolute().parent.is_dir():  # say so before the work, not after it
        raise argparse.ArgumentTypeError(f"no such folder: {Path(text).absolute().parent}")
    return text


def guarded(prog: str, main: Callable[[list[str]], int | None], argv: Sequence[str]) -> int:
    """Run a command: its exit status, where a user's mistake is one line on standard error and never a traceback.

    0 done; 1 failed (files, missing extras, a failed check); 2 misused (bad values and names); 130 interrupted.
    `--debug` among the arguments lets exceptions through.
    """
    from gymnasium.error import Error as GymnasiumError

    arguments = list(argv)
    debug = "--debug" in arguments
    if debug:
        arguments.remove("--debug")
    try:
        return main(arguments) or 0
    except KeyboardInterrupt:
        return _complain(prog, "interrupted", INTERRUPTED)
    except BrokenPipeError:  # `| head` has read enough; keep the interpreter from complaining at its exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except Exception as error:
        if debug:
            raise
        message = one_line(error)
        if isinstance(error, ValueError | FileNotFoundError | GymnasiumError):
            return _complain(prog, f"error: {message}", MISUSED)
        if isinstance(error, OSError):
            return _complain(prog, f"error: {message}", FAILED)
        if isinstance(error, ModuleNotFoundError):
            return _complain(prog, f"error: {message}; install the extras: aerograsp[all]", FAILED)
        return _complain(prog, f"error: {type(error).__name__}: {message} (--debug shows where)", FAILED)


def _complain(prog: str, message: str, status: int) -> int:
    print(f"{prog}: {message}", file=sys.stderr)
    return status
