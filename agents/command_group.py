"""Commands of commands: `aerograsp dataset detect …`, `aerograsp detector train …`."""

from __future__ import annotations

import difflib
import importlib
import sys
from collections.abc import Mapping

from agents.arguments import MISUSED


def run_group(prog: str, purpose: str, commands: Mapping[str, tuple[str, str]], argv: list[str]) -> int:
    """Run one command of a group.

    Args:
        purpose: a line for the help text.
        commands: name → module with `main(argv) -> int`, imported when it is called, and a line of help.
        argv: the command and its arguments.

    Returns:
        The exit status.
    """
    width = max(map(len, commands)) + 2
    lines = "\n".join(f"  {name:<{width}}{about}" for name, (_, about) in commands.items())
    usage = f"usage: {prog} [--help] COMMAND ...\n\n{purpose}\n\ncommands:\n{lines}"
    if not argv or argv[0] in ("-h", "--help", "help"):
        print(usage, file=sys.stdout if argv else sys.stderr)
        return 0 if argv else MISUSED
    if argv[0] not in commands:
        near = difflib.get_close_matches(argv[0], commands, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        print(f"{prog}: error: unknown command {argv[0]!r}; {hint}valid: {', '.join(commands)}", file=sys.stderr)
        return MISUSED
    return importlib.import_module(commands[argv[0]][0]).main(argv[1:])
