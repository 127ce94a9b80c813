"""A sequence's stores and components: checked before NCore's package trusts them, opened once, read when asked for.

Arrays are decoded by `read_array` alone: a zarr array may name a codec that unpickles, and may lack the chunks that it promises.
"""

from __future__ import annotations

import lzma
import os
import struct
import tarfile
from collections.abc import Iterator
from contextlib import contextmanager
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

from ...errors import LogError, UnisimError, in_a_line
from ...json_file import Node, members_of, read_json
from . import is_store, stores_beside
from .sweeps import Bundle

MOST_BYTES = 1 << 28
"""Of a store's index, and of one array, unpacked."""
CODECS = {"blosc", "lz4", "zlib", "zstd", "gzip"}
"""Codecs that only unpack bytes."""
INDEX = struct.Struct("<4sIQI")
"""The last block of a .itar file: "itar", a type, and the offset and size of its index."""


@contextmanager
def as_log_error(path: Path | str, what: str = "cannot be read") -> Iterator[None]:
    """Turn whatever NCore's package and zarr raise at a broken file into one `LogError` that names it."""
    try:
        yield
    except (UnisimError, ModuleNotFoundError):
        raise
    except Exception as fault:  # noqa: BLE001  the libraries assert, and pass on what theirs raise
        raise LogError(f"{path}: {what} ({in_a_line(fault)})") from fault


def sequence_stores(path: Path) -> list[Path]:
    """Return the stores of a sequence: those that its JSON file lists, or else those beside it. Raises `LogError`."""
    stores = stores_beside(path)
    document = path if path.suffix == ".json" else _document(stores)
    if document is not None:
        node = Node(read_json(document, LogError), f"{document}: ", LogError)
        listed = [(entry.key("path"), entry.key("path").text()) for entry in node.key("component_stores").elements()]
        for place, name in listed:
            if Path(name).name != name or not is_store(Path(name)):
                place.fail(f"must be the name of a store beside the file, not {name!r:.80}")
            if not (document.parent / name).exists():
                raise LogError(f"{document.parent / name}: is missing; {document.name} lists it")
        stores = [document.parent / name for _, name in listed]
    if not stores:
        raise LogError(f"{path}: has no stores")
    return stores


def check_index(path: Path) -> int | None:
    """Check that a .itar file ends with an index that unpacks to a size that can be held, and return where the index begins; None
    for a store that is a folder. Raises `LogError`."""
    if path.is_dir():
        return None
    try:
        size = path.stat().st_size
        with path.open("rb") as stream:
            stream.seek(max(0, size - tarfile.BLOCKSIZE))
            block = stream.read(INDEX.size)
            if len(block) < INDEX.size or block[:4] != b"itar":
                raise LogError(f"{path}: is cut off or no store: it does not end with an index")
            _, _, offset, packed = INDEX.unpack(block)
            if offset + packed > size:
                raise LogError(f"{path}: is cut off: its index lies beyond its end")
            stream.seek(offset)
            unpacker = lzma.LZMADecompressor()
            unpacker.decompress(stream.read(packed), max_length=MOST_BYTES)
    except OSError as fault:
        raise LogError(f"{path}: cannot be read ({fault.strerror})") from fault
    except (lzma.LZMAError, EOFError) as fault:
        raise LogError(f"{path}: its index is broken ({in_a_line(fault)})") from fault
    if not unpacker.eof:
        raise LogError(f"{path}: its index is broken or too large: it does not end within {MOST_BYTES >> 20} MiB")
    return int(offset)


def read_array(array: Any, path: Path, where: str, kinds: str) -> NDArray[Any]:
    """Return a zarr array's values, of a dtype of one of the ``kinds``. Raises `LogError` naming the store and the place."""
    with as_log_error(path, f"{where} cannot be read"):
        if array.dtype.kind not in kinds or array.nbytes > MOST_BYTES:
            raise LogError(f"{path}: {where} is {array.dtype} {array.shape}, which is refused")
        codec = None if array.compressor is None else array.compressor.codec_id
        if array.filters or not (codec is None or codec in CODECS):
            raise LogError(f"{path}: {where} is packed in a way that is refused")
        for chunk in np.ndindex(*array.cdata_shape):
            key = f"{array.path}/{'.'.join(map(str, chunk)) or '0'}"
            if key not in array.chunk_store:
                raise LogError(f"{path}: {where} lacks its part {key.rpartition('/')[2]}")
        return np.asarray(array[...])


