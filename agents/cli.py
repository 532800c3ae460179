"""The `aerograsp` command. Each subcommand is a module with `main(argv) -> int`, imported when it is called."""

import importlib
import sys
from collections.abc import Sequence

COMMANDS = {
    "list": ("agents.listing", "the environments and their policies"),
    "doctor": ("agents.doctor", "what works on this machine, and why the rest does not"),
    "smoke": ("agents.smoke", "a few short episodes of any policy on any id: contract checks for CI"),
    "bench": ("agents.benchmark", "compare policies on pinned episodes: table, JSON and HTML report"),
    "train": ("agents.train", "train a policy; resumable"),
    "eval": ("agents.evaluation", "evaluate policies on pinned episodes"),
    "play": ("agents.play", "film an episode as GIF or MP4"),
    "tune": ("agents.tune", "find controller gains on training seeds"),
    "calibrate": ("agents.calibrate", "the sensors' noise against Table 5.3"),
    "detect": ("agents.detect", "find objects in images: boxes, labels, poses"),
    "detector": ("agents.detector", "train, score and export learned detectors"),
    "dataset": ("agents.dataset", "render data sets"),
    "plan": ("agents.plan", "rank grasps on a mesh or a point cloud, and draw them in a page"),
    "reproduce": ("agents.reproduce", "a published table beside what this project measures"),
}


def usage() -> str:
    """The help text of `aerograsp`."""
    width = max(map(len, COMMANDS)) + 2
    lines = "\n".join(f"  {name:<{width}}{help}" for name, (_, help) in COMMANDS.items())
    return (
        "usage: aerograsp [--help] [--version] COMMAND ...\n\n"
        "Aerial manipulation: environments, analytic baselines, learned policies.\n\n"
        f"commands:\n{lines}\n\n"
        "`aerograsp COMMAND --help` lists a command's options. `--debug` shows the traceback of an error.\n"
        "Exit status: 0 done, 1 failed, 2 misused, 130 interrupted."
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    debug = arguments[:1] == ["--debug"]
    if debug:
        arguments = arguments[1:]
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        print(usage(), file=sys.stdout if arguments else sys.stderr)
        return 0 if arguments else 2
    if arguments[0] == "--version":
        from importlib.metadata import version

        print(f"aerograsp {version('aerograsp')}")
        return 0
    command, rest = arguments[0], arguments[1:]
    if command not in COMMANDS:
        import difflib

        near = difflib.get_close_matches(command, COMMANDS, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        print(f"aerograsp: error: unknown command {command!r}; {hint}valid: {', '.join(COMMANDS)}", file=sys.stderr)
        return 2
    from agents.arguments import guarded

    def run(rest: list[str]) -> int:
        return importlib.import_module(COMMANDS[command][0]).main(rest)

    try:
        return guarded(f"aerograsp {command}", run, [*rest, "--debug"] if debug else rest)
    except SystemExit as exit:  # argparse: --help is 0, misuse is 2
        return exit.code if isinstance(exit.code, int) else 1


if __name__ == "__main__":
    sys.exit(main())
