"""A run goes to the Hugging Face Hub and comes back as it was; what comes from strangers is only read."""

import errno
import io
import json
import shutil
import sys
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fake_reach
import pytest
import yaml
from comparing import assert_same
from fake_hub import TOKEN, FakeHub
from tiny_training import QUICK, tiny_config

from sb3_stereo.commands import enjoy, evaluate, load_from_hub, push_to_hub, train
from sb3_stereo.runs.directory import load_record, model_path
from sb3_stereo.runs.models import load_model
from sb3_stereo.runs.pretrained import pretrained_run
from sb3_stereo.sharing import hub as hub_module
from sb3_stereo.training.trainer import Options
from sb3_stereo.training.trainer import train as train_run

huggingface_hub = pytest.importorskip("huggingface_hub", reason='pip install -e ".[hub]"')
pytest.importorskip("huggingface_sb3", reason='pip install -e ".[hub]"')

NAME = "me/ddpg-FakeReach-v0"
PUSH = [*QUICK, "--no-render"]
LOG_IN = "log in with: hf auth login (or set HF_TOKEN), with a token that may write"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that has ended."""
    logs = tmp_path_factory.mktemp("made")
    return train_run(tiny_config(), Options(seed=1, log_folder=str(logs), device="cpu", verbose=0)).run


@contextmanager
def logged_in() -> Iterator[FakeHub]:
    """The Hub, on which this machine is logged in."""
    fake = FakeHub(huggingface_hub.utils.httpx)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HF_TOKEN", TOKEN)
        huggingface_hub.set_client_factory(fake.client)
        yield fake
    huggingface_hub.set_client_factory(huggingface_hub.utils._http.default_client_factory)


@pytest.fixture
def hub() -> Iterator[FakeHub]:
    """The Hub without repositories."""
    with logged_in() as fake:
        yield fake


@pytest.fixture(scope="module")
def repository(made: Path) -> tuple[dict[str, bytes], list[str]]:
    """The files of the run's repository, and the messages of its commits."""
    with logged_in() as fake:
        assert push_to_hub.main([str(made), "--repo-id", NAME, *PUSH]) == 0
        assert list(fake.repositories) == [NAME] and not fake.private
        return fake.repositories[NAME], fake.messages


@pytest.fixture
def pushed(hub: FakeHub, repository: tuple[dict[str, bytes], list[str]]) -> FakeHub:
    """The Hub with the run on it."""
    files, messages = repository
    hub.repositories[NAME], hub.messages = dict(files), list(messages)
    return hub


def load(logs: Path, *flags: str) -> int:
    return load_from_hub.main(["--repo-id", NAME, "-f", str(logs), *flags])


def test_a_run_comes_back_as_it_was(pushed: FakeHub, made: Path, logs: Path) -> None:
    assert load(logs) == 0
    run = logs / "ddpg" / "FakeReach-v0_1"
    (config, args), (original, _) = load_record(run), load_record(made)
    assert config == original and args["log_folder"] == "logs"
    assert model_path(run, config.env_id).read_bytes() == model_path(made, config.env_id).read_bytes()
    assert (run / "evaluations.csv").read_bytes() == (made / "evaluations.csv").read_bytes()
    assert_same(
        load_model(config, model_path(run, config.env_id), "cpu").policy.state_dict(),
        load_model(original, model_path(made, config.env_id), "cpu").policy.state_dict(),
    )


