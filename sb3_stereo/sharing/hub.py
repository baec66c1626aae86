"""Runs on the Hugging Face Hub: one model a repository, in the files that rl-baselines3-zoo writes there.

    README.md  ddpg-WamStereoReach-v1.zip  SHA256SUMS  config.yml  args.yml  env_kwargs.yml  versions.yml
    train_eval_metrics.zip (evaluations.csv, *.monitor.csv)  results.json  replay.mp4

and `env.py`, by which LeRobot makes the agent's environment if it is one of ours.

What is downloaded is a stranger's: it is only read, and placed where the commands read it (SECURITY.md).
"""

import json
import shutil
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from sb3_stereo.config.schema import Config
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.protocol import Evaluation
from sb3_stereo.runs.archives import MIB, open_zip, read_member
from sb3_stereo.runs.creation import publish_run
from sb3_stereo.runs.directory import ARGUMENTS, EVALUATIONS, arguments_file, env_name, load_record, read_record
from sb3_stereo.runs.files import sha256, write
from sb3_stereo.runs.models import CHECKSUMS, checksums, write_checksums
from sb3_stereo.runs.pretrained import shareable
from sb3_stereo.runs.status import ENDED, LOCK, STATUS
from sb3_stereo.sharing.card import model_card
from sb3_stereo.sharing.lerobot_env import ENV_FILE, env_file, has_env_file

METRICS, RESULTS, REPLAY = "train_eval_metrics.zip", "results.json", "replay.mp4"  # the zoo's names
CONFIG, VERSIONS, ENV_KWARGS = "config.yml", "versions.yml", "env_kwargs.yml"
MAX_RECORD, MAX_SCORES, MAX_MODEL = MIB, 64 * MIB, 1024 * MIB  # what is downloaded at most
LOG_IN = "log in with: hf auth login (or set HF_TOKEN), with a token that may write"


def repository(algo: str, env_id: str, organization: str | None, name: str | None) -> str:
    """Return the repository's id; the default name is the zoo's, e.g. `ddpg-WamStereoReach-v1`.

    Raises:
        ConfigError: If no organization is given, or the extra `hub` is not installed.
    """
    if organization is None:
        raise ConfigError("which repository? give --repo-id OWNER/NAME, or the owner alone with -orga")
    with hub_errors(f"{organization}/{name or algo}"):
        from huggingface_sb3 import ModelRepoId

        return str(ModelRepoId(organization, name or _model_name(algo, env_id)))


def _model_name(algo: str, env_id: str) -> Any:
    """The package's name for a model, which is a text."""
    from huggingface_sb3 import EnvironmentName, ModelName

    return ModelName(algo, EnvironmentName(env_id))


@contextmanager
def hub_errors(repo_id: str) -> Iterator[None]:
    """Turn what the Hub's client raises into one sentence.

    Raises:
        ConfigError: If the client is not installed, the Hub cannot be reached, or it refuses.
    """
    try:
        from huggingface_hub import errors
        from huggingface_hub.utils import httpx  # type: ignore[attr-defined]
    except ModuleNotFoundError as error:
        raise _not_installed(error) from error
    try:
        yield
    except ModuleNotFoundError as error:
        raise _not_installed(error) from error
    except errors.LocalTokenNotFoundError as error:
        raise ConfigError(f"there is no token of the Hugging Face Hub on this machine; {LOG_IN}") from error
    except errors.HFValidationError as error:
        raise ConfigError(f"'{repo_id}' is no name of a repository; give OWNER/NAME") from error
    except errors.RepositoryNotFoundError as error:
        way_out = "check its name, and log in if it is private: hf auth login"
        raise ConfigError(f"the Hub shows you no repository '{repo_id}'; {way_out}") from error
    except errors.HfHubHTTPError as error:
        status = error.response.status_code
        reason = f"{status}, {error.server_message or error.response.reason_phrase}"
        way_out = LOG_IN if status in (401, 403) else "try again later"
        raise ConfigError(f"the Hub refuses '{repo_id}' ({reason}); {way_out}") from error
    except (httpx.HTTPError, errors.OfflineModeIsEnabled, errors.LocalEntryNotFoundError) as error:
        cause = error.__cause__ or error
        reason = f"{type(cause).__name__}: {(str(cause).splitlines() or ['no reason given'])[0]}"
        raise ConfigError(
            f"cannot reach the Hub ({reason}); check the network, and that HF_HUB_OFFLINE is 0"
        ) from error
    except OSError as error:
        way_out = "see to the space and the permissions of the folder for temporary files (TMPDIR)"
        raise ConfigError(f"cannot write what the Hub sends ({error.strerror or error}); {way_out}") from error


def _not_installed(error: ModuleNotFoundError) -> ConfigError:
    return ConfigError(f'the Hub needs {error.name}; install it with: pip install "sb3_stereo[hub]"')


def check_login(repo_id: str) -> None:
    """Raise a ConfigError unless the Hub knows who this is: before minutes of evaluation, not after them."""
    with hub_errors(repo_id):
        from huggingface_hub import HfApi

        HfApi().whoami()


