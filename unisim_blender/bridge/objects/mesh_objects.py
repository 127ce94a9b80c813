"""Mesh objects made actors, and objects made of core's models."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix

from ...core.meshes.model import FLAT, MeshModel
from .meshes import corners_of

FORWARD = {"X": (1.0, 0.0), "-X": (-1.0, 0.0), "Y": (0.0, 1.0), "-Y": (0.0, -1.0)}
"""Directions in the world's plane."""


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