def _document(stores: list[Path]) -> Path | None:
    """The sequence's JSON file beside its stores, where there is one."""
    for store in stores:
        beside = store.parent / f"{store.name.partition('.ncore4')[0]}.json"
        if beside.is_file():
            return beside
    return None


DEFAULT = "default"
"""The name of the instance of poses, intrinsics, masks and cuboids that NCore's loader takes."""
DROPS = "unisim_drops"
IMAGE_FORMATS = ("JPEG", "PNG")


class _Cuboids(CuboidsComponent.Reader):
    def observations(self) -> Iterator[Any]:
        """Yield the observations as they are written; NCore's own decoder takes a millisecond for each."""
        attributes = self._group["cuboids"].attrs
        return members_of(bytes(attributes.store[attributes.key]).decode(), "cuboid_track_observations")


class _Masks(MasksComponent.Reader):
    def named(self, camera: str, name: str) -> Any:
        """Return the array of a camera's mask, None where there is none."""
        cameras = self._group.get("cameras")
        group = None if cameras is None else cameras.get(camera)
        return None if group is None or name not in group.attrs.get("mask_names", []) else group[name]


class _Camera(CameraSensorComponent.Reader):
    def frame(self, end_us: int) -> Any:
        return self._get_frame_group(end_us)


class _Lidar(LidarSensorComponent.Reader):
    def frame(self, end_us: int) -> Any:
        return self._get_frame_group(end_us)


class _Store(SequenceComponentGroupsReader):
    """One store of a sequence. Its description is read part by part: all of it at once takes seconds for a long sequence."""

    def __init__(self, path: Path, index_at: int | None) -> None:
        super().__init__([path], open_consolidated=False, max_threads=1)
        (self.root, _), *_ = self._component_stores.values()
        if index_at is not None:
            for record in self.root.store.index.records.values():
                if not 0 <= record.offset_data <= record.offset_data + record.size <= index_at:
                    raise LogError(f"{path}: is cut off: it has a part beyond its end")

    def names(self) -> list[tuple[str, str]]:
        """Return kind and name of each of its components, sorted."""
        if hasattr(self.root.store, "index"):
            # NCore asks zarr for each kind's, which goes through all parts of the store every time
            parts = (key.split("/", 2) for key in self.root.store.index.records)
            return sorted({(part[0], part[1]) for part in parts if len(part) == 3})
        return sorted((kind, name) for kind, group in self.root.groups() for name in group.group_keys())


