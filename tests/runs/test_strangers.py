"""Whatever a run directory from elsewhere holds: it is only read, in little memory, and refused in one sentence."""

import io
import pickle
import shutil
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fake_reach
import pytest
import torch as th
import yaml
from memory import takes_less_than
from tiny_training import tiny_config

from sb3_stereo.commands import evaluate
from sb3_stereo.commands import train as train_cli
from sb3_stereo.config import modules
from sb3_stereo.config.schema import Config, load_config
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation import curves
from sb3_stereo.runs.directory import load_record
from sb3_stereo.runs.files import sha256
from sb3_stereo.runs.models import CHECKSUMS, load_model, load_weights, untrained_model
from sb3_stereo.training.trainer import Options, train

MIB = 2**20


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that has ended."""
    logs = tmp_path_factory.mktemp("made")
    return train(tiny_config(), Options(seed=1, log_folder=str(logs), save_freq=8, device="cpu", verbose=0)).run


@pytest.fixture
def run(made: Path, tmp_path: Path) -> Path:
    """A copy of it, to be damaged."""
    return Path(shutil.copytree(made, tmp_path / "logs" / "ddpg" / made.name))


def config(run: Path) -> Config:
    return load_config("ddpg", fake_reach.ENV_ID, params=yaml.safe_load((run / "FakeReach-v0/config.yml").read_text()))


def saved(content: Any) -> bytes:
    buffer = io.BytesIO()
    th.save(content, buffer)
    return buffer.getvalue()


def part(run: Path, name: str = "policy.pth") -> Any:
    with zipfile.ZipFile(run / "FakeReach-v0.zip") as archive:
        return th.load(io.BytesIO(archive.read(name)), weights_only=True)


def replace_part(run: Path, name: str, content: bytes, compression: int = zipfile.ZIP_STORED) -> None:
    """Replace a member of the model, and the model's checksum."""
    path = run / "FakeReach-v0.zip"
    with zipfile.ZipFile(path) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()} | {name: content}
    with zipfile.ZipFile(path, "w", compression) as archive:
        for member, data in members.items():
            archive.writestr(member, data)
    (run / CHECKSUMS).write_text(f"{sha256(path)}  {path.name}\n")


def repacked(content: bytes, change: Callable[[str, bytes], bytes], compression: int = zipfile.ZIP_STORED) -> bytes:
    """Return a file of PyTorch's with its members changed."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(buffer, "w", compression) as new:
        for info in old.infolist():
            new.writestr(info.filename, change(info.filename, old.read(info)))
    return buffer.getvalue()


def with_zeros(name: str, data: bytes) -> bytes:
    return data + bytes(100 * MIB) if name.endswith("/data/0") else data


class Call:
    """Pickled as a call of a function."""

    def __init__(self, function: Callable[..., Any], *arguments: Any) -> None:
        self.call = function, arguments

    def __reduce__(self) -> Any:
        return self.call


def laugh(depth: int = 30) -> list[Any]:
    value: list[Any] = [0] * 9
    for _ in range(depth):
        value = [value] * 9
    return value


def moments(run: Path, **changes: Any) -> bytes:
    """The actor's optimizer with changes of what it keeps for the first weight."""
    content = part(run, "actor.optimizer.pth")
    content["state"][0] |= changes
    return saved(content)


def group(run: Path, **changes: Any) -> bytes:
    content = part(run, "actor.optimizer.pth")
    content["param_groups"][0] |= changes
    return saved(content)


def first(run: Path, change: Callable[[th.Tensor], Any]) -> bytes:
    """The networks with a change of the first weight."""
    content = part(run)
    name = next(iter(content))
    return saved({**content, name: change(content[name])})


