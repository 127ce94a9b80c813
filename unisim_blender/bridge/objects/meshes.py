"""Ordinary mesh objects that stand in a drive as actors: their shape, colours and textures as core's models, and objects
made of those.

An actor is one object with all that is parented to it, so a car of a hundred parts under one empty is one actor."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ...core.colour import bytes_from_srgb, srgb_from_linear
from ...core.errors import ScenarioError
from ...core.geometry import FloatArray, invert_pose
from ...core.meshes.model import FLAT, MeshModel, centred, check_model
from ...editing.sampled.scene import UNIT, Factors, Scaling, refusal, rigid, scale_text, scaling_of, size_text
from ...editing.texts import Text
from .trajectories import trajectory_of

SHAPES = ("MESH", "CURVE", "SURFACE", "META", "FONT")
MAX_TEXTURE_EDGE = 2048
"""Larger textures are thinned."""
MAX_TEXTURES = 32
"""Number of Blender's images that are cached as core has them."""
DEFAULT_ALBEDO = 0.8
"""Linear albedo of surfaces that have neither material nor colours."""
FORWARD = {"X": (1.0, 0.0), "-X": (-1.0, 0.0), "Y": (0.0, 1.0), "-Y": (0.0, -1.0)}
"""Directions in the world's plane."""


def parts(obj: bpy.types.Object) -> Iterator[bpy.types.Object]:
    """Yield an object and its children, those that have a surface and are rendered."""
    for part in (obj, *obj.children_recursive):
        if part.type in SHAPES and not part.hide_render:
            yield part


