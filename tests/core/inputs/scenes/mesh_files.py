"""Files of meshes that are whole."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh
from PIL import Image


def mesh_arrays(mesh: trimesh.Trimesh) -> dict[str, Any]:
    """Return the arrays of our own file of a mesh, with a texture on its first triangle."""
    faces = np.asarray(mesh.faces, np.int32)
    n = len(faces)
    return {
        "vertices": np.asarray(mesh.vertices, np.float32), "faces": faces,
        "texture": np.array([0] + [-1] * (n - 1), np.int32),
        "normals": np.repeat(np.asarray(mesh.face_normals, np.float32)[:, None], 3, 1),
        "uv": np.zeros((n, 3, 2), np.float32),
        "colours": np.full((n, 3, 3), 0.5, np.float32), "texture_0": np.zeros((2, 2, 3), np.uint8),
    }  # fmt: skip


def exported() -> dict[str, bytes]:
    """Return a box as other programs write it."""
    box = trimesh.creation.box([2, 1, 1])
    painted = box.copy()
    painted.visual.vertex_colors = np.full((8, 4), 200, np.uint8)
    textured = box.copy()
    visual: Any = trimesh.visual
    material = visual.material.SimpleMaterial(image=Image.new("RGB", (2, 2)))
    textured.visual = visual.TextureVisuals(uv=np.zeros((8, 2)), material=material)
    files = {
        "text.ply": painted.export(file_type="ply", encoding="ascii"), "mesh.ply": painted.export(file_type="ply"),
        "mesh.obj": box.export(file_type="obj"), "mesh.stl": box.export(file_type="stl"),
        "mesh.off": box.export(file_type="off"),
        "textured.glb": textured.export(file_type="glb"), "painted.glb": painted.export(file_type="glb"),
    }  # fmt: skip
    return {name: data.encode() if isinstance(data, str) else data for name, data in files.items()}


def text_ply(faces: str) -> bytes:
    """Return a PLY file of four vertices and one face."""
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    lists = "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    return f"{head}{lists}0 0 0\n1 0 0\n0 1 0\n0 0 1\n{faces}\n".encode()
