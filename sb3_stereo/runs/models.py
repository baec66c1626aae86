"""Models on disk: saved as SB3 saves them, with a checksum, and loaded without running any code in them.

An SB3 zip runs code when SB3 loads it: its settings are a pickle. Of our runs the settings are plain YAML, so that only
the weights are read from the zip, which `torch.load(weights_only=True)` does without running anything.
"""

import io
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sb3_stereo.building.factory import make_env, make_model
from sb3_stereo.config.schema import Config, algorithm
from sb3_stereo.errors import ConfigError, setting_up
from sb3_stereo.policies.old_names import upgraded
from sb3_stereo.runs.archives import MIB, load_tensors, open_zip, read_member
from sb3_stereo.runs.files import partial_path, publish, sha256, write
from sb3_stereo.runs.memory import networks_of_at_most
from sb3_stereo.runs.training_state import variables
from sb3_stereo.runs.weights import checked_state, checked_tensors

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

CHECKSUMS = "SHA256SUMS"  # for `sha256sum -c`
NETWORKS = "policy.pth"  # SB3's name for them in a model's zip file


def save_model(model: "BaseAlgorithm", path: Path) -> None:
    """Save a model and its checksum so that an interruption leaves the old file or the new one, never half of one."""
    partial = partial_path(path)
    try:
        model.save(partial)
        digest = sha256(partial)
        before = checksums(path.parent)
        write_checksums(path.parent, [*before, (path.name, digest)])  # either file is a good one
        publish(partial, path)
        write_checksums(path.parent, [*[line for line in before if line[0] != path.name], (path.name, digest)])
    finally:
        partial.unlink(missing_ok=True)


def checksums(folder: Path) -> list[tuple[str, str]]:
    """Return the models that a folder's `SHA256SUMS` names, and their digests."""
    file = folder / CHECKSUMS
    lines = file.read_text(encoding="utf-8").splitlines() if file.is_file() else []
    return [(name, digest) for digest, _, name in (line.partition("  ") for line in lines)]


def write_checksums(folder: Path, pairs: Sequence[tuple[str, str]]) -> None:
    """Write `SHA256SUMS`, or remove it if it names nothing."""
    if not pairs:
        (folder / CHECKSUMS).unlink(missing_ok=True)
        return
    write(folder / CHECKSUMS, "".join(f"{digest}  {name}\n" for name, digest in sorted(pairs)).encode())


def is_whole(path: Path) -> bool:
    """Return whether a model is there and has a checksum that goes with it."""
    return path.is_file() and (path.name, sha256(path)) in checksums(path.parent)


def load_model(config: Config, path: Path, device: str = "auto", trust: bool = False) -> "BaseAlgorithm":
    """Load a run's model for acting; its replay buffer is the smallest one.

    Args:
        config: The run's.
        path: The zip file.
        device: PyTorch device.
        trust: Let SB3 load the file, with all the code that may be in it.

    Raises:
        ConfigError: If the file is not what the run saved, or does not go with the configuration.
    """
    model: BaseAlgorithm
    with setting_up(f"the model '{path}'"):
        if trust:
            model = algorithm(config.algo).load(path, device=device, buffer_size=1)
            return model
        _check(path)
        with networks_of_at_most(4 * path.stat().st_size + 64 * MIB, path):  # weights hardly compress
            model = untrained_model(config, device)
    load_weights(model, path, trust=True, optimizers=False)
    return model


def untrained_model(config: Config, device: str = "auto", seed: int | None = None) -> "BaseAlgorithm":
    """Return a run's model as it was before the training, but for its replay buffer, which is the smallest one."""
    from stable_baselines3.common.vec_env import DummyVecEnv

    small = {"buffer_size": 1} if "buffer_size" in config.algo_kwargs else {}
    if config.algo == "ppo":  # whose buffer is of n_steps
        small = {"n_steps": 2, "batch_size": 2}
    env = DummyVecEnv([make_env(config.env_id, config.env_kwargs, config.env_wrapper)])
    try:
        return make_model(replace(config, algo_kwargs={**config.algo_kwargs, **small}), env, seed, device)
    finally:
        env.close()


def load_weights(model: "BaseAlgorithm", path: Path, trust: bool = False, optimizers: bool = True) -> None:
    """Give a model the networks, optimizers and entropy coefficient of a saved one.

    A file of networks alone, as those of the agents that ship, leaves the rest as it is.

    Args:
        model: Of the same settings.
        path: The zip file.
        trust: Take a file without a checksum too. Nothing in it is run in either case.
        optimizers: False leaves the optimizers out, of which acting needs nothing.

    Raises:
        ConfigError: If the file is not what a run saved, or the networks are others.
    """
    if not trust:
        _check(path)
    try:
        with path.open("rb") as file, open_zip(file) as archive:
            _load_parts(model, archive, optimizers)
    except (OSError, zipfile.BadZipFile, ValueError, RuntimeError) as error:  # a ZipFile raises all of these
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ConfigError(f"cannot load '{path}': {reason}; choose a model of the same settings") from error


def _load_parts(model: "BaseAlgorithm", archive: zipfile.ZipFile, optimizers: bool) -> None:
    """Read all parts, and change the model only if all are good."""
    from torch.optim import Optimizer

    networks_alone = archive.namelist() == [NETWORKS]
    optimizers = optimizers and not networks_alone
    limit = 2 * _n_bytes(model.policy.state_dict()) + MIB  # what a tensor needs besides its numbers is in the MiB
    owners = {name: attrgetter(name)(model) for name in model._get_torch_save_params()[0]}
    states, learnt = {}, {} if networks_alone else variables(model)
    for name, owner in owners.items():
        if isinstance(owner, Optimizer) and not optimizers:
            continue
        state = _read(archive, f"{name}.pth", 2 * limit)  # Adam keeps 2 numbers a weight
        if name == "policy" and isinstance(state, Mapping):
            state = upgraded(state, owner.state_dict())
        states[name] = checked_state(state, owner)
    saved = checked_tensors(_read(archive, "pytorch_variables.pth", MIB), learnt) if learnt else {}
    for name, state in states.items():
        owners[name].load_state_dict(state)
    for name, variable in learnt.items():
        variable.data.copy_(saved[name])


def _read(archive: zipfile.ZipFile, name: str, limit: int) -> Any:
    member = io.BytesIO(read_member(archive, name, limit))
    try:
        return load_tensors(member)
    except ValueError as error:
        raise ValueError(f"in '{name}': {error}") from error


def _n_bytes(tensors: Mapping[str, Any]) -> int:
    return sum(tensor.numel() * tensor.element_size() for tensor in tensors.values())


def _check(path: Path) -> None:
    """Raise a ConfigError unless the file is one that a run saved here."""
    if not path.is_file():
        raise ConfigError(f"no model '{path}'; give the zip file of one, such as the best_model.zip of a run")
    digests = [digest for name, digest in checksums(path.parent) if name == path.name]
    if sha256(path) in digests:
        return
    what = f"was changed after it was saved: {CHECKSUMS} beside it has another checksum" if digests else ""
    raise ConfigError(
        f"'{path}' {what or f'is not from a run: no {CHECKSUMS} beside it names it'}; "
        "if you trust who made it, load it with --trust, which may run code that is in the file"
    )