POLICY: dict[str, Callable[[Path], tuple[bytes, str]]] = {
    "deflated inside": lambda run: (
        repacked(saved(part(run)), with_zeros, zipfile.ZIP_DEFLATED),
        "in 'policy.pth': it is compressed inside, which PyTorch's files are not",
    ),
    "a call that fills the memory": lambda run: (
        saved({"a": Call(bytearray, 10**10)}),
        "in 'policy.pth': it holds more than tensors and plain values ('__builtin__.bytearray')",
    ),
    "an old-style pickle": lambda run: (pickle.dumps({}), "in 'policy.pth': it is not a whole zip file"),
    "a list": lambda run: (saved([1, 2]), "the networks must be a map, not of type list"),
    "nothing": lambda run: (saved(None), "the networks must be a map, not of type NoneType"),
    "numbers for names": lambda run: (saved({1: 2}), "the networks lack"),
    "a text for a weight": lambda run: (
        first(run, lambda _: "zero"),
        "is of type str, and these networks have float32",
    ),
    "another shape": lambda run: (first(run, lambda old: old.flatten().clone()), ", and these networks have float32 ["),
    "another kind of number": lambda run: (first(run, lambda old: old.double()), "is float64 [1, 20, 20], and"),
    "an expanded weight": lambda run: (
        first(run, lambda old: th.zeros(1).expand(old.shape)),
        "in 'policy.pth': it has a tensor that claims the shape (1, 20, 20)",
    ),
    "billions of lists": lambda run: (saved(laugh()), "in 'policy.pth': the same lists or maps occur in it again"),
    "text that is none": lambda run: (
        repacked(saved({"a": 1}), lambda name, data: data.replace(b"a", b"\xff") if "data.pkl" in name else data),
        "in 'policy.pth': it is damaged",
    ),
}


def refusal(run: Path) -> str:
    with pytest.raises(ConfigError) as caught:
        load_model(config(run), run / "FakeReach-v0.zip", "cpu")
    return str(caught.value)


@pytest.mark.parametrize("attack", list(POLICY))
def test_networks_that_are_no_state_of_the_model_are_one_sentence(attack: str, run: Path) -> None:
    content, reason = POLICY[attack](run)
    replace_part(run, "policy.pth", content)
    with takes_less_than(30):
        sentence = refusal(run)
    assert sentence.startswith(f"cannot load '{run / 'FakeReach-v0.zip'}': ") and reason in sentence
    assert sentence.endswith("; choose a model of the same settings")


OPTIMIZER: dict[str, Callable[[Path], tuple[bytes, str]]] = {
    "expanded": lambda run: (
        moments(run, exp_avg=th.zeros(1, dtype=th.float64).expand(20_000_000)),
        "in 'actor.optimizer.pth': it has a tensor that claims the shape (20000000,) and is smaller",
    ),
    "another shape": lambda run: (moments(run, exp_avg=th.zeros(3)), "'exp_avg' of parameter 0 must be a number each"),
    "a text": lambda run: (moments(run, exp_avg="zero"), "'exp_avg' of parameter 0 must be a number each"),
    "an unknown name": lambda run: (moments(run, evil=1), "an optimizer's state has an unknown 'evil'"),
    "a list": lambda run: (saved([]), "an optimizer must be a map, not of type list"),
    "no groups": lambda run: (saved({"state": {}, "param_groups": []}), "an optimizer has not 1 groups of parameters"),
    "another setting": lambda run: (group(run, evil=1), "an optimizer's group has an unknown 'evil'"),
    "a text for a number": lambda run: (group(run, lr="fast"), "an optimizer's 'lr' must be a number, not of type str"),
    "other parameters": lambda run: (group(run, params=[9, *range(1, 10)]), "an optimizer is of other parameters"),
}


@pytest.mark.parametrize("attack", list(OPTIMIZER))
def test_an_optimizer_is_read_only_where_something_is_trained_and_must_be_the_models(attack: str, run: Path) -> None:
    content, reason = OPTIMIZER[attack](run)
    replace_part(run, "actor.optimizer.pth", content)
    load_model(config(run), run / "FakeReach-v0.zip", "cpu")
    model = untrained_model(config(run), "cpu", seed=5)
    before = {name: tensor.clone() for name, tensor in model.policy.state_dict().items()}
    with takes_less_than(30), pytest.raises(ConfigError) as caught:
        load_weights(model, run / "FakeReach-v0.zip")
    assert reason in str(caught.value)
    assert all(th.equal(tensor, before[name]) for name, tensor in model.policy.state_dict().items()), "all or nothing"