def pack(folder: Path, run: Path, config: Config, model: Path, result: Evaluation, repo_id: str) -> None:
    """Write a repository's files into a folder.

    Args:
        folder: Exists; may hold the video already.
        run: The run's directory.
        config: Its configuration.
        model: Which of its models.
        result: The model's scores.
        repo_id: The repository's name, for the model card.

    Raises:
        ConfigError: If the run's record cannot be read.
    """
    name = _model_name(config.algo, config.env_id)
    records = arguments_file(run).parent
    shutil.copyfile(model, folder / name.filename)
    if (model.name, sha256(model)) in checksums(run):  # not one that --trust alone has loaded
        write_checksums(folder, [(name.filename, sha256(model))])
    shutil.copyfile(records / CONFIG, folder / CONFIG)
    if (records / VERSIONS).is_file():
        shutil.copyfile(records / VERSIONS, folder / VERSIONS)
    texts = {ARGUMENTS: shareable(read_record(run).args), ENV_KWARGS: dict(config.env_kwargs)}
    for file, content in texts.items():
        write(folder / file, yaml.safe_dump(content, sort_keys=False).encode())
    with zipfile.ZipFile(folder / METRICS, "w", zipfile.ZIP_DEFLATED) as archive:
        for table in sorted(run.glob("*.csv")):
            archive.write(table, table.name)
    scores = {key: None if value != value else value for key, value in result.scores().items()}  # NaN is no JSON
    rewards = {"mean_reward": float(result.returns.mean()), "std_reward": float(result.returns.std())}
    write(folder / RESULTS, (json.dumps(rewards | scores, indent=1) + "\n").encode())
    card = model_card(config, result, repo_id, has_film=(folder / REPLAY).is_file())
    write(folder / "README.md", card.encode())
    if has_env_file(config.env_id):
        write(folder / ENV_FILE, env_file(repo_id, config.env_id, config.env_kwargs).encode())


def push(folder: Path, repo_id: str, message: str, private: bool = False) -> str:
    """Upload a folder in one commit, into a new repository or over an old one; return its address.

    Raises:
        ConfigError: If the Hub refuses, or cannot be reached.
    """
    with hub_errors(repo_id):
        from huggingface_hub import HfApi

        api = HfApi()
        url = api.create_repo(repo_id, private=private, exist_ok=True)
        api.upload_folder(repo_id=repo_id, folder_path=folder, commit_message=message)
    return str(url)


def fetch(repo_id: str, log_folder: str, trust: bool = False) -> Path:
    """Download a repository's run into a log folder; nothing in it is run.

    Args:
        repo_id: The repository.
        log_folder: Where it becomes the next run of its algorithm and environment.
        trust: Take a model without a checksum, too, which the commands load only with --trust.

    Returns:
        The run's directory.

    Raises:
        ConfigError: If the Hub does not give it, or it is no run that `push_to_hub` has uploaded.
    """
    with tempfile.TemporaryDirectory() as scratch:
        source = _Download(repo_id, Path(scratch) / "record")
        for file in (ARGUMENTS, CONFIG):
            source.get(file, MAX_RECORD)
        config, _ = load_record(scratch)
        name, model = env_name(config.env_id), str(_model_name(config.algo, config.env_id).filename)
        source.get(model, MAX_MODEL)
        digest = source.checked_digest(model, trust)
        for file, limit in ((VERSIONS, MAX_RECORD), (METRICS, MAX_SCORES)):
            source.get(file, limit, optional=True)

        def fill(draft: Path) -> None:
            for file in (ARGUMENTS, CONFIG, VERSIONS):
                if source.has(file):
                    shutil.copyfile(source.folder / file, draft / name / file)
            write(draft / name / STATUS, yaml.safe_dump(ENDED).encode())
            write(draft / name / LOCK, b"")
            shutil.copyfile(source.folder / model, draft / f"{name}.zip")
            write_checksums(draft, [(f"{name}.zip", digest)] if digest else [])
            if source.has(METRICS):
                write(draft / EVALUATIONS, _evaluations(source.folder / METRICS))

        return publish_run(log_folder, config.algo, name, fill)


def _evaluations(file: Path) -> bytes:
    try:
        with file.open("rb") as stream, open_zip(stream) as archive:
            return read_member(archive, EVALUATIONS, MAX_SCORES)
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise ConfigError(f"cannot read the repository's '{METRICS}' ({error}); ask its owner to push again") from error


class _Download:
    """Files of one commit of a repository.

    Args:
        repo_id: The repository.
        folder: Where its files go.
    """

    def __init__(self, repo_id: str, folder: Path) -> None:
        self.repo_id, self.folder = repo_id, folder
        with hub_errors(repo_id):
            from huggingface_hub import HfApi

            info = HfApi().model_info(repo_id, files_metadata=True)
        self._commit = info.sha
        self._sizes = {file.rfilename: file.size or 0 for file in info.siblings or []}

    def has(self, file: str) -> bool:
        """Whether the repository has the file."""
        return file in self._sizes

    def get(self, file: str, limit: int, optional: bool = False) -> None:
        """Download a file of at most `limit` bytes."""
        if not self.has(file):
            if optional:
                return
            found = ", ".join(sorted(self._sizes)) or "none"
            raise ConfigError(
                f"'{self.repo_id}' has no '{file}', so push_to_hub has not made it; its files are: {found}"
            )
        if self._sizes[file] > limit:
            size = f"{self._sizes[file] / MIB:.0f} MiB, and at most {limit // MIB} are taken"
            raise ConfigError(f"'{file}' of '{self.repo_id}' has {size}; ask its owner for a smaller one")
        with hub_errors(self.repo_id):
            from huggingface_hub import hf_hub_download

            hf_hub_download(self.repo_id, file, revision=self._commit, local_dir=self.folder)

    def checked_digest(self, model: str, trust: bool) -> str | None:
        """Return the downloaded model's digest, None if the repository does not name it."""
        if self.has(CHECKSUMS):
            self.get(CHECKSUMS, MAX_RECORD)
        digest = sha256(self.folder / model)
        if (model, digest) in checksums(self.folder):
            return digest
        if trust:
            return None
        raise ConfigError(
            f"{CHECKSUMS} of '{self.repo_id}' does not name its '{model}', so that no run has saved it as it is; "
            "if you trust who made it, add --trust, here and wherever you load it, which may run code that is in it"
        )
