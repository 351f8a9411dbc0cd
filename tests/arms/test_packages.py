"""Meshes of a URDF in its ROS package: package:// and ../, within the package alone."""

from __future__ import annotations

import struct
from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from loose_env.arms import read_model_file
from loose_env.cli.main import main
from loose_env.errors import InvalidData, InvalidSetting

URDF = """<robot name="lift"><link name="base"/>
<link name="arm"><collision><geometry><mesh filename="{}"/></geometry></collision></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="arm"/>
<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="30" velocity="1"/></joint>
<link name="tool"/><joint name="end" type="fixed"><parent link="arm"/><child link="tool"/>
<origin xyz="0.2 0.1 0"/></joint></robot>"""

SIDES = (0.2, 0.1, 0.05)


def stl() -> bytes:
    """Box with one corner at the origin."""
    corners = np.array(list(product((0.0, 1.0), repeat=3))) * SIDES
    hull = ConvexHull(corners)
    body = b""
    for triangle, plane in zip(hull.simplices, hull.equations, strict=True):
        a, b, c = corners[triangle]
        if np.cross(b - a, c - a) @ plane[:3] < 0:
            b, c = c, b
        body += struct.pack("<12fH", *plane[:3], *a, *b, *c, 0)
    return bytes(80) + struct.pack("<I", len(hull.simplices)) + body


Made = Callable[..., Path]


@pytest.fixture
def package(tmp_path: Path) -> Made:
    """A package ``lift`` with urdf/ and meshes/."""

    def make(filename: str, *, manifest: bool) -> Path:
        folder = tmp_path / "src" / "lift"
        for name in ("urdf", "meshes"):
            (folder / name).mkdir(parents=True)
        (folder / "meshes" / "arm.stl").write_bytes(stl())
        if manifest:
            (folder / "package.xml").write_text("<package/>")
        file = folder / "urdf" / "lift.urdf"
        file.write_text(URDF.format(filename))
        return file

    return make


@pytest.mark.parametrize("filename", ["package://lift/meshes/arm.stl", "../meshes/arm.stl"])
@pytest.mark.parametrize("up", [None, 1, 2])
def test_meshes_are_found_in_the_folder_with_the_manifest_or_that_is_named(
    package: Made, filename: str, up: int | None
) -> None:
    file = package(filename, manifest=up is None)
    found = read_model_file(file, package=None if up is None else file.parents[up])
    assert found.model.body("arm").mass[0] == pytest.approx(1000 * np.prod(SIDES), rel=1e-3)


def test_without_a_package_paths_stay_beside_the_file(package: Made) -> None:
    file = package("../meshes/arm.stl", manifest=False)
    with pytest.raises(InvalidData, match="--package-path"):
        read_model_file(file)


@pytest.mark.parametrize(
    "filename", ["../../secret.stl", "package://../secret.stl", "/etc/passwd", "http://x/arm.stl"]
)
def test_no_path_leaves_the_package(package: Made, filename: str) -> None:
    file = package(filename, manifest=True)
    (file.parents[2] / "secret.stl").write_bytes(stl())
    with pytest.raises(InvalidData, match=r"outside|missing"):
        read_model_file(file)


def test_a_link_out_of_the_package_is_not_followed(package: Made) -> None:
    file = package("../meshes/link.stl", manifest=True)
    secret = file.parents[2] / "secret.stl"
    secret.write_bytes(stl())
    (file.parents[1] / "meshes" / "link.stl").symlink_to(secret)
    with pytest.raises(InvalidData, match="outside"):
        read_model_file(file)


def test_a_package_path_that_is_no_folder_is_refused(package: Made) -> None:
    file = package("../meshes/arm.stl", manifest=False)
    with pytest.raises(InvalidSetting, match="is no folder"):
        read_model_file(file, package=file)


def test_inspect_takes_the_folder_on_its_command_line(
    package: Made, capsys: pytest.CaptureFixture[str]
) -> None:
    file = package("package://lift/meshes/arm.stl", manifest=False)
    assert main(["inspect", str(file)]) == 1
    assert "arm.stl" in capsys.readouterr().err
    assert main(["inspect", str(file), "--package-path", str(file.parents[1])]) == 0
    assert "shoulder" in capsys.readouterr().out
