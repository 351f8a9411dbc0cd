"""Folders that are no recording: ``recording.json``, paths and models that are refused."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.recording import read_recording
from tests.recording.hand_made import ARM

Folder = Callable[..., Path]
PLAIN = {"format": "loose-recording/1", "model": "model.xml", "runs": [{"file": "run.csv"}]}


def refused(home: Path, pattern: str, **arguments: Any) -> None:
    with pytest.raises(InvalidData) as error:
        read_recording(home, **arguments)
    assert re.search(pattern, str(error.value)), str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("change", "pattern"),
    [
        ({"format": "loose-recording/2"}, r"format is 'loose-recording/2'; .*'loose-recording/1'"),
        ({"format": 1}, r"format is 1"),
        ({"format": None}, r"format is None"),
        ({"format": ...}, r"'format' is missing"),
        ({"model": ...}, r"'model' is missing"),
        ({"runs": ...}, r"'runs' is missing"),
        ({"Runs": []}, r"unknown key 'Runs'; .*did you mean 'runs'"),
        ({"model": ["model.xml"]}, r"model is a name in quotes, got \['model.xml'\]"),
        ({"model": ""}, r"model is a name"),
        ({"runs": []}, r"runs is a list of at least one run"),
        ({"runs": {"file": "run.csv"}}, r"runs is a list"),
        ({"runs": ["run.csv"]}, r"runs\[0\] is an object"),
        ({"runs": [{}]}, r"runs\[0\]: 'file' is missing"),
        ({"runs": [{"file": 3}]}, r"runs\[0\]\.file is a name"),
        ({"runs": [{"file": "run.csv", "rate": 5}]}, r"runs\[0\]: unknown key 'rate'"),
        ({"runs": [{"file": "run.csv", "exited": []}]}, r"did you mean 'excited'"),
        ({"runs": [{"file": "run.csv", "condition": "good"}]}, r"condition is 'good'"),
        ({"runs": [{"file": "run.csv", "condition": None}]}, r"condition is None"),
        ({"runs": [{"file": "run.csv", "condition": []}]}, r"condition is \[\]"),
        ({"runs": [{"file": "run.csv", "excited": "reach"}]}, r"excited is a list"),
        ({"runs": [{"file": "run.csv", "excited": [1]}]}, r"excited\[0\] is a name"),
        ({"runs": [{"file": "run.csv", "excited": ["reach"] * 2}]}, r"names a joint twice"),
        (
            {"runs": [{"file": "run.csv", "excited": ["reach", "sholder"]}]},
            r"runs\[0\]\.excited\[1\]: 'sholder' is no hinge.*did you mean 'shoulder'",
        ),
        ({"runs": [{"file": "run.csv", "pose": [1]}]}, r"pose is an object"),
        ({"runs": [{"file": "run.csv", "pose": None}]}, r"pose is an object"),
        ({"runs": [{"file": "run.csv", "pose": {"reach": "0"}}]}, r"pose\['reach'\] is a position"),
        ({"runs": [{"file": "run.csv", "pose": {"reach": True}}]}, r"pose\['reach'\] is a positi"),
        ({"runs": [{"file": "run.csv", "pose": {"reach": 10**400}}]}, r"has to be finite"),
        ({"runs": [{"file": "run.csv", "pose": {"elbow": 0}}]}, r"pose: 'elbow' is no hinge"),
        ({"runs": [{"file": "none.csv"}]}, r"runs\[0\]\.file: there is no file 'none\.csv'"),
        ({"runs": [{"file": "run.txt"}]}, r"runs\[0\]\.file: .*run\.txt"),
        ({"runs": [{"file": "model.xml"}]}, r"has to end in \.parquet or \.csv"),
        ({"runs": [{"file": "run.csv"}] * 2}, r"runs\[1\]\.file: 'run\.csv' is the same file"),
        ({"runs": [{"file": "run.csv"}, {"file": "./run.csv"}]}, r"'\./run\.csv' is the same file"),
        ({"runs": [{"file": "../recorded/run.csv"}, {"file": "run.csv"}]}, r"is the same file"),
        ({"runs": [{"file": "."}]}, r"there is no file '\.'"),
        ({"model": "none.xml"}, r"model: there is no file 'none\.xml'"),
    ],
)
def test_descriptions_of_another_kind(folder: Folder, change: dict[str, Any], pattern: str) -> None:
    refused(folder(**change), rf"^recording\.json.*{pattern}")


@pytest.mark.parametrize(
    ("text", "pattern"),
    [
        ("", r"not JSON"),
        ("{", r"not JSON: .*line 1"),
        ("[]", r"an object with"),
        ("3", r"an object with"),
        (json.dumps(PLAIN)[:-1] + ', "format": "loose-recording/1"}', r"key 'format' stands twice"),
        (
            '{"format": "loose-recording/1", "model": "model.xml", "runs": '
            '[{"file": "run.csv", "pose": {"reach": 0, "reach": 1}}]}',
            r"key 'reach' stands twice",
        ),
        *[
            (
                '{"format": "loose-recording/1", "model": "model.xml", "runs": '
                f'[{{"file": "run.csv", "pose": {{"reach": {word}}}}}]}}',
                r"is no number of JSON|has to be finite|not JSON",
            )
            for word in ("NaN", "Infinity", "-Infinity", "1e999", "9" * 5000)
        ],
        (json.dumps(PLAIN).encode("utf-16"), r"line 1 is not UTF-8.*UTF-16"),
        (b'{"format": "\xff"}', r"line 1 is not UTF-8: byte 13 is 0xff"),
        ("[" * 100_000, r"nested too deeply|not JSON"),
        (json.dumps(PLAIN | {"model": "\ud800.xml"}), r"no path"),
    ],
)
def test_files_that_are_no_json(folder: Folder, text: str | bytes, pattern: str) -> None:
    refused(folder({"recording.json": text}), rf"^recording\.json: .*({pattern})")


def test_a_byte_order_mark_before_the_description_is_taken(folder: Folder) -> None:
    home = folder({"recording.json": b"\xef\xbb\xbf" + json.dumps(PLAIN).encode()})
    assert len(read_recording(home).runs) == 1


@pytest.mark.parametrize(
    ("path", "pattern"),
    [
        ("../outside.csv", "leaves the folder"),
        ("a/../../outside.csv", "leaves the folder"),
        ("/etc/passwd", "is absolute"),
        ("C:/run.csv", "is absolute"),
        ("..\\outside.csv", "is no path"),
        ("run.csv\0", "is no path"),
        ("run\n.csv", "is no path"),
        ("link.csv", "leaves the folder"),
        ("away/outside.csv", "leaves the folder"),
        ("loop.csv", "leads nowhere|there is no file"),
        ("x" * 5000 + ".csv", "cannot be read|there is no file|leads nowhere"),
        ("pipe.csv", "there is no file"),
    ],
)
@pytest.mark.parametrize("key", ["model", "file"])
def test_paths_that_leave_the_folder(
    folder: Folder, tmp_path: Path, key: str, path: str, pattern: str
) -> None:
    tmp_path.joinpath("outside.csv").write_text("time,sensor.angle\n")
    change = {"model": path} if key == "model" else {"runs": [{"file": path}]}
    home = folder(**change)
    home.joinpath("link.csv").symlink_to(tmp_path / "outside.csv")
    home.joinpath("away").symlink_to(tmp_path)
    home.joinpath("loop.csv").symlink_to("loop.csv")
    os.mkfifo(home / "pipe.csv")  # opening it would wait for ever
    refused(home, rf"^recording\.json: (model|runs\[0\]\.file): .*({pattern})")


def test_a_second_name_of_the_same_file(folder: Folder) -> None:
    home = folder(runs=[{"file": "run.csv"}, {"file": "twin.csv"}])
    home.joinpath("twin.csv").symlink_to("run.csv")
    refused(home, r"runs\[1\]\.file: 'twin\.csv' is the same file as 'run\.csv'")
    home.joinpath("twin.csv").unlink()
    os.link(home / "run.csv", home / "twin.csv")
    refused(home, r"runs\[1\]\.file: 'twin\.csv' is the same file as 'run\.csv'")


def test_a_description_that_is_a_link_to_elsewhere(folder: Folder, tmp_path: Path) -> None:
    home = folder()
    home.joinpath("recording.json").rename(tmp_path / "recording.json")
    home.joinpath("recording.json").symlink_to(tmp_path / "recording.json")
    refused(home, r"'recording\.json' leaves the folder")


def test_folders_that_are_not_there(tmp_path: Path) -> None:
    refused(tmp_path / "none", r"there is no folder .*none")
    refused(tmp_path, r"there is no file 'recording\.json'")
    file = tmp_path / "file"
    file.write_text("")
    refused(file, r"there is no folder .*file'; a recording is a folder; 'loose import' makes one")
    with pytest.raises(InvalidData, match="no folder"):
        read_recording(3)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "pattern"),
    [
        ("", r"not XML"),
        ("{}", r"not XML"),
        (ARM[:300], r"not XML"),
        ("<svg/>", r"outermost element is <svg>"),
        (ARM.replace("<motor", "<mtoor"), r"MuJoCo cannot read it: .*mtoor"),
        (ARM.replace('joint="reach" kp', 'joint="rech" kp'), r"MuJoCo cannot build it: .*rech"),
        (ARM.replace('mass="2"', 'mass="0"'), r"MuJoCo cannot build it: .*a body that moves"),
        (ARM.replace('name="rate"', 'name="angle"'), r"repeated name 'angle'"),
        (ARM.replace('kp="100"', 'kp="nan"'), r"actuator_gainprm has to be finite|cannot"),
        (ARM.replace('pos=".4 0 0"', 'pos="nan 0 0"'), r"body_pos has to be finite|cannot"),
        (f"<!DOCTYPE mujoco>{ARM}", r"document type"),
        (ARM.encode("utf-16").decode("latin-1"), r"not XML"),
        *[
            (ARM.replace("<mujoco>", f"<mujoco><include file='{path}'/>"), "lies outside")
            for path in ("../other.xml", "/etc/passwd", "away/other.xml")
        ],
        (
            ARM.replace(
                "<worldbody>", "<asset><mesh name='m' file='../m.stl'/></asset><worldbody>"
            ),
            r"<mesh file='\.\./m\.stl'> lies outside",
        ),
        (
            ARM.replace("<worldbody>", "<asset><mesh name='m' file='m.stl'/></asset><worldbody>"),
            r"MuJoCo cannot .*m\.stl",
        ),
        (ARM.encode().replace(b"upper", b"\xfcber"), "not XML"),
    ],
)
def test_models_that_do_not_compile(
    folder: Folder, tmp_path: Path, text: str | bytes, pattern: str
) -> None:
    tmp_path.joinpath("other.xml").write_text("<mujocoinclude/>")
    home = folder({"model.xml": text})
    home.joinpath("away").symlink_to(tmp_path)
    refused(home, rf"^model\.xml: .*({pattern})")


def test_another_model_that_is_missing_or_broken(folder: Folder, tmp_path: Path) -> None:
    with pytest.raises(InvalidSetting, match=r"there is no file .*other\.xml"):
        read_recording(folder(), model=tmp_path / "other.xml")
    tmp_path.joinpath("other.xml").write_text("<mujoco><worldbodi/></mujoco>")
    refused(folder(), r"^other\.xml: MuJoCo cannot read it", model=tmp_path / "other.xml")


def test_any_mangled_description_is_refused_in_one_line_or_reads(folder: Folder) -> None:
    rng = np.random.default_rng(5)
    text = json.dumps(PLAIN | {"runs": [{"file": "run.csv", "pose": {"reach": 0.5}}]})
    outcomes = set()
    for _ in range(300):
        raw = bytearray(text.encode())
        for _ in range(rng.integers(1, 4)):
            place = rng.integers(len(raw))
            raw[place : place + rng.integers(3)] = rng.bytes(rng.integers(3))
        home = folder({"recording.json": bytes(raw)})
        try:
            read_recording(home)
            outcomes.add("read")
        except InvalidData as error:
            outcomes.add("refused")
            assert "recording.json" in str(error)
            assert "\n" not in str(error)
    assert "refused" in outcomes
