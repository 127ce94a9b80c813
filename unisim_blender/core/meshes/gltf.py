"""glTF 2.0 (Khronos, ISO/IEC 12113), .gltf and .glb: the triangles of the default scene at rest, with base colours."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from ..errors import ScenarioError, short
from ..geometry import FloatArray
from .model import MeshPart, face_normals, texture_of

TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
AXES = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
"""Rotation (3, 3) from glTF's axes, x left, y up, z forward, to those of actors."""
MOST_ZEROS = 1 << 24
"""Largest number of elements of an accessor that stores none."""
READ = {
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_node_visibility",
    "EXT_texture_webp",
}
HARMLESS = {"KHR_lights_punctual", "KHR_xmp_json_ld", "KHR_xmp", "EXT_lights_image_based", "EXT_lights_ies"} | {
    f"KHR_materials_{name}"
    for name in (
        "anisotropy", "clearcoat", "diffuse_transmission", "dispersion", "emissive_strength", "ior", "iridescence",
        "sheen", "specular", "transmission", "unlit", "volume",
    )
}  # fmt: skip
"""Extensions that change neither shapes nor base colours."""
LEFT_OUT = {0: "points", 1: "lines", 2: "lines", 3: "lines"}
MODES = (4, 5, 6)
REPEAT = 10497


def read_gltf(path: Path, notes: list[str]) -> list[MeshPart]:
    """Return the triangles in a file, in actors' axes, metres; ``notes`` gets a sentence on each thing that is left
    out.

    Raises `ScenarioError`, also for an extension that the file requires and that is not read.
    """
    return _Reader(path, notes).parts()


