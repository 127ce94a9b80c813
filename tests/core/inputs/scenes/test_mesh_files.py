"""Meshes with faults: our own file, and those of other programs."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import example, given
from hypothesis import strategies as st

from inputs.faults import Array, Bytes, CutOff, Entry, Shape, Type
from inputs.promise import Property, Reader
from inputs.scenes.mesh_files import exported, mesh_arrays, text_ply
from inputs.strategies import Input, inputs_of
from inputs.views import In, npz_file
from unisim_blender.core.meshes.intersect import Mesh
from unisim_blender.core.meshes.read import read_mesh

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no alarms and no bounds of memory there")
OWN = "mesh.npz"
TEXTS = ("text.ply", "mesh.obj", "mesh.off")


def met(file: Path) -> object:
    """Read a mesh and send a ray at it."""
    return Mesh(read_mesh(file)).first_hits(np.array([[-9.0, 0, 0]]), np.array([[1.0, 0, 0]]), 0.0)


def own_reader(folder: Path) -> Reader:
    """Our own file of a mesh."""
    whole = {OWN: npz_file(mesh_arrays(trimesh.creation.box([2, 1, 1])))}
    return Reader(folder, whole, lambda: met(folder / OWN), inputs_of(whole, {OWN: ["npz"]}), (OWN,))


def other_reader(folder: Path) -> Reader:
    """Meshes as other programs write them: the one that has faults is read."""
    whole = exported()
    views = {"textured.glb": ["gltf"], "painted.glb": ["gltf"]}
    words = st.sampled_from((b"nan", b"-1", b"1e40", b"99999999999", b"x", b"", b"inf", b"9", b"8", b"3"))
    places = [(file, m.start(), len(m[0])) for file in TEXTS for m in re.finditer(rb"[^\s]+", whole[file])]
    # a number of a text in another's place
    inputs = inputs_of(whole, views) | st.builds(
        lambda place, word: [In(place[0], "bytes", (Bytes(place[1], place[2], word),))], st.sampled_from(places), words
    )

    def read() -> object:
        return [met(folder / name) for name in whole if (folder / name).read_bytes() != whole[name]]

    return Reader(folder, whole, read, inputs, tuple(whole))


OWN_MESHES, OTHER_MESHES = Property(own_reader), Property(other_reader)


def ply(faces: str) -> Input:
    """A text file of one face in the place of text.ply."""
    return [In("text.ply", "bytes", (CutOff(0), Bytes(0, 0, text_ply(faces))))]


@given(OWN_MESHES.inputs)
@example([In(OWN, "npz", (Array("faces", Entry(0, 8)),))])
@example([In(OWN, "npz", (Array("faces", Entry(0, -1)),))])
@example([In(OWN, "npz", (Array("faces", Shape("twice as wide")),))])
@example([In(OWN, "npz", (Array("vertices", Shape("flat")),))])
@example([In(OWN, "npz", (Array("vertices", Type("O")),))])
def test_own_meshes(changes: Input) -> None:
    OWN_MESHES.check(changes)


@given(OTHER_MESHES.inputs)
@example(ply("4 0 1 2 3"))
@example(ply("3 0 1 9"))
@example(ply("3 0 1 -1"))
@example(ply("2 0 1"))
@example(ply("3 0 0 0"))
@example(ply("3 1 2 nan"))
@example([In("mesh.obj", "bytes", (CutOff(0), Bytes(0, 0, b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\nf 1/1/1 2 3\n")))])
def test_meshes_of_other_programs(changes: Input) -> None:
    OTHER_MESHES.check(changes)
