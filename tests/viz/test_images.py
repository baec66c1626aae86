"""Ordinary images: the markers are found in any light, and the agent answers as it does on rendered frames."""

import json
import os
import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import gymnasium as gym
import numpy as np
import pytest
from tiny_training import TINY

from benchmarks.analysis.detection import DISTURBANCES, pose_frames
from sb3_stereo.commands import predict
from sb3_stereo.commands import train as train_cli
from sb3_stereo.envs.composite import Composite
from sb3_stereo.envs.markers import find_blobs
from sb3_stereo.errors import ConfigError, one_line
from sb3_stereo.real_images.detection import find_markers, observe, white_balanced
from sb3_stereo.real_images.sources import fit, read_image
from sb3_stereo.runs.directory import load_record
from sb3_stereo.runs.models import load_model

STACK = Composite("stack", ("left", "right"))


@pytest.fixture(scope="module")
def frames() -> list[Any]:
    return pose_frames(20)


# Bounds for the centroids' median and 95th percentile [px], well above what was measured.
BOUNDS = {
    "cluttered background": (0.4, 6.0),
    "JPEG, quality 50": (0.4, 1.2),
    "JPEG, quality 20": (0.7, 1.6),
    "webcam: warm, dim, shade, noise 8, JPEG 60": (0.8, 2.0),
}


@pytest.mark.parametrize("name", DISTURBANCES)
def test_the_centroids_hardly_move_in_any_light(name: str, frames: list[Any]) -> None:
    rng = np.random.default_rng(1)
    exact = np.array([find_blobs(frame) for frame in frames])
    seen = np.array([find_markers(DISTURBANCES[name](frame, rng)) for frame in frames])
    moved = np.linalg.norm(seen - exact, axis=2)
    assert np.isnan(moved).mean() < (
        0.15 if name in BOUNDS else 0.06
    )  # nearly hidden ones, and undecided if washed out
    median, most = BOUNDS.get(name, (0.4, 1.2))
    assert np.nanmedian(moved) < median and np.nanpercentile(moved, 95) < most


def test_swapping_red_and_blue_swaps_the_markers(frames: list[Any]) -> None:
    blobs, swapped = find_markers(frames[0]), find_markers(np.ascontiguousarray(frames[0][:, :, ::-1]))
    np.testing.assert_array_equal(blobs.end_effector, swapped.target)
    np.testing.assert_array_equal(blobs.target, swapped.end_effector)


def test_an_image_without_markers_has_none() -> None:
    for grey in (0, 90, 255):
        blobs = find_markers(np.full((48, 64, 3), grey, np.uint8))
        assert np.isnan(blobs.end_effector).all() and np.isnan(blobs.target).all()


def test_white_balance_leaves_rendered_frames_alone_and_undoes_the_lights_colour(frames: list[Any]) -> None:
    frame = frames[0]
    np.testing.assert_array_equal(white_balanced(frame), frame)
    tinted = DISTURBANCES["warm light (1, 0.85, 0.6)"](frame, np.random.default_rng(0))
    assert np.abs(white_balanced(tinted).astype(int) - frame).max() <= 2


def test_without_noise_the_network_sees_nearly_the_environments_composite(frames: list[Any]) -> None:
    difference = np.abs(observe(frames[:2], STACK).astype(int) - STACK(frames[:2]))
    assert difference.mean() < 1.0


def test_the_marker_map_has_the_found_markers_where_the_environments_are(frames: list[Any]) -> None:
    arrange = Composite("markers", ("left", "right"))
    for left, right in zip(frames[::2], frames[1::2], strict=True):
        images = observe([left, right], arrange), arrange([left, right])
        ours, theirs = (image[1].astype(float) - 128 for image in images)
        assert np.abs(theirs).max() > 60
        assert np.abs(ours - theirs).sum() < 0.5 * np.abs(theirs).sum()  # edges only, nothing is elsewhere or missing


def test_an_image_of_any_size_becomes_a_frame_by_its_middle() -> None:
    frame = np.random.default_rng(0).integers(0, 256, (240, 320, 3), dtype=np.uint8)
    np.testing.assert_array_equal(fit(frame, 320, 240), frame)
    doubled = np.pad(frame.repeat(2, axis=0).repeat(2, axis=1), ((0, 0), (50, 50), (0, 0)))
    np.testing.assert_array_equal(fit(doubled, 320, 240), frame)
    assert fit(frame[:, :20], 320, 240).shape == (240, 320, 3)


