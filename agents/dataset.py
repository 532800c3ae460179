"""`aerograsp dataset`: data sets that this project makes."""

from agents.command_group import run_group

COMMANDS = {"detect": ("agents.detect_dataset", "pictures with boxes and poses, for detectors")}


def main(argv: list[str]) -> int:
    """Run one of `COMMANDS`; returns the exit status."""
    return run_group("aerograsp dataset", "Data sets, rendered by this project.", COMMANDS, argv)