@pytest.mark.parametrize("compression", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_compressions_than_sb3s_are_refused(compression: int, run: Path) -> None:
    replace_part(run, "policy.pth", bytes(50 * MIB), compression)
    assert refusal(run) == (
        f"cannot load '{run / 'FakeReach-v0.zip'}': 'policy.pth' is compressed in another way than SB3's files, or "
        "encrypted; choose a model of the same settings"
    )


def test_a_size_that_lies_is_found_while_the_member_is_unpacked(run: Path) -> None:
    path = run / "FakeReach-v0.zip"
    replace_part(run, "policy.pth", bytes(100 * MIB), zipfile.ZIP_DEFLATED)
    content = path.read_bytes().replace((100 * MIB).to_bytes(4, "little"), (1000).to_bytes(4, "little"))
    path.write_bytes(content)
    (run / CHECKSUMS).write_text(f"{sha256(path)}  {path.name}\n")
    with takes_less_than(30):
        assert "'policy.pth' is damaged (Bad CRC-32 for file 'policy.pth')" in refusal(run)


def test_settings_that_ask_for_more_than_the_file_holds_make_no_networks(run: Path) -> None:
    file = run / "FakeReach-v0/config.yml"
    content = yaml.safe_load(file.read_text())
    content["policy_kwargs"]["net_arch"] = [30_000, 30_000, 30_000]
    file.write_text(yaml.safe_dump(content))
    limit = (4 * (run / "FakeReach-v0.zip").stat().st_size + 64 * MIB) / 1e6
    with takes_less_than(300):
        sentence = refusal(run)
    assert sentence == (
        f"the settings of '{run / 'FakeReach-v0.zip'}' ask for networks of more than {limit:.0f} MB, which it does not "
        "hold; choose a model of the same settings"
    )


@pytest.fixture
def stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A module in the current folder, where Python finds it; it must not be imported."""
    folder = tmp_path / "unpacked"
    folder.mkdir()
    (folder / "strangers_code.py").write_text("import pathlib\npathlib.Path('executed').touch()\nclass Policy: pass\n")
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(sys.modules, "strangers_code", raising=False)
    return "strangers_code"


def change(file: Path, **changes: Any) -> None:
    file.write_text(yaml.safe_dump({**yaml.safe_load(file.read_text()), **changes}))


def test_packages_of_a_record_are_not_imported(stranger: str, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    change(run / "FakeReach-v0" / "args.yml", gym_packages=["fake_reach", stranger])
    assert evaluate.main([str(run), "--poses", "1", "--num-threads", "1", "--n-envs", "1", "--verbose", "0"]) == 0
    assert train_cli.main(["--resume", str(run)]) == 2
    assert f"'{run}' has ended after 30 steps" in capsys.readouterr().err
    assert not Path("executed").exists()


def test_a_run_of_an_unknown_environment_names_the_packages_to_ask_for(stranger: str, run: Path) -> None:
    change(run / "FakeReach-v0" / "args.yml", gym_packages=["fake_reach", stranger], env="Nowhere-v0")
    with pytest.raises(ConfigError) as caught:
        load_record(run)
    assert str(caught.value) == (
        f"'{run}' is of the environment 'Nowhere-v0', which no imported package registers; if you trust its record, "
        "add --gym-packages fake_reach strangers_code"
    )
    assert not Path("executed").exists()


KEYS: dict[str, Any] = {
    "policy": "strangers_code.Policy",
    "callback": "strangers_code.Policy",
    "env_wrapper": [{"strangers_code.Policy": {}}],
    "replay_buffer_class": "strangers_code.Policy",
    "policy_kwargs": {"features_extractor_class": "strangers_code.Policy"},
}


@pytest.mark.parametrize("key", list(KEYS))
def test_classes_of_modules_that_nobody_named_are_not_imported(
    key: str, stranger: str, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    change(run / "FakeReach-v0" / "config.yml", **{key: KEYS[key]})
    with pytest.raises(ConfigError) as caught:
        load_record(run)
    assert str(caught.value).endswith(
        f": '{stranger}' is not imported because a file names it; if you trust it, add --gym-packages {stranger}"
    )
    assert not Path("executed").exists()
    monkeypatch.setattr(modules, "_named", set())
    modules.import_packages([stranger])
    with pytest.raises(ConfigError, match="is not a subclass of"):
        load_record(run)
    assert Path("executed").exists()


def test_a_yaml_file_imports_only_what_is_named_too(stranger: str) -> None:
    with pytest.raises(ConfigError, match="is not imported because a file names it"):
        load_config("ddpg", fake_reach.ENV_ID, params={"policy": f"{stranger}.Policy"})
    assert not Path("executed").exists()


def test_resuming_finds_packages_wherever_one_stands_but_not_in_the_current_folder(
    stranger: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "users_code.py").write_text("")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert modules.is_installed("users_code") and not modules.is_installed(stranger)
    assert not modules.is_installed("antigravity"), "what opens a browser"
    assert not modules.is_installed("..")
    monkeypatch.setattr(modules, "_named", set())
    modules.import_installed(["users_code", stranger, "antigravity", ".."])
    assert "users_code" in sys.modules and stranger not in sys.modules
    assert sys.path[:2] == [str(tmp_path), str(tmp_path / "unpacked")], "the search path is as before"


def test_a_plot_needs_no_packages(stranger: str, run: Path) -> None:
    change(run / "FakeReach-v0" / "args.yml", gym_packages=[stranger], env="Nowhere-v0")
    assert curves.readable_runs([run]) == ([run], [])
    assert [group.label for group in curves.group_runs([run])] == ["ddpg (1 run)"]
    assert not Path("executed").exists()


RECORDS: dict[str, tuple[str, Callable[[str], str | bytes], str]] = {
    "an empty file": ("args.yml", lambda text: "", "TypeError"),
    "a list": ("config.yml", lambda text: "[1, 2]", "TypeError"),
    "a number": ("config.yml", lambda text: "7", "TypeError"),
    "no algorithm": ("args.yml", lambda text: text.replace("algo: ddpg\n", ""), "KeyError"),
    "a list for the algorithm": ("args.yml", lambda text: text.replace("algo: ddpg", "algo: [ddpg]"), "TypeError"),
    "packages that are a number": ("args.yml", lambda text: f"{text}gym_packages: 3\n", "TypeError"),
    "packages that are numbers": ("args.yml", lambda text: f"{text}gym_packages: [3]\n", "TypeError"),
    "numbers for names": ("config.yml", lambda text: f"{text}3: 4\n", "TypeError"),
    "not UTF-8": ("args.yml", lambda text: b"\xff\xfe", "UnicodeDecodeError"),
    "a date that is none": ("config.yml", lambda text: f"{text}gamma: 2020-99-99\n", "ValueError"),
    "no YAML": ("config.yml", lambda text: "{", "ValueError"),
    "aliases": (
        "config.yml",
        lambda text: (
            "a: &a [x,x,x,x,x,x,x,x,x]\n"
            + "".join(f"{b}: &{b} [{','.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True))
        ),
        "ValueError",
    ),
}


@pytest.mark.parametrize("damage", list(RECORDS))
def test_a_damaged_record_is_one_sentence(damage: str, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name, damaged, error = RECORDS[damage]
    file = run / "FakeReach-v0" / name
    content = damaged(file.read_text())
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    for main, argv in ((evaluate.main, [str(run)]), (train_cli.main, ["--resume", str(run)])):
        assert main(argv) == 2
        message = capsys.readouterr().err
        assert message == f"error: '{run / 'FakeReach-v0'}' is not the record of a training ({error})\n"


class Stopped(Exception):
    """As a kill would."""


def stop(run: Path) -> None:
    raise Stopped


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was killed, with a snapshot."""
    logs = tmp_path_factory.mktemp("stopped")
    options = Options(seed=1, log_folder=str(logs), save_freq=8, eval_freq=20, device="cpu", verbose=0)
    with pytest.raises(Stopped):
        train(tiny_config(), options, on_evaluation=stop)
    return next((logs / "ddpg").iterdir())


@pytest.fixture
def unfinished(stopped: Path, tmp_path: Path) -> Path:
    """A copy of it, to be damaged."""
    return Path(shutil.copytree(stopped, tmp_path / "logs" / "ddpg" / stopped.name))


LINKED = [
    "checkpoints",
    "evaluations.csv",
    "0.monitor.csv",
    "SHA256SUMS",
    "best_model.zip",
    "FakeReach-v0.zip",
    "FakeReach-v0",
    "FakeReach-v0/args.yml",
    "FakeReach-v0/lock",
    "FakeReach-v0/status.yml",
    "tensorboard",
]


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("name", LINKED)
@pytest.mark.parametrize("has_ended", [False, True])
def test_nothing_behind_a_link_is_written_cut_or_deleted(
    name: str, has_ended: bool, unfinished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The folder behind it has what the run had, and more."""
    outside, path = tmp_path / "thesis", unfinished / name
    outside.mkdir()
    if has_ended:
        (unfinished / "FakeReach-v0" / "status.yml").write_text("status: ended\n")
    if path.is_dir() or name == "tensorboard":
        shutil.move(path, outside / "folder") if path.is_dir() else (outside / "folder").mkdir()
        (outside / "folder" / "chapter1.tex").write_text("work")
        path.symlink_to(outside / "folder", target_is_directory=True)
    else:
        (outside / "file").write_bytes(path.read_bytes() if path.is_file() and path.stat().st_size else b"work")
        path.unlink(missing_ok=True)
        path.symlink_to(outside / "file")
    before = contents(outside)
    assert train_cli.main(["--resume", str(unfinished)]) == 2
    assert capsys.readouterr().err == (
        f"error: '{path}' is a link, and a training writes there; put what it points to in its place\n"
    )
    assert contents(outside) == before


def test_a_lock_that_is_another_name_of_a_file_is_not_emptied(
    unfinished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "chapter1.tex").write_text("work")
    lock = unfinished / "FakeReach-v0" / "lock"
    lock.unlink()
    lock.hardlink_to(tmp_path / "chapter1.tex")
    assert train_cli.main(["--resume", str(unfinished)]) == 2
    assert capsys.readouterr().err == f"error: '{lock}' holds something, and a run's lock is empty; remove it\n"
    assert (tmp_path / "chapter1.tex").read_text() == "work"


def test_files_that_share_their_bytes_with_others_and_foreign_folders_survive_resuming(
    unfinished: Path, tmp_path: Path
) -> None:
    """As in a copy by `cp -al`."""
    outside = tmp_path / "thesis"
    outside.mkdir()
    for path in [*unfinished.glob("*.csv"), *unfinished.glob("SHA*"), *unfinished.glob("*.zip")]:
        (outside / path.name).hardlink_to(path)
    (unfinished / "checkpoints" / "partial").hardlink_to(unfinished / "evaluations.csv")
    (unfinished / "checkpoints" / ".ipynb_checkpoints").mkdir()
    (unfinished / "checkpoints" / "notes.txt").write_text("mine")
    before = contents(outside)
    assert train_cli.main(["--resume", str(unfinished), "--verbose", "0"]) == 0
    assert contents(outside) == before
    assert sorted(path.name for path in (unfinished / "checkpoints").iterdir()) == [".ipynb_checkpoints", "notes.txt"]


def test_a_tensorboard_folder_of_the_record_that_is_not_the_runs_is_left_alone(
    unfinished: Path, tmp_path: Path
) -> None:
    pytest.importorskip("tensorboard")
    outside = tmp_path / "thesis"
    outside.mkdir()
    (outside / "events.out.tfevents.1.host.1.0").write_text("another's")
    change(unfinished / "FakeReach-v0" / "args.yml", tensorboard=str(outside))
    assert train_cli.main(["--resume", str(unfinished), "--verbose", "0"]) == 0
    assert contents(outside) == {"events.out.tfevents.1.host.1.0": b"another's"}


OPTIONS: dict[str, Any] = {
    "seed": "three",
    "n_eval_envs": [1],
    "save_freq": None,
    "tensorboard": 5,
    "tensorboard_log": ["a"],
    "num_threads": "many",
    "trust": "yes",
    "eval_freq": {"every": 5},
}


@pytest.mark.parametrize("name", list(OPTIONS))
def test_options_of_a_record_that_have_another_type_are_one_sentence(
    name: str, unfinished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change(unfinished / "FakeReach-v0" / "args.yml", **{name: OPTIONS[name]})
    before = contents(unfinished)
    assert train_cli.main(["--resume", str(unfinished)]) == 2
    assert capsys.readouterr().err == (
        f"error: the run's args.yml has {name}: {OPTIONS[name]!r}; write there what it was trained with\n"
    )
    assert contents(unfinished) == before


def test_options_of_a_record_that_are_out_of_range_are_one_sentence(
    unfinished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = unfinished / "FakeReach-v0" / "args.yml"
    for changes, sentence in (
        ({"seed": -1}, "the run's args.yml must have seed of at least 0; write what it was trained with"),
        (
            {"seed": 1, "n_eval_envs": 0},
            "the run's args.yml must have n_eval_envs of at least 1; write what it was trained with",
        ),
        (
            {"n_eval_envs": 1, "vec_env": "cloud"},
            "unknown vec_env in the run's args.yml 'cloud'; allowed are: dummy, subproc",
        ),
    ):
        change(file, **changes)
        assert train_cli.main(["--resume", str(unfinished)]) == 2
        assert capsys.readouterr().err == f"error: {sentence}\n"


def changed_snapshot(run: Path, path: str, value: Any) -> None:
    """Leave one snapshot, with a right digest and a changed value; None of a path removes it."""
    for old in sorted((run / "checkpoints").glob("*.pt"))[:-1]:
        old.unlink()
    (file,) = (run / "checkpoints").glob("*.pt")
    state = th.load(file, weights_only=True)
    *parents, last = path.split("/")
    inner = state
    for key in parents:
        inner = inner[int(key) if isinstance(inner, list | tuple) else key]
    if value is REMOVED:
        del inner[last]
    else:
        inner[int(last) if isinstance(inner, list) else last] = value
    save_snapshot(file, saved(state))


def save_snapshot(file: Path, content: bytes) -> None:
    file.unlink()
    file.write_bytes(content)
    file.rename(file.with_name(f"{file.name.partition('-')[0]}-{sha256(file)[:16]}.pt"))


REMOVED = object()
MISFIT = "does not go with the run's settings ("
SNAPSHOTS: dict[str, tuple[str, Any, str]] = {
    "no step": ("step", REMOVED, "its 'step' must be of type int"),
    "a text for the step": ("step", "16", "its 'step' must be of type int"),
    "a list for the training": ("training", [1], "its 'training' must be of type dict"),
    "no files": ("files", {}, "its files are none that a training run writes"),
    "a file elsewhere": ("files/checksums", {"../../other.zip": "0"}, "its files are none that a training run writes"),
    "texts for files": ("files/contents", {"evaluations.csv": "text"}, "its files are none that a training run writes"),
    "negative sizes": ("events", {"a": -1}, "its files are none that a training run writes"),
    "no networks": ("training/networks", {}, f"{MISFIT}'policy')"),
    "other networks": ("training/networks/policy", {"a": th.zeros(1)}, f"{MISFIT}the networks lack"),
    "a text for a counter": ("training/counters/num_timesteps", "many", f"{MISFIT}'num_timesteps' must be a number"),
    "no counters": ("training/counters", {}, MISFIT),
    "a position outside": ("training/replay_buffer/pos", 10**9, f"{MISFIT}a replay buffer of 50 rows is not at row"),
    "a list for a buffer": ("training/replay_buffer/arrays", [], MISFIT),
    "other rewards": ("training/replay_buffer/arrays/rewards", th.zeros(3), f"{MISFIT}the replay buffer's 'rewards'"),
    "an expanded array": (
        "training/replay_buffer/arrays/rewards",
        th.zeros(1).expand(10**9, 1),
        "it has a tensor that claims the shape (1000000000, 1) and is smaller",
    ),
    "no generators": ("training/generators", {}, MISFIT),
    "another generator": ("training/generators/torch", th.zeros(3), MISFIT),
    "no episodes": ("training/episodes", [], MISFIT),
    "another observation": ("training/last_obs", th.zeros(3), f"{MISFIT}'last_obs' is not uint8 (1, 1, 60, 60))"),
    "a number for episodes": ("training/episodes", 3, MISFIT),
    "billions of lists": ("training/ep_info", laugh(), "the same lists or maps occur in it again and again"),
}


@pytest.mark.parametrize("damage", list(SNAPSHOTS))
def test_a_snapshot_with_a_right_digest_and_other_content_is_one_sentence(
    damage: str, unfinished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, value, reason = SNAPSHOTS[damage]
    changed_snapshot(unfinished, path, value)
    with takes_less_than(100):
        assert train_cli.main(["--resume", str(unfinished), "--verbose", "0"]) == 2
    message = capsys.readouterr().err
    assert message.startswith("error: ") and reason in message and message.count("\n") == 1
    assert message.endswith("; remove it, and the one before it is used\n")


def test_a_snapshot_sets_no_other_attribute_of_the_model(unfinished: Path) -> None:
    changed_snapshot(unfinished, "training/counters/gamma", 77.0)
    changed_snapshot(unfinished, "training/counters/predict", 5)
    assert train_cli.main(["--resume", str(unfinished), "--verbose", "0"]) == 0
    with zipfile.ZipFile(unfinished / "FakeReach-v0.zip") as archive:
        settings = archive.read("data").decode()
    assert '"gamma": 77' not in settings and '"predict": 5' not in settings


def test_a_snapshot_that_is_compressed_inside_takes_no_memory(
    unfinished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changed_snapshot(unfinished, "step", 16)
    (file,) = (unfinished / "checkpoints").glob("*.pt")
    save_snapshot(file, repacked(file.read_bytes(), with_zeros, zipfile.ZIP_DEFLATED))
    with takes_less_than(50):
        assert train_cli.main(["--resume", str(unfinished)]) == 2
    assert "it is compressed inside, which PyTorch's files are not" in capsys.readouterr().err