class _Reader:
    def __init__(self, path: Path, notes: list[str]) -> None:
        self.path, self.notes = path, notes
        self.document, self.chunk = self._opened()
        self.buffers: dict[int, bytes] = {}
        self.images: dict[int, NDArray[np.uint8]] = {}
        self._check_versions()
        self.worlds, self.visible = self._nodes()

    def fail(self, problem: str) -> ScenarioError:
        return ScenarioError(f"{self.path}: {problem}")

    def note(self, sentence: str) -> None:
        if sentence not in self.notes:
            self.notes.append(sentence)

    def _opened(self) -> tuple[dict[str, Any], bytes | None]:
        content, binary = self.path.read_bytes(), None
        if content[:4] == b"glTF":
            if len(content) < 12 or struct.unpack_from("<I", content, 4)[0] != 2:
                raise self.fail(f"is no glTF 2.0: its header says version {content[4:8].hex()}")
            place, chunks = 12, []
            while place + 8 <= len(content):
                length, kind = struct.unpack_from("<I4s", content, place)
                if place + 8 + length > len(content):
                    raise self.fail(f"ends inside a chunk of {length} bytes")
                chunks.append((kind, content[place + 8 : place + 8 + length]))
                place += 8 + length
            if not chunks or chunks[0][0] != b"JSON":
                raise self.fail("has no JSON chunk")
            content = chunks[0][1]
            binary = next((data for kind, data in chunks[1:] if kind == b"BIN\0"), None)
        document = json.loads(content.decode("utf-8-sig"))
        if not isinstance(document, dict):
            raise self.fail("holds no JSON object")
        return document, binary

    def _check_versions(self) -> None:
        asset = self.document.get("asset", {})
        version = str(asset.get("minVersion", asset.get("version")))
        if version.partition(".")[0] != "2" or ("minVersion" in asset and version != "2.0"):
            raise self.fail(f"is glTF {short(version)}, not 2.0")
        required = self.document.get("extensionsRequired", [])
        for name in required:
            if name not in READ | HARMLESS:
                raise self.fail(f"requires the glTF extension {name}, which is not read")
        for name in self.document.get("extensionsUsed", []):
            if name not in READ | HARMLESS:
                self.note(f"the glTF extension {name} is not read")

    def item(self, kind: str, index: Any) -> dict[str, Any]:
        """Return the object of this index in a list of the document."""
        items = self.document.get(kind, [])
        if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < len(items):
            raise self.fail(f"{kind}[{short(index)}] is named and not there: there are {len(items)}")
        entry = items[index]
        if not isinstance(entry, dict):
            raise self.fail(f"{kind}[{index}] is {short(entry)}, not an object")
        return entry

    # ---- bytes and numbers
    def _uri(self, uri: str, what: str) -> bytes:
        """Return the content that a URI names: of itself, or of a file beside the document."""
        if uri.startswith("data:"):
            head, _, data = uri.partition(",")
            return base64.b64decode(unquote(data)) if head.endswith(";base64") else unquote_to_bytes(data)
        if "://" in uri:
            raise self.fail(f"{what} is at {short(uri)}, which is not loaded")
        for name in dict.fromkeys((unquote(uri), uri, unquote(uri).replace("\\", "/"))):
            if (self.path.parent / name).is_file():
                return (self.path.parent / name).read_bytes()
        raise self.fail(f"{what} {short(unquote(uri))} is missing")

    def buffer(self, index: Any) -> bytes:
        if index not in self.buffers:
            buffer = self.item("buffers", index)
            if "uri" in buffer:
                data = self._uri(buffer["uri"], "its buffer")
            elif index == 0 and self.chunk is not None:
                data = self.chunk
            else:
                names = " and ".join(buffer.get("extensions", {}))
                raise self.fail(
                    f"buffers[{index}] has no data" + (f" without the glTF extension {names}" * bool(names))
                )
            if len(data) < buffer["byteLength"]:
                raise self.fail(f"buffers[{index}] has {len(data)} bytes, not {buffer['byteLength']}")
            self.buffers[index] = data
        return self.buffers[index]

    def view(self, index: Any) -> tuple[bytes, int]:
        """Return the bytes of a buffer view, and its stride, 0 for none."""
        view = self.item("bufferViews", index)
        begin, length, data = view.get("byteOffset", 0), view["byteLength"], self.buffer(view["buffer"])
        if begin < 0 or length < 0 or begin + length > len(data):
            raise self.fail(f"bufferViews[{index}] reaches to byte {begin + length} of a buffer of {len(data)}")
        return data[begin : begin + length], view.get("byteStride", 0)

    def _elements(self, source: dict[str, Any], count: int, dtype: Any, width: int, place: str) -> NDArray[Any]:
        data, stride = self.view(source["bufferView"])
        begin, size = source.get("byteOffset", 0), dtype.itemsize * width
        stride = stride or size
        if begin < 0 or stride < 0 or (count and begin + stride * (count - 1) + size > len(data)):
            raise self.fail(f"{place} has {count} elements, which its buffer view of {len(data)} bytes does not hold")
        if not count:
            return np.zeros((0, width), dtype)
        return np.ndarray((count, width), dtype, data, begin, (stride, dtype.itemsize)).copy()

    def accessor(self, index: Any, always_normalized: bool = False) -> NDArray[Any]:
        """Return values (count, width) of an accessor: integers as they are, normalised ones as float64."""
        accessor, place = self.item("accessors", index), f"accessors[{index}]"
        if accessor.get("componentType") not in TYPES or accessor.get("type") not in WIDTHS:
            kind = f"{accessor.get('componentType')} {accessor.get('type')}"
            raise self.fail(f"{place} has the type {kind}, which is none of its attributes'")
        dtype, width, count = np.dtype(TYPES[accessor["componentType"]]), WIDTHS[accessor["type"]], accessor["count"]
        if not isinstance(count, int) or count < 0:
            raise self.fail(f"{place}.count is {short(count)}")
        if "bufferView" in accessor:
            values = self._elements(accessor, count, dtype, width, place)
        elif count <= MOST_ZEROS:
            values = np.zeros((count, width), dtype)
        else:
            raise self.fail(f"{place} has {count} elements and no buffer view")
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            integer = np.dtype(TYPES[sparse["indices"]["componentType"]])
            at = self._elements(sparse["indices"], sparse["count"], integer, 1, f"{place}.sparse.indices")[:, 0]
            if len(at) and int(at.max()) >= count:
                raise self.fail(f"{place}.sparse names element {int(at.max())} of {count}")
            values[at] = self._elements(sparse["values"], sparse["count"], dtype, width, f"{place}.sparse.values")
        if dtype.kind != "f" and (accessor.get("normalized", False) or always_normalized):
            return np.maximum(values / float(np.iinfo(dtype).max), -1.0)
        return values

    # ---- nodes
    def _nodes(self) -> tuple[dict[int, FloatArray], list[int]]:
        """World matrices (4, 4) of nodes, and the nodes of the default scene that are visible."""
        nodes = self.document.get("nodes", [])
        parents: dict[int, int] = {}
        for i in range(len(nodes)):
            for child in self.item("nodes", i).get("children", []):
                self.item("nodes", child)
                if child in parents:
                    raise self.fail(f"nodes[{child}] is the child of two nodes")
                parents[child] = i
        worlds: dict[int, FloatArray] = {}
        roots = [i for i in range(len(nodes)) if i not in parents]
        todo = [(i, np.eye(4)) for i in roots]
        while todo:
            i, above = todo.pop()
            worlds[i] = above @ self._local(nodes[i], i)
            todo += [(child, worlds[i]) for child in nodes[i].get("children", [])]
        if len(worlds) < len(nodes):
            raise self.fail("its nodes are children of each other")
        scenes = self.document.get("scenes", [])
        if scenes:
            roots = self.item("scenes", self.document.get("scene", 0)).get("nodes", [])
            if len(scenes) > 1:
                self.note(f"only the default scene of {len(scenes)} is read")
        visible: list[int] = []
        ahead = list(reversed(roots))
        while ahead:
            node = self.item("nodes", i := ahead.pop())
            if not node.get("extensions", {}).get("KHR_node_visibility", {}).get("visible", True):
                continue
            visible.append(i)
            ahead += reversed(node.get("children", []))
        return worlds, visible

    def _local(self, node: dict[str, Any], index: int) -> FloatArray:
        if "matrix" in node:
            return np.array(node["matrix"], float).reshape(4, 4).T
        x, y, z, w = np.array(node.get("rotation", (0, 0, 0, 1)), float)
        length = x * x + y * y + z * z + w * w
        if not length > 0:
            raise self.fail(f"nodes[{index}].rotation is {short(node['rotation'])}, which is none")
        s = 2 / length
        turn = np.array(
            [
                [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
                [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
                [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
            ]
        )
        local = np.eye(4)
        local[:3, :3] = turn * np.array(node.get("scale", (1, 1, 1)), float)
        local[:3, 3] = node.get("translation", (0, 0, 0))
        return local

    # ---- meshes
    def parts(self) -> list[MeshPart]:
        if self.document.get("animations"):
            self.note("animations are left out: the mesh stands as at rest")
        parts = []
        for i in self.visible:
            node = self.item("nodes", i)
            if "EXT_mesh_gpu_instancing" in node.get("extensions", {}):
                self.note(f"nodes[{i}] stands once, without its instances (EXT_mesh_gpu_instancing)")
            if "mesh" in node:
                mesh = self.item("meshes", node["mesh"])
                for k, primitive in enumerate(mesh["primitives"]):
                    part = self._primitive(primitive, mesh, node, i, f"meshes[{node['mesh']}].primitives[{k}]")
                    if part is not None:
                        parts.append(part)
        return parts

    def _primitive(
        self, primitive: dict[str, Any], mesh: dict[str, Any], node: dict[str, Any], index: int, place: str
    ) -> MeshPart | None:
        mode, attributes = primitive.get("mode", 4), primitive["attributes"]
        if mode not in MODES:
            if mode not in LEFT_OUT:
                raise self.fail(f"{place}.mode is {short(mode)}, none of glTF's")
            self.note(f"{place} is of {LEFT_OUT[mode]}, which are left out")
            return None
        if "POSITION" not in attributes:
            self.note(f"{place} has no POSITION and is left out")
            return None
        compressed = [name for name in primitive.get("extensions", {}) if "compression" in name]
        for name in (attributes["POSITION"], *([primitive["indices"]] if "indices" in primitive else [])):
            if compressed and not {"bufferView", "sparse"} & self.item("accessors", name).keys():
                raise self.fail(f"{place} needs the glTF extension {compressed[0]}, which is not read")
        positions = self._morphed("POSITION", primitive, mesh, node)
        n = len(positions)
        normals = self._morphed("NORMAL", primitive, mesh, node) if "NORMAL" in attributes else None
        order = self.accessor(primitive["indices"])[:, 0].astype(np.int64) if "indices" in primitive else np.arange(n)
        faces = _triangles(order, mode)
        if len(faces) and int(faces.max()) >= n:
            raise self.fail(f"{place} names vertex {int(faces.max())}, which is not there: there are {n}")
        colours, uv, texture = self._colours(primitive, place, n)
        positions, normals, mirrored = self._placed(positions, normals, attributes, node, index, place)
        if mirrored:
            faces = faces[:, [0, 2, 1]]
        if mode != 4:  # strips repeat vertices where they turn
            a, b, c = faces.T
            faces = faces[(a != b) & (b != c) & (a != c)]
        vertices = positions @ AXES.T
        if normals is None:  # flat, as glTF wants it
            flat = face_normals(vertices.astype(np.float32), faces.astype(np.int32))
            corner_normals = np.repeat(flat[:, None], 3, 1)
        else:
            corner_normals = (normals @ AXES.T)[faces]
        return MeshPart(vertices, faces, colours[faces], corner_normals, None if uv is None else uv[faces], texture)

    def _attribute(self, name: str, attributes: dict[str, Any], n: int, place: str) -> NDArray[Any]:
        """Return values (n, width) of an attribute other than POSITION."""
        values = self.accessor(attributes[name], name.startswith(("COLOR", "WEIGHTS")))
        if len(values) != n:
            raise self.fail(f"{place}.attributes.{name} has {len(values)} values for {n} vertices")
        return values

    def _morphed(self, name: str, primitive: dict[str, Any], mesh: dict[str, Any], node: dict[str, Any]) -> FloatArray:
        """Return values (V, 3) of an attribute, with the morph targets at their weights at rest."""
        values = self.accessor(primitive["attributes"][name]).astype(np.float64)
        if values.shape[1] != 3:
            raise self.fail(f"{name} has {values.shape[1]} components, not 3")
        weights = node.get("weights", mesh.get("weights", []))
        for weight, target in zip(weights, primitive.get("targets", []), strict=False):
            if weight and name in target:
                values = values + weight * self.accessor(target[name])
        return values

    def _placed(
        self,
        positions: FloatArray,
        normals: FloatArray | None,
        attributes: dict[str, Any],
        node: dict[str, Any],
        index: int,
        place: str,
    ) -> tuple[FloatArray, FloatArray | None, bool]:
        """Positions and normals in the scene, and whether the node mirrors them."""
        n = len(positions)
        if "skin" in node and "JOINTS_0" in attributes and "WEIGHTS_0" in attributes:
            skin = self.item("skins", node["skin"])
            joints = np.stack([self.worlds[joint] for joint in skin["joints"]])
            if "inverseBindMatrices" in skin:
                inverse = self.accessor(skin["inverseBindMatrices"])[: len(joints)].reshape(-1, 4, 4)
                joints = joints @ np.swapaxes(inverse, 1, 2)
            matrices, total = np.zeros((n, 4, 4)), np.zeros(n)
            k = 0
            while f"JOINTS_{k}" in attributes and f"WEIGHTS_{k}" in attributes:
                which = self._attribute(f"JOINTS_{k}", attributes, n, place).astype(np.int64)
                weights = self._attribute(f"WEIGHTS_{k}", attributes, n, place).astype(np.float64)
                if which.size and not 0 <= which.min() <= which.max() < len(joints):
                    raise self.fail(f"{place} names joint {which.max()}, which is not there: there are {len(joints)}")
                for column in range(which.shape[1]):
                    matrices += weights[:, column, None, None] * joints[which[:, column]]
                    total += weights[:, column]
                k += 1
            matrices = np.where(
                total[:, None, None] > 0, matrices / np.where(total > 0, total, 1)[:, None, None], np.eye(4)
            )
            positions = np.einsum("nij,nj->ni", matrices[:, :3, :3], positions) + matrices[:, :3, 3]
            normals = None if normals is None else np.einsum("nij,nj->ni", matrices[:, :3, :3], normals)
            return positions, normals, bool(n) and float(np.median(np.linalg.det(matrices[:, :3, :3]))) < 0
        world = self.worlds[index]
        linear, determinant = world[:3, :3], float(np.linalg.det(world[:3, :3]))
        positions = positions @ linear.T + world[:3, 3]
        if normals is not None:
            normals = normals @ np.linalg.inv(linear) if determinant else None
        return positions, normals, determinant < 0

    # ---- colours
    def _colours(
        self, primitive: dict[str, Any], place: str, n: int
    ) -> tuple[FloatArray, FloatArray | None, NDArray[np.uint8] | None]:
        """Linear colours (V, 3) that multiply the texture, uv (V, 2) from the lower left, and the texture or None."""
        attributes = primitive["attributes"]
        factor, info = self._material(primitive.get("material"))
        colours = np.tile(factor, (n, 1))
        if "COLOR_0" in attributes:
            colours = colours * self._attribute("COLOR_0", attributes, n, place)[:, :3]
        if info is None:
            return colours, None, None
        transform = info.get("extensions", {}).get("KHR_texture_transform", {})
        name = f"TEXCOORD_{transform.get('texCoord', info.get('texCoord', 0))}"
        if name not in attributes:
            self.note(f"{place} has a texture and no {name}: the texture is left out")
            return colours, None, None
        texture, sampler = self._texture(info["index"])
        if texture is None:
            return colours, None, None
        uv = self._attribute(name, attributes, n, place).astype(np.float64)
        uv = uv * np.array(transform.get("scale", (1, 1)), float)
        angle = float(transform.get("rotation", 0.0))
        # counter-clockwise where v points down, as renderers agree; the extension's text has the other sign in its code
        uv = uv @ np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        uv = uv + np.array(transform.get("offset", (0, 0)), float)
        wraps = [sampler.get(key, REPEAT) for key in ("wrapS", "wrapT")]
        outside = ((uv < -1e-3) | (uv > 1 + 1e-3)).any(0)
        if any(wrap != REPEAT and out for wrap, out in zip(wraps, outside, strict=True)):
            self.note(f"{place}: its texture repeats beyond its edges, where the file mirrors or ends it")
        return colours, np.stack([uv[:, 0], 1 - uv[:, 1]], -1), texture

    def _material(self, index: Any) -> tuple[FloatArray, dict[str, Any] | None]:
        """Return the linear base colour (3,) of a material, and where its texture is; white for what states none."""
        if index is None:
            return np.ones(3), None
        material = self.item("materials", index)
        name = f"the material {short(material.get('name', index))}"
        if material.get("alphaMode", "OPAQUE") != "OPAQUE":
            self.note(f"{name} is opaque, not {material['alphaMode']}")
        if any(material.get("emissiveFactor", ())):
            self.note(f"{name} does not emit light")
        extensions = material.get("extensions", {})
        older = extensions.get("KHR_materials_pbrSpecularGlossiness")
        base = material.get("pbrMetallicRoughness", {}) if older is None else older
        keys = ("baseColorFactor", "baseColorTexture") if older is None else ("diffuseFactor", "diffuseTexture")
        factor = np.array(base.get(keys[0], (1, 1, 1, 1)), float)
        if factor.shape not in ((4,), (3,)):
            raise self.fail(f"{name} has the colour {short(base[keys[0]])}")
        return factor[:3], base.get(keys[1])

    def _texture(self, index: Any) -> tuple[NDArray[np.uint8] | None, dict[str, Any]]:
        """Return the pixels of a texture, None where only an extension has them, and its sampler."""
        texture = self.item("textures", index)
        sampler = self.item("samplers", texture["sampler"]) if "sampler" in texture else {}
        webp = texture.get("extensions", {}).get("EXT_texture_webp", {})
        source = texture.get("source", webp.get("source"))
        if source is None:
            names = " and ".join(texture.get("extensions", {})) or "no source"
            self.note(f"textures[{index}] is left out: it has {names}")
            return None, sampler
        if source not in self.images:
            image = self.item("images", source)
            if "bufferView" in image:
                content, name = self.view(image["bufferView"])[0], f"images[{source}]"
            else:
                content = self._uri(image["uri"], "its texture")
                name = f"images[{source}]" if image["uri"].startswith("data:") else unquote(image["uri"])
            self.images[source] = texture_of(content, name, self.path)
        return self.images[source], sampler


def _triangles(order: NDArray[Any], mode: int) -> NDArray[Any]:
    """Faces (F, 3) of a list, a strip or a fan of vertices (3.7.2.1 of the specification)."""
    if mode == 4:
        return order[: len(order) // 3 * 3].reshape(-1, 3)
    i = np.arange(max(len(order) - 2, 0))
    if mode == 5:
        return np.stack([order[i], order[i + 1 + i % 2], order[i + 2 - i % 2]], -1)
    return np.stack([order[i + 1], order[i + 2], np.broadcast_to(order[:1], i.shape)], -1)
