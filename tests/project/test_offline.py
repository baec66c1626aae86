"""Nothing needs a network at run time."""

import subprocess
import sys
from pathlib import Path

WITHOUT_SOCKETS = """
import socket, sys

class Refused(socket.socket):
    def __init__(self, family=-1, *args, **kwargs):
        if family != socket.AF_UNIX:  # processes talk over these
            raise AssertionError("a socket was opened")
        super().__init__(family, *args, **kwargs)

def refuse(*arguments, **named):
    raise AssertionError(f"a name was looked up: {arguments}")

socket.socket, socket.getaddrinfo, socket.create_connection = Refused, refuse, refuse
from sb3_stereo.commands import train
sys.exit(train.main(sys.argv[1:]))
"""


def test_a_training_opens_no_socket(logs: Path) -> None:
    flags = ["--env", "FakeReach-v0", "--gym-packages", "fake_reach", "-n", "20", "-f", str(logs)]
    flags += ["--n-eval-envs", "1", "--num-threads", "1", "--device", "cpu", "--seed", "0"]
    flags += ["-params", "learning_starts:10", "batch_size:4", "buffer_size:50"]
    flags += ["policy_kwargs.features_extractor_kwargs.n_filters:4"]
    command = [sys.executable, "-c", WITHOUT_SOCKETS, *flags]
    ended = subprocess.run(command, cwd=Path(__file__).parents[1] / "helpers", capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert list(logs.glob("*/*/FakeReach-v0.zip"))
