"""Materials, an atlas's page and a finish as a principled surface; and daylight: the sun, a clear sky after its height, and a
few clouds."""

from __future__ import annotations

from typing import Any

import bpy
import mathutils
import numpy as np
from numpy.typing import NDArray

from ..paint.light import LAMP_COLOUR, LAMP_DROP_M, SUN, SUN_SPREAD_RAD, StreetLight, clouds
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


SUN_STRENGTH = 4.2
SUN_COLOUR = (1.0, 0.93, 0.83)
SKY_STRENGTH, VISIBLE_SKY_STRENGTH = 0.115, 0.07
"""Of the light that it sheds, and of what a camera sees of it: an exposure that suits a street would
lose its colour."""
CLOUD_LIGHT, MAX_CLOUD_COVER = 9.0, 0.75
"""A cloud's light, in the sky's own units, and how much of the sky behind it the thickest takes."""
CLOUD_ROWS = 512


NIGHT_LIGHT, LAMP_WATTS = 1.4, 1200.0
"""Of a night's sky and moon, for each unit of the exact street's light; of a lamp."""


def add_night(scene: bpy.types.Scene, light: StreetLight) -> None:
    """Give a scene a moon, a sky of one colour and lamps, where the exact street's are."""
    moon = np.maximum(light.sun, 1e-9)
    _add_sun(scene, NIGHT_LIGHT * float(moon.max()), tuple(moon / moon.max()))
    for number, place in enumerate(light.lamps):
        lamp = bpy.data.lights.new(f"lamp {number}", "POINT")
        lamp.energy, lamp.color, lamp.shadow_soft_size = LAMP_WATTS, LAMP_COLOUR, 0.05
        hung = bpy.data.objects.new(lamp.name, lamp)
        hung.location = place - [0.0, 0.0, LAMP_DROP_M]
        scene.collection.objects.link(hung)
    world = bpy.data.worlds.new("sky")
    scene.world = world
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (*light.horizon, 1.0)


def _add_sun(scene: bpy.types.Scene, strength: float, colour: tuple[float, ...]) -> None:
    lamp = bpy.data.lights.new("sun", "SUN")
    lamp.energy, lamp.color, lamp.angle = strength, colour, 2 * SUN_SPREAD_RAD
    sun = bpy.data.objects.new("sun", lamp)
    sun.rotation_mode = "QUATERNION"
    sun.rotation_quaternion = mathutils.Vector(SUN).to_track_quat("Z", "Y")  # a sun shines along its -z
    scene.collection.objects.link(sun)


def add_daylight(scene: bpy.types.Scene) -> None:
    """Give a scene its light; the sun stands where the exact street's does."""
    _add_sun(scene, SUN_STRENGTH, SUN_COLOUR)
    world = bpy.data.worlds.new("sky")
    scene.world = world
    tree = world.node_tree
    tree.nodes.clear()
    sky = tree.nodes.new("ShaderNodeTexSky")
    sky.sky_type, sky.sun_disc = "MULTIPLE_SCATTERING", False
    sky.sun_elevation = float(np.arcsin(SUN[2]))
    sky.sun_rotation = float(np.arctan2(SUN[0], SUN[1]))  # clockwise from +y
    light = tree.nodes.new("ShaderNodeBackground")
    tree.links.new(_clouded(tree, sky.outputs["Color"]), light.inputs["Color"])
    seen = tree.nodes.new("ShaderNodeMapRange")
    seen.inputs["To Min"].default_value, seen.inputs["To Max"].default_value = SKY_STRENGTH, VISIBLE_SKY_STRENGTH
    tree.links.new(tree.nodes.new("ShaderNodeLightPath").outputs["Is Camera Ray"], seen.inputs["Value"])
    tree.links.new(seen.outputs["Result"], light.inputs["Strength"])
    end = tree.nodes.new("ShaderNodeOutputWorld")
    tree.links.new(light.outputs["Background"], end.inputs["Surface"])


def _clouded(tree: Any, sky: Any) -> Any:
    """The sky's colour with clouds."""
    cover = tree.nodes.new("ShaderNodeTexEnvironment")
    cover.image = _cloud_image()
    mix = tree.nodes.new("ShaderNodeMix")
    mix.data_type, mix.clamp_factor = "RGBA", True
    colours = [socket for socket in mix.inputs if socket.type == "RGBA"]
    tree.links.new(cover.outputs["Color"], mix.inputs[0])
    tree.links.new(sky, colours[0])
    colours[1].default_value = (CLOUD_LIGHT, CLOUD_LIGHT, CLOUD_LIGHT, 1.0)
    return next(socket for socket in mix.outputs if socket.type == "RGBA")


def _cloud_image() -> bpy.types.Image:
    """How much cloud there is all round, on the panorama that Cycles looks directions up in: u falls
    from +x over +y."""
    height, width = CLOUD_ROWS, 2 * CLOUD_ROWS
    rise, turn = np.meshgrid(
        ((np.arange(height) + 0.5) / height - 0.5) * np.pi,
        (0.5 - (np.arange(width) + 0.5) / width) * 2 * np.pi,
        indexing="ij",
    )
    directions = np.stack([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)], -1)
    amount = (MAX_CLOUD_COVER * clouds(directions.reshape(-1, 3))).astype(np.float32)
    image = bpy.data.images.new("clouds", width, height, float_buffer=True, is_data=True)
    image.pixels.foreach_set(np.column_stack([amount, amount, amount, np.ones_like(amount)]).reshape(-1))
    image.update()
    image.pack()
    return image