def mesh_model_of(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> tuple[MeshModel, FloatArray]:
    """An actor's model about the middle of its extent, in the object's axes without its scale; and where
    that middle is (3,).

    Raises `ScenarioError` where there is nothing to render.
    """
    textures: list[NDArray[np.uint8]] = []
    pieces = []
    for part in parts(obj):
        evaluated = part.evaluated_get(depsgraph)
        mesh = evaluated.to_mesh()
        if mesh is not None and len(mesh.polygons):
            pieces.append(_piece(mesh, within(evaluated, obj.evaluated_get(depsgraph)), textures))
        evaluated.to_mesh_clear()
    if not pieces:
        raise ScenarioError(f'object "{obj.name}": is an actor without any surface')
    first = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    joined: dict[str, Any] = {
        field.name: np.concatenate([getattr(piece, field.name) for piece in pieces])
        for field in fields(MeshModel)
        if field.name != "textures"
    }
    joined["faces"] = np.concatenate([piece.faces + np.int32(at) for piece, at in zip(pieces, first, strict=False)])
    model = MeshModel(**joined, textures=tuple(textures))
    check_model(model, Path(f'object "{obj.name}"'))
    return centred(model)


def size_of(obj: bpy.types.Object) -> FloatArray:
    """Return the size (3,) of an object as it is drawn, in metres along its own axes, as it was evaluated last; of an
    actor that is a mesh, with all its parts."""
    return extent_of(obj) * (1.0 if obj.unisim.mesh else np.array(scale_of(obj)))


def scale_of(obj: bpy.types.Object) -> Factors:
    """Return an object's scale (3,) along its own axes, beside its data, as it was evaluated last."""
    world = np.array(obj.matrix_world, float)[None]
    return scaling_of(world, rigid(world)).factors


def scaled_sentence(obj: bpy.types.Object) -> str:
    """Return what it means that an actor was scaled, as a sentence."""
    world = np.array(obj.matrix_world, float)[None]
    scaling = Scaling() if obj.unisim.mesh else scaling_of(world, rigid(world))
    size = size_text(size_of(obj).tolist())
    if fault := refusal(obj.name, scaling):
        return fault
    if scaling.factors == UNIT:
        return Text("{name}: measures {size}", name=obj.name, size=size)
    factors = scale_text(scaling.factors)
    return Text(
        "{name}: is scaled by {factors} to {size}; its underside stays where it was",
        name=obj.name,
        factors=factors,
        size=size,
    )


def extent_of(obj: bpy.types.Object) -> FloatArray:
    """An object's extent (3,) along its own axes without its scale; of an actor that is a mesh, with it
    and all its parts."""
    if not obj.unisim.mesh:
        return np.ptp(np.array(obj.bound_box, float), axis=0)
    corners = corners_of(obj, lambda part: within(part, obj))
    return np.ptp(corners, axis=0) if len(corners) else np.zeros(3)


def corners_of(obj: bpy.types.Object, placed: Callable[[bpy.types.Object], FloatArray]) -> FloatArray:
    """Corners (8 P, 3) of the boxes round an object's parts, each where ``placed`` (4, 4) puts it."""
    corners = [np.zeros((0, 3))]
    for part in parts(obj):
        whole = placed(part)
        corners.append(np.array(part.bound_box, float) @ whole[:3, :3].T + whole[:3, 3])
    return np.concatenate(corners)


def within(part: bpy.types.Object, obj: bpy.types.Object) -> FloatArray:
    """From a part's own coordinates to the axes of ``obj``, which it belongs to, with that one's scale (4, 4).

    Along the parents where they alone place it: matrices in the world are float32, and a model must not
    change as it drives.
    """
    whole, above = np.eye(4), part
    while above is not None and above.name != obj.name and above.parent_type == "OBJECT" and not above.constraints:
        whole = np.array(above.matrix_parent_inverse, float) @ np.array(above.matrix_basis, float) @ whole
        above = above.parent
    # neither a trajectory nor the ego vehicle has a scale
    scaled = obj.parent is not None and trajectory_of(obj) is None and obj.parent.unisim.kind != "EGO"
    if above is None or above.name != obj.name or scaled or obj.constraints:
        world = np.array(obj.matrix_world, float)
        return np.asarray(invert_pose(rigid(world)) @ np.array(part.matrix_world, float))
    return np.asarray(np.diag([*obj.scale, 1.0]) @ whole)


def _piece(mesh: bpy.types.Mesh, whole: FloatArray, textures: list[NDArray[np.uint8]]) -> MeshModel:
    """One part's triangles after ``whole`` (4, 4). Its images are added to ``textures``."""
    mesh.calc_loop_triangles()
    count = len(mesh.loop_triangles)
    vertices = _got(mesh.vertices, "co", 3) @ whole[:3, :3].T + whole[:3, 3]
    faces = _got(mesh.loop_triangles, "vertices", 3, np.int32)
    loops = _got(mesh.loop_triangles, "loops", 3, np.int32)
    slots = _got(mesh.loop_triangles, "material_index", 1, np.int32)[:, 0]
    turn = np.linalg.inv(whole[:3, :3])  # normals go with the inverse transpose
    normals = (_got(mesh.corner_normals, "vector", 3) @ turn)[loops]
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    layer = mesh.uv_layers.active
    uv = np.zeros((count, 3, 2)) if layer is None else _got(layer.uv, "vector", 2)[loops]
    colours, texture = np.ones((count, 3, 3)), np.full(count, FLAT)
    materials = list(mesh.materials) or [None]
    for slot, material in enumerate(materials):
        mine = np.minimum(slots, len(materials) - 1) == slot
        if not mine.any():
            continue
        base, base_image, painted = surface_of(material)
        attribute = mesh.color_attributes.active_color if painted else None
        colours[mine] = DEFAULT_ALBEDO if material is None and attribute is None else base
        if attribute is not None:
            at = faces if attribute.domain == "POINT" else loops
            colours[mine] *= _got(attribute.data, "color", 4)[at[mine]][..., :3]
        if base_image is not None and layer is not None:
            texture[mine] = len(textures)
            textures.append(pixels_of(base_image))
    return MeshModel(
        vertices.astype(np.float32), faces, normals.astype(np.float32), np.clip(colours, 0, 1).astype(np.float32),
        uv.astype(np.float32), texture.astype(np.int32),
    )  # fmt: skip


def surface_of(material: bpy.types.Material | None) -> tuple[FloatArray, bpy.types.Image | None, bool]:
    """A material's base colour (3,), linear; the image that multiplies it; whether the mesh's colour attribute does."""
    if material is None:
        return np.ones(3), None, True
    tree = material.node_tree
    shader = next((node for node in tree.nodes if node.type == "BSDF_PRINCIPLED"), None) if tree is not None else None
    if shader is None:
        return np.array(material.diffuse_color[:3], float), None, False
    socket = shader.inputs["Base Color"]
    before = list(_before(socket))
    base_image = next((node.image for node in before if node.type == "TEX_IMAGE" and node.image is not None), None)
    painted = any(node.type in ("VERTEX_COLOR", "ATTRIBUTE") for node in before)
    base = np.ones(3) if before else np.array(socket.default_value[:3], float)
    return base, base_image, painted


def pixels_of(image: bpy.types.Image) -> NDArray[np.uint8]:
    """An image's colours (H, W, 3) sRGB, top row first."""
    key = image.name_full, image.filepath, tuple(image.size), image.is_dirty
    pixels = None if image.is_dirty else _textures.get(key)
    if pixels is None:
        width, height = image.size
        values = np.empty(width * height * image.channels, np.float32)
        image.pixels.foreach_get(values)
        step = -(-max(width, height) // MAX_TEXTURE_EDGE) or 1
        shown = values.reshape(height, width, image.channels)[::-step, ::step]
        shown = np.repeat(shown, 3, -1) if image.channels == 1 else shown[..., :3]
        pixels = bytes_from_srgb(srgb_from_linear(shown) if image.is_float else shown)
        if len(_textures) >= MAX_TEXTURES:
            _textures.clear()
        _textures[key] = pixels
    return pixels


_textures: dict[tuple[Any, ...], NDArray[np.uint8]] = {}


def _before(socket: bpy.types.NodeSocket) -> Iterator[bpy.types.Node]:
    """The nodes that a socket's value comes from."""
    seen: set[str] = set()
    waiting = [link.from_node for link in socket.links]
    while waiting:
        node = waiting.pop()
        if node.name not in seen:
            seen.add(node.name)
            yield node
            waiting += [link.from_node for entry in node.inputs for link in entry.links]


def _got(collection: Any, name: str, width: int, kind: type = np.float32) -> NDArray[Any]:
    values: NDArray[Any] = np.empty(len(collection) * width, kind)
    collection.foreach_get(name, values)
    return values.reshape(-1, width)


def make_actor(obj: bpy.types.Object, label: str, forward: str) -> None:
    """Let an object with all its parts be an actor that points ``forward`` (a key of `FORWARD`, or "AUTO": as it is
    long) as it stands there. Its origin goes to the middle of its extent, its axes forward, left and up, its
    scale into its mesh."""
    corners = corners_of(obj, lambda part: np.array(part.matrix_world, float))
    low, high = corners.min(0), corners.max(0)
    if forward == "AUTO":
        forward = "X" if high[0] - low[0] >= high[1] - low[1] else "Y"
    x, y = FORWARD[forward]
    stands = Matrix.Translation((low + high) / 2) @ Matrix(((x, -y, 0, 0), (y, x, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)))
    if obj.animation_data is None and obj.parent is None:
        inner = stands.inverted() @ obj.matrix_world
        if obj.data is not None and hasattr(obj.data, "transform"):
            if obj.data.users > 1:
                obj.data = obj.data.copy()
            obj.data.transform(inner)
        for child in obj.children:
            child.matrix_parent_inverse = inner @ child.matrix_parent_inverse
        obj.rotation_mode = "QUATERNION"
        obj.matrix_world = stands
    about = obj.unisim
    about.kind, about.mesh, about.label = "ACTOR", True, label
    about.uid = about.home = about.look = about.look_scene = ""
    about.rest_scale, about.scale_lift_m = obj.scale, 0.0


def object_of(name: str, model: MeshModel, label: str) -> bpy.types.Object:
    """An object that shows a model, as the shape of an actor of that class; in no collection yet."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(model.vertices.tolist(), [], model.faces.tolist())
    mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", model.uv.ravel())
    painted = mesh.color_attributes.new("Color", "FLOAT_COLOR", "CORNER")
    painted.data.foreach_set("color", np.concatenate([model.colours, np.ones((len(model.faces), 3, 1))], -1).ravel())
    slots = sorted(set(model.texture.tolist()))
    for slot in slots:
        mesh.materials.append(_material(name, model, slot))
    mesh.polygons.foreach_set("material_index", np.searchsorted(slots, model.texture).astype(np.int32))
    mesh.polygons.foreach_set("use_smooth", np.ones(len(model.faces), bool))
    mesh.normals_split_custom_set(model.normals.reshape(-1, 3).tolist())
    mesh.update()
    obj = bpy.data.objects.new(name, mesh)
    obj.rotation_mode = "QUATERNION"
    obj.unisim.kind, obj.unisim.mesh, obj.unisim.label = "ACTOR", True, label
    return obj


def _material(name: str, model: MeshModel, slot: int) -> bpy.types.Material:
    """A material whose base colour is the mesh's colours, times a texture where the slot has one."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    paint = nodes.new("ShaderNodeVertexColor")
    paint.layer_name = "Color"
    colour = paint.outputs["Color"]
    if slot != FLAT:
        texture = nodes.new("ShaderNodeTexImage")
        texture.image = _image(f"{name} {slot}", model, slot)
        mix = nodes.new("ShaderNodeMixRGB")
        mix.blend_type = "MULTIPLY"
        mix.inputs[0].default_value = 1.0
        links.new(colour, mix.inputs[1])
        links.new(texture.outputs["Color"], mix.inputs[2])
        colour = mix.outputs[0]
    links.new(colour, shader.inputs["Base Color"])
    return material


def _image(name: str, model: MeshModel, slot: int) -> bpy.types.Image:
    shown = model.textures[slot][::-1].astype(np.float32) / 255
    height, width = shown.shape[:2]
    image = bpy.data.images.new(name, width, height)
    image.pixels.foreach_set(np.concatenate([shown, np.ones((height, width, 1), np.float32)], -1).ravel())
    image.pack()
    return image
