"""A Ray cluster: the flags that choose one, and the connection to it. Nothing here imports Ray before it is needed."""

import argparse
import logging
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from sb3_stereo.errors import ConfigError
from sb3_stereo.runtime import available_cores

if TYPE_CHECKING:
    from sb3_stereo.tuning.config import Resources


def add_cluster_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags that choose the cluster and how much of it is used."""
    parser.add_argument("--address", help="a Ray cluster, e.g. auto or head:6379 (default: this machine alone)")
    parser.add_argument("--workers", type=int, default=0, help="trials at a time (default: as many as fit)")


def check_cluster_flags(args: argparse.Namespace) -> None:
    """Raise a ConfigError for flags that cannot be used."""
    if find_spec("ray") is None or find_spec("optuna") is None:
        raise ConfigError("Ray Tune and Optuna are not installed; install them with: pip install 'sb3_stereo[sweep]'")
    if args.workers < 0:
        raise ConfigError(f"--workers must not be negative, got {args.workers}")


@contextmanager
def connected(address: str | None) -> Iterator[None]:
    """Connect to a Ray cluster, or start one of this machine's cores; it ends with the context.

    Raises:
        ConfigError: If there is no cluster at the address.
    """
    os.environ.update(
        RAY_USAGE_STATS_ENABLED="0",
        TUNE_DISABLE_AUTO_CALLBACK_LOGGERS="1",  # the run directories are the record
        TUNE_DISABLE_SIGINT_HANDLER="1",  # Ctrl-C ends the command; the next one continues
        RAY_CHDIR_TO_TRIAL_DIR="0",
        RAY_AIR_NEW_OUTPUT="0",
    )
    import ray

    if address and ":" in address and "//" not in address:
        check_reachable(address)
    local: dict[str, Any] = {
        "include_dashboard": False,
        "object_store_memory": 128 * 2**20,
        "num_cpus": available_cores(),
    }
    try:
        ray.init(address or "local", log_to_driver=False, logging_level=logging.ERROR, **({} if address else local))
    except (ConnectionError, ValueError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f"no Ray cluster at '{address}' ({reason}); start one with: ray start --head") from error
    logging.getLogger("ray.tune").setLevel(logging.CRITICAL)  # failures are reported at the end, in a line each
    try:
        yield
    except KeyboardInterrupt:
        print("Interrupted; repeat the command to continue.")
        raise
    finally:
        ray.shutdown()


def check_reachable(address: str) -> None:
    """Raise a ConfigError unless something listens at HOST:PORT; Ray itself would try for many minutes."""
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=10).close()
    except (OSError, ValueError, OverflowError) as error:
        raise ConfigError(f"no Ray cluster at '{address}' ({error}); start one with: ray start --head") from error


def check_resources(resources: "Resources") -> None:
    """Raise a ConfigError unless a machine of the cluster can hold a trial; Tune would wait for one for ever."""
    import ray

    nodes: list[dict[str, Any]] = ray.nodes()  # type: ignore[no-untyped-call]
    machines = [node["Resources"] for node in nodes if node["Alive"]]
    if not any(m.get("CPU", 0) >= resources.cpu and m.get("GPU", 0) >= resources.gpu for m in machines):
        have = "; ".join(f"{m.get('CPU', 0):g} cores and {m.get('GPU', 0):g} GPUs" for m in machines)
        raise ConfigError(
            f"no machine has the {resources.cpu:g} cores and {resources.gpu:g} GPUs that resources ask for; "
            f"there are: {have}"
        )