@dataclass(frozen=True)
class StoredComponent:
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
        self._opened_stores: list[tuple[_Store, Path]] = []
        self._names: dict[tuple[str, str], tuple[_Store, Path]] = {}
        for path in self.stores:
            index_at = check_index(path)
            with as_log_error(path):
                store = _Store(path, index_at)
                for component in store.names():
                    if component in self._names:
                        raise LogError(
                            f"{path}: holds {component[1]!r:.80}, and so does {self._names[component][1].name}"
                        )
                    self._names[component] = store, path
            self._opened_stores.append((store, path))
        about = [(store.sequence_id, store.sequence_timestamp_interval_us) for store, _ in self._opened_stores]
        for other, (_, path) in zip(about, self._opened_stores, strict=True):
            if other != about[0]:
                raise LogError(f"{path}: is of another sequence or time than {self.stores[0].name}")
        self.name = str(about[0][0])
        self.meta: object = self._opened_stores[0][0].generic_meta_data
        self.left_out: list[str] = []
        self.cameras = self._opened(_Camera)
        self.lidars = self._opened(_Lidar)
        self.poses = self._single(PosesComponent.Reader, "poses")
        self.intrinsics = (
            self._single(IntrinsicsComponent.Reader, "intrinsics") if self.cameras or self.lidars else None
        )
        self.cuboids = self._any(_Cuboids)
        self.masks = self._any(_Masks)

    def stamps(self, sensor: StoredComponent, name: str) -> NDArray[np.int64]:
        """Return start and end (K, 2) of a sensor's frames, microseconds, in the order of their ends. Raises `LogError`."""
        with as_log_error(sensor.path, f"{name}: its frames' times cannot be read"):
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
        with as_log_error(self.intrinsics.path, f"{name}: its intrinsics cannot be read"):
            return self.intrinsics.reader.get_camera_model_parameters(name)

    def lidar_parameters(self, name: str) -> Any:
        """Return NCore's parameters of a LiDAR, None where it has no beam table."""
        assert self.intrinsics is not None
        with as_log_error(self.intrinsics.path, f"{name}: its beam table cannot be read"):
            return self.intrinsics.reader.get_lidar_model_parameters(name)

    def encoded_image(self, name: str, end_us: int) -> bytes:
        """Return an image's file, JPEG or PNG. Raises `LogError`."""
        self._reload()
        camera_part = self.cameras[name]
        where = f"{name}: its image of {end_us} us"
        with as_log_error(camera_part.path, f"{where} cannot be read"):
            array = camera_part.reader.frame(end_us)["image"]
        return _bytes(read_array(array, camera_part.path, where, "SVu"))

    def mask(self, name: str, mask: str) -> bytes | None:
        """Return a camera's mask's file, None where there is none. Raises `LogError`."""
        if self.masks is None:
            return None
        self._reload()
        where = f"{name}: its mask {mask!r}"
        with as_log_error(self.masks.path, f"{where} cannot be read"):
            array = self.masks.reader.named(name, mask)
        return None if array is None else _bytes(read_array(array, self.masks.path, where, "SVu"))

    def bundle(self, name: str, end_us: int) -> Bundle:
        """Return a LiDAR's rays. Raises `LogError`."""
        self._reload()
        lidar_part = self.lidars[name]
        where = f"{name}: its sweep of {end_us} us"
        with as_log_error(lidar_part.path, f"{where} cannot be read"):
            frame = lidar_part.reader.frame(end_us)
            rays, returns, beside = frame["ray_bundle"], frame["ray_bundle_returns"], frame.get("generic_data")
            more = {} if beside is None else {key: beside[key] for key in beside if key.startswith("unisim_")}
            given = beside is not None and beside.attrs.get(DROPS) is True
            ray = {key: rays[key] for key in ("direction", "timestamp_us")}
            element = rays["model_element"] if "model_element" in rays else None
            back = {key: returns[key] for key in ("distance_m", "intensity")}

        def values(array: Any, key: str, kinds: str) -> NDArray[Any]:
            return read_array(array, lidar_part.path, f"{where}, {key},", kinds)

        return Bundle(
            direction=values(ray["direction"], "direction", "f"),
            timestamp_us=values(ray["timestamp_us"], "timestamp_us", "u"),
            model_element=None if element is None else values(element, "model_element", "u"),
            distance_m=values(back["distance_m"], "distance_m", "f"),
            intensity=values(back["intensity"], "intensity", "f"),
            more={key: values(array, key, "iu") for key, array in more.items()},
            drops_given=given,
        )

    def _opened(self, kind: type[ComponentReader]) -> dict[str, StoredComponent]:
        parts: dict[str, StoredComponent] = {}
        for (component, name), (store, path) in self._names.items():
            if component == kind.get_component_name():
                with as_log_error(path, f"{component}/{name} cannot be read"):
                    group = store.root[component][name]
                    version = group.attrs["component_version"]
                    if kind.supports_component_version(version):
                        parts[name] = StoredComponent(kind(name, group), path)
                    else:
                        self.left_out.append(
                            f"{component}/{name} is left out: nvidia-ncore as installed does not read version {version!r:.40}"
                        )
        return parts

    def _any(self, kind: type[ComponentReader]) -> StoredComponent | None:
        """The instance of a kind that NCore's loader takes, or else the only one; others are told."""
        parts = self._opened(kind)
        chosen = DEFAULT if DEFAULT in parts or not parts else min(parts)
        self.left_out += [
            f"{kind.get_component_name()}/{name} is left out: {chosen!r:.80} is read"
            for name in parts
            if name != chosen
        ]
        return parts.get(chosen)

    def _single(self, kind: type[ComponentReader], what: str) -> StoredComponent:
        parts = self._opened(kind)
        if DEFAULT in parts:
            return parts[DEFAULT]
        if len(parts) == 1:
            return next(iter(parts.values()))
        if parts:
            raise LogError(f"{self.path}: holds {what} of several names")
        why = next(
            (sentence for sentence in self.left_out if sentence.startswith(f"{kind.get_component_name()}/")), None
        )
        raise LogError(f"{self.path}: holds no {what}" + (f" ({why})" if why else ""))

    def _reload(self) -> None:
        """Open the files anew in a forked process: it shares its parent's places in them."""
        if self._process != os.getpid():
            self._process = os.getpid()
            for store, _ in self._opened_stores:
                store.reload_resources()


def _bytes(values: NDArray[Any]) -> bytes:
    return values.tobytes()
