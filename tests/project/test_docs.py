"""Every command in the texts is one that exists; ours are parsed by their own parsers, and the quick ones are run."""

import argparse
import configparser
import glob
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import pytest

from sb3_stereo.__main__ import COMMANDS
from sb3_stereo.config.modules import import_packages
from sb3_stereo.config.schema import load_config
from sb3_stereo.config.values import parse_assignments

ROOT = Path(__file__).parents[2]
TEXTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "benchmarks").glob("*.md")])
CHECKOUT = ("docs", "envs", "hyperparams", "train.py", "enjoy.py", "constraints.txt")

FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
PROMPT = re.compile(r"^\w*\$ (.*)$", re.MULTILINE)
INLINE = re.compile(r"`((?:python|make|pip|sb3-stereo|ray) [^`]+)`")
OURS = re.compile(r"python -m (?:sb3_stereo (\w+)|(benchmarks(?:\.\w+)+))|python (train|enjoy)\.py|sb3-stereo (\w+)")
LEARNER = "python docs/examples/own_learner.py "
# Tested in test_sweep_ray.py, test_zoo.py, below and in test_models.py; the last is what runs the tests.
OTHERS = re.compile(rf"ray |python -m rl_zoo3\.train |{re.escape(LEARNER)}|cd .* && sha256sum|\.ci/run")

# What a command is given to be quick; the last flag of a kind wins.
QUICK = ("--num-threads", "1", "--device", "cpu")
TINY = {
    "train": ("-n", "12", "--eval-freq", "-1", "--n-eval-envs", "1", *QUICK),
    "enjoy": ("--no-render", "-n", "4", *QUICK),
    "evaluate": ("--n-envs", "1", *QUICK),
    "check": ("--poses", "20", "--steps", "5"),
    "plot": (),
    "report": ("--n-episodes", "1", *QUICK),
    "predict": QUICK,
    "collect": ("--n-episodes", "1", *QUICK),
    "benchmarks.analysis.switched": ("--episodes", "1"),
}
FILM = ("--n-episodes", "1", *QUICK)  # in place of `enjoy`'s, for a video
TINY_ASSIGNMENTS = {
    "-params": ("learning_starts:10", "batch_size:4", "buffer_size:50"),
    "--env-kwargs": ("max_episode_steps:1",),
}
# Commands that their own tests run, and those that a page's commands do not prepare or mean to fail.
ELSEWHERE = re.compile(
    r".*\b(sweep|push_to_hub|load_from_hub|manual) |.*(--resume|logs/sweeps|\{urdf)"
    r"|python -m benchmarks\.(tables|speed)|python -m benchmarks\.analysis\.mujoco RUN"
)
NEEDED = {"ujoco": "mujoco", "--format lerobot": "lerobot"}  # what has such a word in it needs the package


class Command(NamedTuple):
    """A command as it stands in a text.

    Attributes:
        text: The file's name.
        line: Without comment and variables.
        shown: It stands after a prompt, not between words, where arguments may be left out.
    """

    text: str
    line: str
    shown: bool

    def __str__(self) -> str:
        return f"{self.text}: {self.line}"


class Stopped(Exception):
    """Comes in place of what a command would do."""


def commands() -> Iterator[Command]:
    for path in TEXTS:
        text = path.read_text(encoding="utf-8")
        blocks = [block for language, block in FENCE.findall(text) if language == "console"]
        shown = dict.fromkeys(bare(line) for block in blocks for line in PROMPT.findall(block))
        inline = dict.fromkeys(" ".join(code.split()) for code in INLINE.findall(FENCE.sub("", text)))
        yield from (Command(path.name, line, shown=True) for line in shown)
        yield from (Command(path.name, line, shown=False) for line in inline if line not in shown)


def bare(line: str) -> str:
    """Return a line without its comment and the variables before the command."""
    return re.sub(r"^(\w+=\S+ )+", "", re.sub(r"\s+#.*", "", line))


ALL = list(commands())


def staged(folder: Path) -> Path:
    """Put what the commands name into a folder: parts of the checkout, the example's files, and two images."""
    for path in [*(ROOT / name for name in CHECKOUT), *(ROOT / "docs" / "examples").glob("*.[yu]*")]:
        (folder / path.name).symlink_to(path)
    for image in (ROOT / "docs" / "examples" / "images").glob("*.png"):
        (folder / image.name).symlink_to(image)
    return folder


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Such a folder."""
    return staged(tmp_path_factory.mktemp("stage"))


@pytest.fixture(scope="module")
def first_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log folder that a reader has who comes to a page: with the README's run."""
    folder = staged(tmp_path_factory.mktemp("first"))
    run_command("python train.py --algo ddpg", folder)
    return folder / "logs"


def test_the_commands_are_found() -> None:
    shown = {command.text for command in ALL if command.shown}
    assert shown >= {"README.md", "CONTRIBUTING.md", "commands.md", "paper.md", "resuming.md", "your_robot.md"}
    assert Command("README.md", "make test", shown=True) in ALL
    assert (
        Command("real_cameras.md", "python train.py --algo ddpg --env WamStereoReach-v0 --seed 11 -n 4000", shown=False)
        in ALL
    )


