"""A sequence's components, opened once and read when asked for: NCore's own readers, but for how arrays are decoded."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ncore.data.v4 import (
    CameraSensorComponent,
    ComponentReader,
    CuboidsComponent,
    IntrinsicsComponent,
    LidarSensorComponent,
    MasksComponent,
    PosesComponent,
    SequenceComponentGroupsReader,
)
from numpy.typing import NDArray

from ...errors import LogError
from ...json_file import check_finite
from . import files
from .files import check_store, sequence_stores, told
from .sweeps import Bundle

DEFAULT = "default"
"""The name of the instance of poses, intrinsics, masks and cuboids that NCore's loader takes."""
DROPS = "unisim_drops"
IMAGE_FORMATS = ("JPEG", "PNG")


class _Cuboids(CuboidsComponent.Reader):
    def observations(self) -> Any:
        """Return the observations as they are written; NCore's own decoder takes a millisecond for each."""
        return self._group["cuboids"].attrs["cuboid_track_observations"]


class _Masks(MasksComponent.Reader):
    def named(self, camera: str, name: str) -> Any:
        """Return the array of a camera's mask, None where there is none."""
        cameras = self._group.get("cameras")
        group = None if cameras is None else cameras.get(camera)
        return None if group is None or name not in group.attrs.get("mask_names", []) else group[name]


class _Camera(CameraSensorComponent.Reader):
    def frame(self, end_us: int) -> Any:
        """Return the group of a frame."""
        return self._get_frame_group(end_us)


class _Lidar(LidarSensorComponent.Reader):
    def frame(self, end_us: int) -> Any:
        """Return the group of a frame."""
        return self._get_frame_group(end_us)


@dataclass(frozen=True)
class Found:
    """A component's reader, and the store that it lies in."""

    reader: Any
    path: Path

    @property
    def meta(self) -> object:
        """Its free metadata."""
        return self.reader.generic_meta_data


