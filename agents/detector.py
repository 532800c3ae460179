"""`aerograsp detector`: learned detectors, from training to the file that runs anywhere."""

from agents.command_group import run_group

COMMANDS = {
    "train": ("agents.detect_train", "train on a data set of `aerograsp dataset detect`; resumable"),
    "eval": ("agents.detect_evaluate", "score on a data set: precision, recall, latency, and a page"),
    "export": ("agents.detect_export", "write the trained network as one ONNX file"),
    "real": ("agents.detect_real", "score on photographs of tools"),
}


def main(argv: list[str]) -> int:
    """Run one of `COMMANDS`; returns the exit status."""
    return run_group("aerograsp detector", "Learned detectors.", COMMANDS, argv)
