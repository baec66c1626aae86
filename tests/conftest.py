"""One torch thread (four on a busy machine take ten times as long), log folders that vanish, and the environment."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch as th

th.set_num_threads(1)
os.environ["OMP_NUM_THREADS"] = "1"  # for the processes that tests start


@pytest.fixture(autouse=True)
def _sb3_log_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """SB3 makes a folder per model in the system's temporary one, unless told where."""
    monkeypatch.setenv("SB3_LOGDIR", str(tmp_path / "sb3"))


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    """A log folder that does not exist yet."""
    return tmp_path / "logs"


@pytest.fixture
def env() -> Iterator[Any]:
    """The reaching environment; only who asks for it starts Bullet."""
    from sb3_stereo.envs.reach import StereoReachEnv

    env = StereoReachEnv(render_mode="rgb_array")
    yield env
    env.close()


@pytest.fixture
def client() -> Iterator[Any]:
    """A simulation in which nothing is yet."""
    from sb3_stereo.envs.simulation import Client

    client = Client()
    client.setTimeStep(1 / 240)
    yield client
    client.close()
