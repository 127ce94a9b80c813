"""Materials: an atlas's page and a finish as a principled surface."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..paint.materials import Finish

GLASS_ROUGHNESS = 0.015
GLASS_COAT = 1.0


def image_of(name: str, page: NDArray[np.uint8]) -> bpy.types.Image:
    """A page (H, W, 4) as an image: sRGB, its fourth channel a number beside."""
    height, width = page.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=True)
    image.alpha_mode = "CHANNEL_PACKED"
    image.pixels.foreach_set((page.astype(np.float32) / 255).reshape(-1))
    image.update()
    image.pack()
    return image


def material_of(name: str, image: bpy.types.Image, finish: Finish, glass: bool) -> bpy.types.Material:
    """The finish's surface with the image's colour; with ``glass`` it mirrors as a pane does where the fourth
    channel says so."""
    material = bpy.data.materials.new(name)
    tree = material.node_tree
    tree.nodes.clear()
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image, texture.interpolation, texture.extension = image, "Linear", "EXTEND"
    shader = tree.nodes.new("ShaderNodeBsdfPrincipled")
    tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    inputs = {
        "Roughness": (finish.roughness, GLASS_ROUGHNESS),
        "Metallic": (finish.metallic, 0.0),
        "Coat Weight": (finish.coat, GLASS_COAT),
    }
    for socket, (plain, pane) in inputs.items():
        shader.inputs[socket].default_value = plain
        if glass:
            tree.links.new(_between(tree, texture.outputs["Alpha"], plain, pane), shader.inputs[socket])
    shader.inputs["Coat Roughness"].default_value = 0.03
    if finish.grain_m > 0:
        tree.links.new(_grain(tree, finish), shader.inputs["Normal"])
    end = tree.nodes.new("ShaderNodeOutputMaterial")
    surface = shader.outputs["BSDF"]
    if finish.translucent > 0:
        shader.inputs["Specular IOR Level"].default_value = 0.25
        through = tree.nodes.new("ShaderNodeBsdfTranslucent")
        tree.links.new(texture.outputs["Color"], through.inputs["Color"])
        both = tree.nodes.new("ShaderNodeMixShader")
        both.inputs["Fac"].default_value = finish.translucent
        tree.links.new(surface, both.inputs[1])
        tree.links.new(through.outputs["BSDF"], both.inputs[2])
        surface = both.outputs["Shader"]
    tree.links.new(surface, end.inputs["Surface"])
    return material


def _between(tree: Any, fraction: Any, low: float, high: float) -> Any:
    """A socket that is ``low`` where the fraction is 0 and ``high`` where it is 1."""
    node = tree.nodes.new("ShaderNodeMapRange")
    tree.links.new(fraction, node.inputs["Value"])
    node.inputs["To Min"].default_value, node.inputs["To Max"].default_value = low, high
    return node.outputs["Result"]


def _grain(tree: Any, finish: Finish) -> Any:
    """A normal roughened by bumps of the finish's size."""
    place = tree.nodes.new("ShaderNodeTexCoord")
    noise = tree.nodes.new("ShaderNodeTexNoise")
    noise.inputs["Scale"].default_value = 1.0 / finish.grain_m
    noise.inputs["Detail"].default_value = 1.0
    tree.links.new(place.outputs["Object"], noise.inputs["Vector"])
    bump = tree.nodes.new("ShaderNodeBump")
    bump.inputs["Distance"].default_value = finish.grain_height_m
    tree.links.new(noise.outputs["Fac"], bump.inputs["Height"])
    return bump.outputs["Normal"]
