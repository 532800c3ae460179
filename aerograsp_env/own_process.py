"""Trying something in a process of its own: what crashes there does no harm here."""

from __future__ import annotations

import os
import re
import subprocess
import sys

TIMEOUT = 60.0  # [s] for one trial
_LONGEST = 600  # characters of a fault


def fault_of(program: str, *arguments: str, seconds: float = TIMEOUT, **environment: str) -> str | None:
    """Run a Python program; None if it ends well, else one line that says why not.

    Args:
        program: its text.
        *arguments: its `sys.argv[1:]`.
        seconds: after which it counts as hung.
        **environment: variables beside this process's own.
    """
    try:
        done = subprocess.run(
            [sys.executable, "-c", program, *arguments],
            env={**os.environ, **environment},
            capture_output=True,
            text=True,
            errors="replace",
            timeout=seconds,
        )
    except subprocess.TimeoutExpired:
        return f"no answer within {seconds:g} s"
    except OSError as error:
        return str(error)
    if done.returncode == 0:
        return None
    if done.returncode < 0:
        return f"crashed with signal {-done.returncode}"
    errors = re.findall(r"^[\w.]*(?:Error|Exception|Interrupt|Exit|NotFound)\b.*$", done.stderr, flags=re.MULTILINE)
    return (errors or done.stderr.split("\n")[-2:-1] or [f"exit status {done.returncode}"])[-1][:_LONGEST]