@pytest.fixture(scope="module", params=["ddpg", "dqn"])
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    logs = tmp_path_factory.mktemp("logs")
    flags = ["-n", "12", "--eval-freq", "-1", "--n-eval-envs", "1", "--num-threads", "1", "--device", "cpu"]
    flags += ["--env-kwargs", "max_episode_steps:1", "-params", *TINY, "callback:null"]
    assert (
        train_cli.main(
            [
                "--algo",
                request.param,
                "--env",
                "WamStereoReach-v0",
                "--seed",
                "1",
                "-f",
                str(logs),
                "--verbose",
                "0",
                *flags,
            ]
        )
        == 0
    )
    return logs / request.param / "WamStereoReach-v0_1"


@pytest.fixture
def folders(tmp_path: Path, frames: list[Any]) -> list[str]:
    """Two folders with three images each, the last pair twice as large."""
    for view, name in enumerate(("left", "right")):
        (tmp_path / name).mkdir()
        for i in range(3):
            image = frames[2 * i + view][:, :, ::-1].repeat(1 + i // 2, axis=0).repeat(1 + i // 2, axis=1)
            cv2.imwrite(str(tmp_path / name / f"{i}.png"), image)
    return [str(tmp_path / "left"), str(tmp_path / "right")]


def test_the_efforts_are_those_of_the_agent_in_newton_metres(
    run: Path, folders: list[str], frames: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ["--model", str(run), "--num-threads", "1", "--device", "cpu"]
    assert predict.main([*folders, *flags, "--json", "--draw", str(tmp_path / "drawn")]) == 0
    answers = [json.loads(line) for line in capsys.readouterr().out.splitlines() if line.startswith("{")]
    model = load_model(load_record(run)[0], run / "WamStereoReach-v0.zip", "cpu")
    action = model.predict(observe(frames[:2], STACK), deterministic=True)[0]
    env = gym.make("WamStereoReach-v0")
    levels = np.array(np.unravel_index(action, [3] * 4)) - 1.0 if run.parent.name == "dqn" else action
    torques = [answers[0]["efforts"][joint]["torque"] for joint in ("J1", "J2", "J3", "J4")]
    np.testing.assert_allclose(torques, levels * env.unwrapped.effort_limits, atol=1e-3)  # type: ignore[attr-defined]
    env.close()
    for i, answer in enumerate(answers):
        for view, found in enumerate(answer["views"].values()):
            np.testing.assert_allclose(found["target"], find_blobs(frames[2 * i + view]).target, atol=1.0)
    assert len(answers) == 3
    assert {path.name for path in (tmp_path / "drawn").iterdir()} == {"0001.png", "0002.png", "0003.png"}

    pair = [f"{folder}/0.png" for folder in folders]
    assert predict.main([*pair, *flags]) == 0
    lines = capsys.readouterr().out.splitlines()[-5:]
    assert lines[0] == " | ".join(pair)
    assert lines[1].startswith("  left    end effector (")
    assert lines[4].startswith(f"  efforts: J1 {torques[0]:+.1f} N m (")


def test_where_a_marker_is_undecided_both_places_are_named_and_no_efforts_given(
    run: Path, frames: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left = np.full((480, 640, 3), 255, np.uint8)
    for centre, colour in (((100, 100), (220, 0, 0)), ((400, 300), (220, 0, 0)), ((250, 400), (0, 0, 220))):
        cv2.circle(left, centre, 18, colour, cv2.FILLED)
    pair = [str(tmp_path / "left.png"), str(tmp_path / "right.png")]
    for path, image in zip(pair, (left, frames[1]), strict=True):
        cv2.imwrite(path, image[:, :, ::-1])
    flags = ["--model", str(run), "--num-threads", "1", "--device", "cpu"]
    assert predict.main([*pair, *flags, "--draw", str(tmp_path / "drawn")]) == 0
    lines = capsys.readouterr().out.splitlines()[-5:]
    assert lines[1] == "  left    end effector undecided, target (124.7, 199.7)"
    assert lines[3:] == [
        "  mean distance unknown: a marker is undecided",
        "  no efforts: the end effector in left may be at (49.7, 49.7) or at (199.7, 149.7); "
        "take away or cover what is not the marker, or give more light",
    ]
    assert predict.main([*pair, *flags, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert answer["efforts"] is None and answer["views"]["left"]["end_effector"] is None
    assert list(answer["undecided"]) == ["left"] and list(answer["undecided"]["left"]) == ["end_effector"]
    places = answer["undecided"]["left"]["end_effector"]
    np.testing.assert_allclose(places, [(49.75, 49.75), (199.75, 149.75)], atol=0.1)


def png(width: int, height: int) -> bytes:
    """A file whose header claims a size, with a few pixels."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    pixels = zlib.compress(bytes(100))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def bmp(width: int, height: int) -> bytes:
    """As `png`."""
    return b"BM" + struct.pack("<IHHIIiiHHIIiiII", 54, 0, 0, 54, 40, width, height, 1, 24, 0, 0, 0, 0, 0, 0)


@pytest.mark.parametrize("size", [100_000, 30_000, 12_000])
@pytest.mark.parametrize("header", [png, bmp])
def test_an_image_that_claims_to_be_huge_is_refused_before_anything_is_allocated(
    header: Any, size: int, tmp_path: Path
) -> None:
    (tmp_path / "huge.png").write_bytes(header(size, size))
    with pytest.raises(ConfigError) as refused:
        read_image(tmp_path / "huge.png")
    assert (
        str(refused.value) == f"'{tmp_path / 'huge.png'}' claims to have more than 89 million pixels; make it smaller"
    )


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tif", ".webp"])
def test_an_image_that_is_cut_off_is_refused_and_a_whole_one_read_whatever_its_name(
    suffix: str, frames: list[Any], tmp_path: Path
) -> None:
    data = cv2.imencode(suffix, frames[0][:, :, ::-1])[1].tobytes()
    whole = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff\xfe" + suffix.encode()))
    whole.write_bytes(data)
    assert np.abs(read_image(whole).astype(int) - frames[0]).mean() < 3
    for length in (0, 20, len(data) // 2):
        (tmp_path / f"cut{suffix}").write_bytes(data[:length])
        with pytest.raises(ConfigError):
            read_image(tmp_path / f"cut{suffix}")


def test_what_is_no_image_is_one_sentence(
    run: Path, folders: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "odd" / "folder.png").mkdir(parents=True)
    (tmp_path / "text.png").write_text("no image")
    left, right = folders
    (Path(right) / "2.png").unlink()
    for sources, message in (
        (
            [left, right],
            f"the views have different numbers of images: 3 in '{left}', 2 in '{right}'; give one per view and moment",
        ),
        ([left, "nowhere"], "no image or folder 'nowhere'; give a file, a folder or a camera's index such as 0"),
        (
            ["9" * 30, right],
            f"camera {'9' * 30} cannot be opened; give the index of one that is connected and not in use",
        ),
        ([left, "x" * 5000], f"'{'x' * 5000}' cannot be read: File name too long"),
        ([str(tmp_path / "odd")] * 2, f"'{tmp_path / 'odd' / 'folder.png'}' is not a file"),
        ([str(tmp_path / "text.png")] * 2, f"'{tmp_path / 'text.png'}' is not an image that OpenCV reads"),
        ([left], "the agent sees 2 views (left, right), got 1; give one each"),
        (
            [left, str(tmp_path / "empty")],
            f"no images in '{tmp_path / 'empty'}'; their names must end in .bmp, .jpeg, .jpg, .png, .tif, .tiff, .webp",
        ),
    ):
        assert predict.main([*sources, "--model", str(run), "--num-threads", "1"]) == 2
        assert capsys.readouterr().err.endswith(f"error: {one_line(message)}\n")


def test_the_first_example_of_the_docs_prints_what_stands_there(capsys: pytest.CaptureFixture[str]) -> None:
    root = Path(__file__).parents[2]
    block = (root / "docs" / "real_cameras.md").read_text().split("```console\n$ ")[1].split("```")[0]
    command, expected = block.split("\n", 1)
    arguments = [str(root / word) if word.endswith(".png") else word for word in command.split()[4:]]
    assert predict.main([*arguments, "--num-threads", "1", "--device", "cpu"]) == 0
    assert capsys.readouterr().out.replace(f"{root}/", "") == expected
