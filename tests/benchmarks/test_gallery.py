"""The gallery shows every agent that ships, in clips that stay small."""

import re

import pytest

from benchmarks import gallery
from sb3_stereo.runs.pretrained import pretrained_names

PAGE = gallery.PAGE.read_text(encoding="utf-8")


def test_every_agent_that_ships_has_a_clip_and_its_scores() -> None:
    shown = re.findall(r"^## (\S+)\n\n.*\n\n!\[.*\]\((images/gallery/.*)\)$", PAGE, re.MULTILINE)
    assert {name for name, _ in shown} == {env_id for _, env_id in pretrained_names()}
    for algo, env_id in pretrained_names():
        assert gallery.section(algo, env_id) in PAGE, "write it anew: python -m benchmarks.gallery"
    for _, file in shown:
        clip = gallery.PAGE.parent / file
        assert clip.read_bytes()[:3] == b"GIF" and clip.stat().st_size < 300e3
    assert {file.name for file in gallery.CLIPS.iterdir()} == {file.rpartition("/")[2] for _, file in shown}


def test_only_what_is_between_the_marks_is_written() -> None:
    page = f"before\n{gallery.START}\nold\n{gallery.END}\nafter\n"
    changed = gallery.with_sections(page, "new")
    assert changed == f"before\n{gallery.START}\n\nnew\n\n{gallery.END}\nafter\n"
    assert gallery.with_sections(changed, "new") == changed
    with pytest.raises(ValueError, match="once each"):
        gallery.with_sections("no marks", "new")