@pytest.mark.parametrize("command", ALL, ids=str)
def test_every_command_exists_with_its_flags_and_files(
    command: Command, stage: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(stage)
    for file in re.findall(r"[\w./-]+\.(?:yml|py|txt)\b", command.line):
        assert Path(file).is_file(), f"no file {file}"
    if OTHERS.match(command.line):
        return
    program, *argv = shlex.split(command.line)
    if program == "make":
        dry_run = ["make", "--dry-run", "-C", str(ROOT), *argv]
        assert subprocess.run(dry_run, stdout=subprocess.DEVNULL, check=False).returncode == 0
    elif program == "pip":
        extras = ",".join(re.findall(r"-e \.\[([\w,]+)\]", " ".join(argv))).split(",")
        assert set(extras) <= extras_of_setup_cfg() or set(argv) == {"install", "numpy", "setuptools", "wheel"}
    elif command.line != "python -m sb3_stereo --help":
        name, argv = call(command.line)
        assert name.startswith("benchmarks") or name.removeprefix("sb3_stereo.commands.") in COMMANDS
        if command.shown or argv:
            check_arguments(name, argv, monkeypatch)


def extras_of_setup_cfg() -> set[str]:
    config = configparser.ConfigParser()
    config.read(ROOT / "setup.cfg")
    return set(config["options.extras_require"])


def test_the_page_on_installing_lists_every_extra() -> None:
    rows = re.findall(
        r"^\| (`[^|]*`) \|", (ROOT / "docs" / "installation.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    listed = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
    assert sorted(listed) == sorted(extras_of_setup_cfg())


def call(line: str) -> tuple[str, list[str]]:
    """Return the module of a command of ours, and its arguments."""
    match = OURS.match(line)
    assert match is not None, "a command that this test does not know"
    command = match[1] or match[3] or match[4]
    return match[2] or f"sb3_stereo.commands.{command}", shlex.split(line[match.end() :])


def check_arguments(module: str, argv: Sequence[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the command's own parser read them, and then the configuration what a training is given."""
    parsed: list[argparse.Namespace] = []
    parse = argparse.ArgumentParser.parse_args

    def stop(parser: argparse.ArgumentParser, args: Any = None, namespace: Any = None) -> NoReturn:
        parsed.append(parse(parser, args, namespace))
        raise Stopped

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", stop)
    monkeypatch.setattr(sys, "argv", [module, *argv])
    with pytest.raises(Stopped):
        import_module(module).main()
    (args,) = parsed
    if module == "sb3_stereo.commands.train" and args.resume is None:
        import_packages(args.gym_packages)
        params, env_kwargs = parse_assignments(args.hyperparams), parse_assignments(args.env_kwargs)
        load_config(args.algo, args.env, args.conf_file, params, env_kwargs, args.n_timesteps)


def tiny(module: str, argv: list[str], folder: Path) -> list[str]:
    """Return the arguments, patterns replaced by files, with others that make the command quick."""
    name = module.removeprefix("sb3_stereo.commands.")
    argv = [file for word in argv for file in (sorted(glob.glob(word, root_dir=folder)) or [word])]
    filmed = name == "enjoy" and "--video" in argv
    for flag, assignments in TINY_ASSIGNMENTS.items():
        if name == "train" or (filmed and flag == "--env-kwargs"):
            at = argv.index(flag) + 1 if flag in argv else len(argv)
            argv[at:at] = assignments if flag in argv else (flag, *assignments)
    few = ("--poses", "1") if "--disturbances" in argv else ()
    return [*argv, *(FILM if filmed else TINY[name]), *few]


def to_run(command: Command) -> bool:
    """Whether a page's reader would type the command here, and it is not run elsewhere."""
    ours = OURS.match(command.line) or command.line.startswith(LEARNER)
    lacking = any(word in command.line and not find_spec(package) for word, package in NEEDED.items())
    return command.shown and bool(ours) and not ELSEWHERE.match(command.line + " ") and not lacking


def run_command(line: str, folder: Path) -> None:
    """Run a command, made quick, in a folder."""
    if line.startswith(LEARNER):
        argv = [*line.split()[1:3], "20"]
    else:
        module, given = call(line)
        argv = ["-m", module, *tiny(module, given, folder)]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "MINARI_DATASETS_PATH": str(folder / "datasets")}
    environment["HF_LEROBOT_HOME"] = str(folder / "lerobot")
    result = subprocess.run(
        [sys.executable, *argv], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, f"{line}\n{result.stderr}"


PAGES = list(dict.fromkeys(command.text for command in ALL if to_run(command)))


def test_the_pages_of_a_newcomer_have_commands_that_are_run() -> None:
    newcomers = {"README.md", "installation.md", "tutorial.md", "gallery.md", "pick.md", "robustness.md", "commands.md"}
    assert set(PAGES) >= newcomers | {"your_robot.md", "real_cameras.md"}


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("page", PAGES)
def test_a_pages_commands_run_one_after_the_other_as_a_reader_would(page: str, first_run: Path, tmp_path: Path) -> None:
    shutil.copytree(first_run, staged(tmp_path) / "logs")
    for command in ALL:
        if command.text == page and to_run(command):
            run_command(command.line, tmp_path)


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.name)
def test_links_say_where_they_lead_in_words(path: Path) -> None:
    text = FENCE.sub("", path.read_text(encoding="utf-8"))
    assert re.findall(r"\[`?([\w./-]+\.md)`?\]\(", text) == []
