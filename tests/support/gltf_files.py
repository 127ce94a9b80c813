"""glTF files made in tests, with features of Khronos' sample models."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

CODES = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
QUAD = np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 2, 0]], np.float32)
QUAD_FACES = np.array([0, 1, 2, 0, 2, 3], np.uint16)
QUAD_UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
"""A quad 1 wide (x) and 2 high (y); its image stands upright on it."""


class GltfFile:
    """A document that grows, with its one buffer."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.document: dict[str, Any] = {"asset": {"version": "2.0"}, "bufferViews": [], "accessors": []}

    def view(self, content: bytes, **more: Any) -> int:
        """The number of a buffer view of a content."""
        self.data += bytes(-len(self.data) % 4)
        views = self.document["bufferViews"]
        views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(content)} | more)
        self.data += content
        return len(views) - 1

    def accessor(self, values: NDArray[Any], pad: int = 0, **more: Any) -> int:
        """The number of an accessor of values (N,) or (N, width), with bytes between elements."""
        rows = values.reshape(len(values), -1)
        content = b"".join(row.tobytes() + b"\xee" * pad for row in rows)
        stride = {"byteStride": rows.itemsize * rows.shape[1] + pad} if pad else {}
        head = {"bufferView": self.view(content, **stride), "componentType": CODES[str(values.dtype)]}
        return self.add({**head, "count": len(rows), "type": KINDS[rows.shape[1]], **more})

    def add(self, accessor: dict[str, Any]) -> int:
        """The number of an accessor."""
        self.document["accessors"].append(accessor)
        return len(self.document["accessors"]) - 1

    def primitive(self, attributes: dict[str, int], faces: NDArray[Any] | None = QUAD_FACES, **more: Any) -> None:
        """One mesh of one primitive on one node."""
        indices = {} if faces is None else {"indices": self.accessor(faces)}
        node = more.pop("node", {})
        mesh = {"primitives": [{"attributes": attributes, **indices, **more}]}
        self.document |= {"meshes": [mesh], "nodes": [{"mesh": 0, **node}], "scenes": [{"nodes": [0]}], "scene": 0}

    def textured(self, content: bytes, info: dict[str, Any], **more: Any) -> None:
        """One material with a texture of an image file's content."""
        image = {"bufferView": self.view(content), "mimeType": "image/png"}
        base = {"baseColorTexture": {"index": 0, **info}, **more}
        self.document |= {
            "materials": [{"pbrMetallicRoughness": base}], "textures": [{"source": 0}], "images": [image],
        }  # fmt: skip

    def save(self, path: Path) -> Path:
        """Write a .glb; or a .gltf with its buffer beside it, whose name needs escapes."""
        if path.suffix == ".gltf":
            path.with_name("its buffer.bin").write_bytes(self.data)
            buffers = [{"byteLength": len(self.data), "uri": "its%20buffer.bin"}]
            path.write_text(json.dumps(self.document | {"buffers": buffers}))
            return path
        text = json.dumps(self.document | {"buffers": [{"byteLength": len(self.data)}]}).encode()
        text, data = text + b" " * (-len(text) % 4), bytes(self.data) + bytes(-len(self.data) % 4)
        head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(data))
        path.write_bytes(
            head + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
        )
        return path
