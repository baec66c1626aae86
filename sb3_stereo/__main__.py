"""`python -m sb3_stereo COMMAND`, and the console script `sb3-stereo COMMAND`."""

import sys
from importlib import import_module

from sb3_stereo import __version__

COMMANDS = {
    "train": "train an agent and evaluate it on the test poses",
    "enjoy": "run a trained agent, show or record it",
    "evaluate": "evaluate a trained agent on the test poses",
    "check": "check an environment before training on it, e.g. with your own arm",
    "plot": "plot the learning curves of runs",
    "report": "write a page about a run or a sweep: film, curves, scores, settings",
    "sweep": "search hyper-parameters, on one machine or a cluster",
    "predict": "detect the markers in ordinary images and print the agent's joint torques",
    "push_to_hub": "upload a trained agent to the Hugging Face Hub",
    "load_from_hub": "download one into the log folder",
    "manual": "move the arm yourself, by the keyboard in Bullet's window",
    "collect": "record an agent's episodes as a dataset of Minari or LeRobot",
}

USAGE = "\n".join(
    [
        "usage: sb3-stereo [--help] [--version] COMMAND ...",
        "",
        *(f"  {name:<15}{text}" for name, text in COMMANDS.items()),
        "",
        "Each command has its own --help.",
    ]
)


def main(argv: list[str] | None = None) -> int:
    """Call the named command with the remaining arguments."""
    command, *rest = (sys.argv[1:] if argv is None else argv) or ["--help"]
    if command in ("-h", "--help"):
        print(USAGE)
        return 0
    if command == "--version":
        print(f"sb3_stereo {__version__}")
        return 0
    if command not in COMMANDS:
        print(f"error: unknown command '{command}'; commands are {', '.join(COMMANDS)}", file=sys.stderr)
        return 2
    exit_status: int = import_module(f"sb3_stereo.commands.{command}").main(rest)
    return exit_status


if __name__ == "__main__":
    sys.exit(main())
