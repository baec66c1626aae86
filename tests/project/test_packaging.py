"""What is on disk is what is installed, and importing is cheap."""

import configparser
import os
import re
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest
import yaml

import sb3_stereo
from sb3_stereo.__main__ import COMMANDS
from sb3_stereo.console import command_line

ROOT = Path(__file__).parents[2]
FOLDERS = {"sb3_stereo": "sb3_stereo", "sb3_stereo.envs": "envs", "sb3_stereo.hyperparams": "hyperparams"}


def setup_cfg() -> configparser.ConfigParser:
    config = configparser.ConfigParser()
    config.read(ROOT / "setup.cfg")
    return config


def run_python(code: str, cwd: Path, **environment: str) -> str:
    command = [sys.executable, "-c", code]
    env = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"} | environment
    result = subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_every_package_on_disk_is_listed() -> None:
    listed = set(setup_cfg()["options"]["packages"].split())
    on_disk = set()
    for package, folder in FOLDERS.items():
        for init in (ROOT / folder).rglob("__init__.py"):  # rglob does not follow the two links
            inside = init.parent.relative_to(ROOT / folder).parts
            on_disk.add(".".join([package, *inside]))
    assert listed == on_disk


def test_every_data_file_matches_a_package_data_glob() -> None:
    globs = setup_cfg()["options.package_data"]
    for package, folder in FOLDERS.items():
        base = ROOT / folder
        matched = {path for pattern in globs[package].split() for path in base.glob(pattern)}
        data = {path for path in base.rglob("*") if path.is_file() and path.suffix not in (".py", ".pyc")}
        assert data <= matched, f"files of {folder} that setup.cfg forgets: {data - matched}"


def test_the_links_show_editors_what_is_installed() -> None:
    for name in ("envs", "hyperparams"):
        link = ROOT / "sb3_stereo" / name
        assert link.is_symlink()
        assert os.readlink(link) == f"../{name}"


def test_importing_loads_neither_torch_nor_pybullet_nor_pydantic() -> None:
    code = "import sys, sb3_stereo; print({'torch', 'pybullet', 'pydantic', 'stable_baselines3'} & set(sys.modules))"
    assert run_python(code, ROOT) == "set()\n"


def test_every_public_name_can_be_imported() -> None:
    for name in sb3_stereo.__all__:
        assert getattr(sb3_stereo, name) is not None
    with pytest.raises(AttributeError) as error:
        _ = sb3_stereo.StereoCNN
    assert str(error.value) == "module 'sb3_stereo' has no attribute 'StereoCNN'"


def test_the_change_log_and_the_citation_know_the_version() -> None:
    assert f"## [{sb3_stereo.__version__}]" in (ROOT / "CHANGELOG.md").read_text()
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == sb3_stereo.__version__


def test_the_constraints_pin_every_direct_dependency() -> None:
    options = setup_cfg()
    extras = [
        text for name, text in options["options.extras_require"].items() if name not in ("zoo", "peers", "lerobot")
    ]
    required = "\n".join([options["options"]["install_requires"], *extras]).split("\n")
    wanted = {re.split(r"[\[<>=]", line)[0].lower().replace("_", "-") for line in required if line}
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = {line.split("==")[0].lower().replace("_", "-") for line in lines if "==" in line}
    assert wanted <= pinned


@pytest.mark.slow
def test_the_wheel_works_away_from_the_checkout(tmp_path: Path) -> None:
    # A copy, so that no build/ folder stays in the checkout.
    source = tmp_path / "source"
    ignore = ("--exclude=./.venv", "--exclude=./.git", "--exclude=./logs", "--exclude=./build")
    source.mkdir()
    subprocess.run(f"tar -c {' '.join(ignore)} . | tar -x -C '{source}'", cwd=ROOT, shell=True, check=True)
    # The source archive, and from that the wheel.
    build = [sys.executable, "-m", "build", "--no-isolation", "--outdir", tmp_path, source]
    subprocess.run(build, cwd=tmp_path, stdout=subprocess.DEVNULL, check=True)
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    poses = "envs/assets/test_poses/WamStereoReach-v0.csv"
    for name in ("envs/assets/wam.urdf", poses, "envs/reach.py", "hyperparams/paper/ddpg.yml", "py.typed"):
        assert f"sb3_stereo/{name}" in names
    # A new environment; the dependencies' files are lent by this one, as installing torch again takes minutes.
    venv.create(tmp_path / "venv", with_pip=True)
    python = tmp_path / "venv" / "bin" / "python"
    (site,) = (tmp_path / "venv" / "lib").glob("python*/site-packages")
    (site / "lent.pth").write_text(sysconfig.get_path("purelib"))
    subprocess.run([python, "-m", "pip", "install", "-q", "--no-deps", "--no-index", wheel], cwd=tmp_path, check=True)
    code = """
import gymnasium as gym, sb3_stereo
from sb3_stereo.config.schema import load_config
from sb3_stereo.evaluation.protocol import eval_poses
env = gym.make("WamStereoReach-v0")
observation, _ = env.reset(seed=1)
env.step(env.action_space.sample())
env.close()
load_config("ddpg", "WamStereoReach-v0")
assert sb3_stereo.load_pretrained("WamStereoReach-v1").predict(observation)[0].shape == (4,)
print(sb3_stereo.__file__, observation.shape, eval_poses("WamStereoReach-v0").shape)
"""
    run = subprocess.run([python, "-I", "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1] == f"{site / 'sb3_stereo' / '__init__.py'} (1, 84, 84) (100, 4)"
    command = [tmp_path / "venv" / "bin" / "sb3-stereo", "--version"]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert run.stdout == f"sb3_stereo {sb3_stereo.__version__}\n"
    for name in COMMANDS:  # what our messages name
        command = [python, "-I", "-m", "sb3_stereo", name, "--help"]
        run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
        assert run.stdout.startswith(f"usage: {command_line(name)} ")