def test_every_command_takes_what_was_downloaded(
    pushed: FakeHub, logs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert load(logs) == load(logs) == 0, "the second one is the next run"
    assert str(logs / "ddpg" / "FakeReach-v0_2") in capsys.readouterr().out
    run = logs / "ddpg" / "FakeReach-v0_2"
    where = ["--env", fake_reach.ENV_ID, "-f", str(logs)]
    assert enjoy.main([*where, "--no-render", "--n-episodes", "2", *QUICK]) == 0
    assert evaluate.main([str(run), "--poses", "2", "--n-envs", "1", *QUICK]) == 0
    warm_start = ["-i", str(model_path(run, fake_reach.ENV_ID)), "-n", "12", "--eval-freq", "-1", "--n-eval-envs", "1"]
    assert train.main([*where, *warm_start, *QUICK, "-params", "learning_starts:10", "batch_size:4",
                       "policy_kwargs.features_extractor_kwargs.n_filters:4"]) == 0  # fmt: skip
    capsys.readouterr()
    assert train.main(["--resume", str(run)]) == 2
    assert "has ended after 30 steps" in capsys.readouterr().err


def test_a_repository_has_the_zoos_files_and_names_no_place_of_this_machine(pushed: FakeHub, made: Path) -> None:
    files = pushed.repositories[NAME]
    zoo = {"ddpg-FakeReach-v0.zip", "config.yml", "args.yml", "env_kwargs.yml", "train_eval_metrics.zip", "README.md"}
    assert set(files) == zoo | {"SHA256SUMS", "versions.yml", "results.json"}
    with zipfile.ZipFile(io.BytesIO(files["train_eval_metrics.zip"])) as archive:
        assert set(archive.namelist()) == {"0.monitor.csv", "evaluations.csv"}
    texts = [content for name, content in files.items() if not name.endswith(".zip")]
    assert not any(str(made.parent).encode() in text for text in texts)
    assert pushed.messages == ["Add a trained agent"]


def test_the_package_of_the_hub_finds_the_model(
    pushed: FakeHub, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from huggingface_sb3 import load_from_hub as load_with_package

    monkeypatch.setenv("TRUST_REMOTE_CODE", "True")
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
    file = Path(load_with_package(NAME, "ddpg-FakeReach-v0.zip"))
    assert file.read_bytes() == (made / "FakeReach-v0.zip").read_bytes()


def test_the_card_lists_the_scores_of_the_model_and_how_to_load_it(pushed: FakeHub) -> None:
    card = huggingface_hub.ModelCard(pushed.repositories[NAME]["README.md"].decode())
    scores = json.loads(pushed.repositories[NAME]["results.json"])
    listed = {result.metric_type: result.metric_value for result in card.data.eval_results}
    assert listed["success_rate"] == f"{scores['success_rate']:.2f}"
    assert listed["mean_reward"] == f"{scores['mean_reward']:.2f} +/- {scores['std_reward']:.2f}"
    assert scores["n_poses"] == 100 and "replay.mp4" not in card.text
    for command in re_commands(card.text):
        words = command.split()
        assert words[:3] == ["python", "-m", "sb3_stereo"]
        parser: Any = sys.modules[f"sb3_stereo.commands.{words[3]}"].make_parser()  # type: ignore[attr-defined]
        parser.parse_args(words[4:])


def re_commands(text: str) -> list[str]:
    found = [line[2:] for line in text.splitlines() if line.startswith("$ ")]
    assert len(found) == 3
    return found


def test_an_owner_alone_gives_the_zoos_name(hub: FakeHub, made: Path, logs: Path) -> None:
    where = ["--env", fake_reach.ENV_ID, "-f", str(made.parents[1]), "-orga", "me"]
    assert push_to_hub.main([*where, "-m", "First", "--private", *PUSH]) == 0
    assert list(hub.repositories) == [NAME] and hub.private == {NAME} and hub.messages == ["First"]
    assert push_to_hub.main([*where, "-name", "other", *PUSH]) == 0
    assert set(hub.repositories) == {NAME, "me/other"}
    assert load_from_hub.main(["--env", fake_reach.ENV_ID, "-orga", "me", "-f", str(logs)]) == 0


@pytest.mark.slow
def test_the_agent_that_ships_is_filmed_and_uploaded(hub: FakeHub, logs: Path) -> None:
    pytest.importorskip("imageio_ffmpeg", reason='pip install -e ".[film]"')
    run = pretrained_run("ddpg", "WamStereoReach-v1")
    flags = ["--repo-id", "me/wam", "--n-episodes", "1", "--num-threads", "1"]
    assert push_to_hub.main([str(run), *flags]) == 0
    assert hub.repositories["me/wam"]["replay.mp4"][4:8] == b"ftyp"
    assert load_from_hub.main(["--repo-id", "me/wam", "-f", str(logs)]) == 0
    assert enjoy.main(["-f", str(logs), "--no-render", "--n-episodes", "1", "--num-threads", "1"]) == 0


def out_of_reach(hub: FakeHub, monkeypatch: pytest.MonkeyPatch) -> None:
    httpx = huggingface_hub.utils.httpx

    def fail(request: Any) -> Any:
        raise httpx.ConnectError("[Errno 101] Network is unreachable", request=request)

    huggingface_hub.set_client_factory(lambda: httpx.Client(transport=httpx.MockTransport(fail)))


def logged_out(hub: FakeHub, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HF_TOKEN")
    monkeypatch.setattr(huggingface_hub.constants, "HF_TOKEN_PATH", "/nonexistent")


PUSHES: dict[str, tuple[str, Callable[[FakeHub, pytest.MonkeyPatch], None], str]] = {
    "no token": (NAME, logged_out, f"there is no token of the Hugging Face Hub on this machine; {LOG_IN}"),
    "a wrong token": (
        NAME,
        lambda hub, patch: patch.setenv("HF_TOKEN", "hf_wrong"),
        f"the Hub refuses '{NAME}' (401, Unauthorized); {LOG_IN}",
    ),
    "another's repository": (
        "others/reach",
        lambda hub, patch: None,
        f"the Hub refuses 'others/reach' (403, You don't have the rights to create a model there); {LOG_IN}",
    ),
    "no network": (
        NAME,
        out_of_reach,
        "cannot reach the Hub (ConnectError: [Errno 101] Network is unreachable); check the network, and that "
        "HF_HUB_OFFLINE is 0",
    ),
    "no name": ("me/a/b", lambda hub, patch: None, "'me/a/b' is no name of a repository; give OWNER/NAME"),
}


@pytest.mark.parametrize("case", list(PUSHES))
def test_a_push_that_fails_is_one_sentence_and_uploads_nothing(
    case: str, hub: FakeHub, made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    name, prepare, sentence = PUSHES[case]
    prepare(hub, monkeypatch)
    assert push_to_hub.main([str(made), "--repo-id", name, *PUSH, "--verbose", "0"]) == 2
    assert capsys.readouterr().err == f"error: {sentence}\n"
    assert not hub.repositories


def test_a_repository_must_be_named(hub: FakeHub, made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert push_to_hub.main([str(made), *PUSH]) == 2
    assert capsys.readouterr().err == (
        "error: which repository? give --repo-id OWNER/NAME, or the owner alone with -orga\n"
    )


def full_disk(*_: Any, **__: Any) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def replaced(hub: FakeHub, **files: bytes) -> None:
    hub.repositories[NAME] |= {name.replace("__", "."): content for name, content in files.items()}


def with_changed_args(hub: FakeHub, **changes: Any) -> None:
    content = yaml.safe_load(hub.repositories[NAME]["args.yml"]) | changes
    replaced(hub, args__yml=yaml.safe_dump(content).encode())


MODEL = "ddpg-FakeReach-v0.zip"
LOADS: dict[str, tuple[Callable[[FakeHub, pytest.MonkeyPatch], Any], str]] = {
    "no such repository": (
        lambda hub, patch: hub.repositories.clear(),
        f"the Hub shows you no repository '{NAME}'; check its name, and log in if it is private: hf auth login",
    ),
    "no network": (
        out_of_reach,
        "cannot reach the Hub (ConnectError: [Errno 101] Network is unreachable); check the network, and that "
        "HF_HUB_OFFLINE is 0",
    ),
    "a full disk": (
        lambda hub, patch: patch.setattr(huggingface_hub, "hf_hub_download", full_disk),
        "cannot write what the Hub sends (No space left on device); see to the space and the permissions of the folder "
        "for temporary files (TMPDIR)",
    ),
    "no run": (
        lambda hub, patch: hub.repositories.update({NAME: {"model.safetensors": b""}}),
        f"'{NAME}' has no 'args.yml', so push_to_hub has not made it; its files are: model.safetensors",
    ),
    "another model": (
        lambda hub, patch: replaced(hub, **{MODEL: b"changed"}),
        f"SHA256SUMS of '{NAME}' does not name its '{MODEL}', so that no run has saved it as it is; if you trust who "
        "made it, add --trust, here and wherever you load it, which may run code that is in it",
    ),
    "a large record": (
        lambda hub, patch: replaced(hub, config__yml=bytes(3 * 2**20)),
        f"'config.yml' of '{NAME}' has 3 MiB, and at most 1 are taken; ask its owner for a smaller one",
    ),
    "scores that are none": (
        lambda hub, patch: replaced(hub, train_eval_metrics__zip=b"no zip"),
        "cannot read the repository's 'train_eval_metrics.zip' (it is not a whole zip file); ask its owner to push "
        "again",
    ),
    "an algorithm that leads elsewhere": (
        lambda hub, patch: with_changed_args(hub, algo="../../elsewhere"),
        "unknown algorithm '../../elsewhere'; allowed are: crossq, ddpg, dqn, ppo, sac, td3, tqc",
    ),
}


@pytest.mark.parametrize("case", list(LOADS))
def test_what_is_no_run_of_ours_is_one_sentence_and_leaves_nothing(
    case: str, pushed: FakeHub, logs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    prepare, sentence = LOADS[case]
    prepare(pushed, monkeypatch)
    capsys.readouterr()
    assert load(logs) == 2
    assert capsys.readouterr().err == f"error: {sentence}\n"
    assert not list(logs.glob("*/*"))


def test_a_stranger_s_package_is_not_imported(
    pushed: FakeHub, logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "code_of_a_hub_stranger.py").write_text("raise SystemExit('executed')")
    monkeypatch.syspath_prepend(str(tmp_path))
    with_changed_args(pushed, env="Nowhere-v0", gym_packages=["code_of_a_hub_stranger"])
    capsys.readouterr()
    assert load(logs) == 2
    assert "if you trust its record, add --gym-packages code_of_a_hub_stranger" in capsys.readouterr().err
    assert "code_of_a_hub_stranger" not in sys.modules


def test_a_model_without_a_checksum_needs_trust_wherever_it_goes(
    pushed: FakeHub, logs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    del pushed.repositories[NAME]["SHA256SUMS"]
    assert load(logs) == 2
    assert load(logs, "--trust") == 0
    assert "enjoy --algo ddpg --env FakeReach-v0" in (printed := capsys.readouterr().out)
    assert printed.endswith(" --trust\n")
    run = str(logs / "ddpg" / "FakeReach-v0_1")
    flags = [run, "--poses", "1", "--n-envs", "1", *QUICK]
    assert evaluate.main(flags) == 2
    assert "is not from a run: no SHA256SUMS beside it names it" in capsys.readouterr().err
    assert evaluate.main([*flags, "--trust"]) == 0


def test_a_changed_model_stays_without_a_checksum_on_the_hub(hub: FakeHub, made: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(made, tmp_path / "run"))
    (run / "SHA256SUMS").unlink()
    assert push_to_hub.main([str(run), "--repo-id", NAME, *PUSH]) == 2
    assert push_to_hub.main([str(run), "--repo-id", NAME, *PUSH, "--trust"]) == 0
    assert "SHA256SUMS" not in hub.repositories[NAME]


@pytest.mark.parametrize("missing", ["huggingface_hub", "huggingface_sb3"])
def test_a_missing_package_is_named_with_its_extra(
    missing: str, made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    assert push_to_hub.main([str(made), "-orga", "me", *PUSH]) == 2
    assert (
        capsys.readouterr().err == f'error: the Hub needs {missing}; install it with: pip install "sb3_stereo[hub]"\n'
    )


def test_the_zoos_flags_are_known() -> None:
    zoo = ["--algo", "ddpg", "--env", "E", "-f", "logs", "-orga", "o", "-name", "n"]
    args = push_to_hub.make_parser().parse_args([*zoo, "--exp-id", "3", "-m", "text", "--no-render", "--load-best"])
    assert (args.organization, args.repo_name, args.commit_message, args.exp_id) == ("o", "n", "text", 3)
    assert load_from_hub.make_parser().parse_args(zoo).repo_name == "n"
    assert hub_module.repository("ddpg", "Space/Reach-v0", "o", None) == "o/ddpg-Space-Reach-v0"