class Components:
    """The components of the sequence at ``path``. Raises `LogError`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.stores = sequence_stores(path)
        self._process = os.getpid()
        self._readers: list[tuple[SequenceComponentGroupsReader, Path]] = []
        for store in self.stores:
            check_store(store)
            with told(store):
                self._readers.append((SequenceComponentGroupsReader([store], max_threads=1), store))
        about = [(reader.sequence_id, reader.sequence_timestamp_interval_us) for reader, _ in self._readers]
        for one, (_, store) in zip(about, self._readers, strict=True):
            if one != about[0]:
                raise LogError(f"{store}: is of another sequence or time than {self.stores[0].name}")
        self.name = str(about[0][0])
        self.meta: object = self._readers[0][0].generic_meta_data
        check_finite(self.meta, f"{self.stores[0]}: ", LogError)
        self.cameras = self._opened(_Camera)
        self.lidars = self._opened(_Lidar)
        self.poses = self._one(PosesComponent.Reader, "poses")
        self.intrinsics = self._one(IntrinsicsComponent.Reader, "intrinsics") if self.cameras or self.lidars else None
        self.cuboids = self._opened(_Cuboids).get(DEFAULT)
        self.masks = self._opened(_Masks).get(DEFAULT)

    def stamps(self, sensor: Found, name: str) -> NDArray[np.int64]:
        """Return start and end (K, 2) of a sensor's frames, microseconds, in the order of their ends. Raises `LogError`."""
        with told(sensor.path, f"{name}: its frames' times cannot be read"):
            times = np.asarray(sensor.reader.frames_timestamps_us)
            if times.size and (times.ndim != 2 or times.shape[1] != 2 or times.max() >= 2**53):
                raise LogError(f"{sensor.path}: {name}: its frames' times are none")
            stamps = times.astype(np.int64).reshape(-1, 2)
        if (stamps[:, 0] > stamps[:, 1]).any() or (np.diff(stamps[:, 1]) <= 0).any():
            raise LogError(f"{sensor.path}: {name}: its frames' times do not increase")
        return stamps

    def camera_parameters(self, name: str) -> Any:
        """Return NCore's parameters of a camera."""
        assert self.intrinsics is not None
        with told(self.intrinsics.path, f"{name}: its intrinsics cannot be read"):
            return self.intrinsics.reader.get_camera_model_parameters(name)

    def lidar_parameters(self, name: str) -> Any:
        """Return NCore's parameters of a LiDAR, None where it has no beam table."""
        assert self.intrinsics is not None
        with told(self.intrinsics.path, f"{name}: its beam table cannot be read"):
            return self.intrinsics.reader.get_lidar_model_parameters(name)

    def encoded_image(self, name: str, end_us: int) -> bytes:
        """Return an image's file, JPEG or PNG. Raises `LogError`."""
        self._reload()
        found = self.cameras[name]
        where = f"{name}: its image of {end_us} us"
        with told(found.path, f"{where} cannot be read"):
            array = found.reader.frame(end_us)["image"]
        return _bytes(files.read_array(array, found.path, where, "SVu"))

    def mask(self, name: str, mask: str) -> bytes | None:
        """Return a camera's mask's file, None where there is none. Raises `LogError`."""
        if self.masks is None:
            return None
        self._reload()
        where = f"{name}: its mask {mask!r}"
        with told(self.masks.path, f"{where} cannot be read"):
            array = self.masks.reader.named(name, mask)
        return None if array is None else _bytes(files.read_array(array, self.masks.path, where, "SVu"))

    def bundle(self, name: str, end_us: int) -> Bundle:
        """Return a LiDAR's rays. Raises `LogError`."""
        self._reload()
        found = self.lidars[name]
        where = f"{name}: its sweep of {end_us} us"
        with told(found.path, f"{where} cannot be read"):
            frame = found.reader.frame(end_us)
            rays, returns, beside = frame["ray_bundle"], frame["ray_bundle_returns"], frame.get("generic_data")
            more = {} if beside is None else {key: beside[key] for key in beside if key.startswith("unisim_")}
            given = beside is not None and beside.attrs.get(DROPS) is True
            ray = {key: rays[key] for key in ("direction", "timestamp_us")}
            element = rays["model_element"] if "model_element" in rays else None
            back = {key: returns[key] for key in ("distance_m", "intensity")}

        def values(array: Any, key: str, kinds: str) -> NDArray[Any]:
            return files.read_array(array, found.path, f"{where}, {key},", kinds)

        return Bundle(
            direction=values(ray["direction"], "direction", "f"),
            timestamp_us=values(ray["timestamp_us"], "timestamp_us", "u"),
            model_element=None if element is None else values(element, "model_element", "u"),
            distance_m=values(back["distance_m"], "distance_m", "f"),
            intensity=values(back["intensity"], "intensity", "f"),
            more={key: values(array, key, "iu") for key, array in more.items()},
            drops_given=given,
        )

    def _opened(self, kind: type[ComponentReader]) -> dict[str, Found]:
        found: dict[str, Found] = {}
        for reader, store in self._readers:
            with told(store):
                for name, one in reader.open_component_readers(kind).items():
                    if name in found:
                        raise LogError(f"{store}: holds {name!r:.80}, and so does {found[name].path.name}")
                    check_finite(one.generic_meta_data, f"{store}: {name}: ", LogError)
                    found[name] = Found(one, store)
        return dict(sorted(found.items()))

    def _one(self, kind: type[ComponentReader], what: str) -> Found:
        found = self._opened(kind)
        if DEFAULT in found:
            return found[DEFAULT]
        if len(found) == 1:
            return next(iter(found.values()))
        raise LogError(f"{self.path}: holds no {what}" if not found else f"{self.path}: holds {what} of several names")

    def _reload(self) -> None:
        """Open the files anew in a forked process: it shares its parent's places in them."""
        if self._process != os.getpid():
            self._process = os.getpid()
            for reader, _ in self._readers:
                reader.reload_resources()


def _bytes(values: NDArray[Any]) -> bytes:
    return values.tobytes()
