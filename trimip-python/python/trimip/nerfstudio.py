"""Cameras of nerfstudio: its world, its camera paths, its dictionaries of intrinsics.

nerfstudio moves and scales a scene before it trains, and stores this map in ``dataparser_transforms.json`` of its run. `World`
inverts the map, so that both programs render the same views.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._trimip import Camera, InputError

__all__ = ["World", "camera_path", "cameras"]


def _read(path: str | os.PathLike[str]) -> dict:
    try:
        with open(path, encoding="utf-8") as file:
            return json.load(file)
    except (OSError, ValueError) as error:
        raise InputError(f"{os.fspath(path)}: {error}; name an existing JSON file of nerfstudio") from error


def _square(matrix: ArrayLike) -> NDArray[np.float64]:
    """Returns [R|t] as a 4×4 matrix."""
    return np.vstack([np.asarray(matrix, dtype=np.float64).reshape(-1, 4)[:3], [0.0, 0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class World:
    """The map from the photographs' world to nerfstudio's: x ↦ scale · (R·x + t)."""

    transform: NDArray[np.float64]
    """[R|t], [3, 4]."""
    scale: float

    @staticmethod
    def load(path: str | os.PathLike[str], transforms: str | os.PathLike[str] | None = None) -> World:
        """Reads a ``dataparser_transforms.json``, given by its path or by the folder of a run.

        The map in this file starts in the world of the COLMAP model. If the photographs' cameras come from a ``transforms.json`` that
        ``ns-process-data`` wrote, pass that file as ``transforms``: its ``applied_transform`` and ``applied_scale`` map COLMAP's world
        to the world of ``transforms.json``.
        """
        path = os.path.join(path, "dataparser_transforms.json") if os.path.isdir(path) else path
        data, applied = _read(path), (_read(transforms) if transforms is not None else {})
        try:
            transform = _square(data["transform"]) @ np.linalg.inv(_square(applied.get("applied_transform", np.eye(4)[:3])))
            return World(transform[:3], float(data["scale"]) / float(applied.get("applied_scale", 1.0)))
        except (KeyError, TypeError, ValueError, np.linalg.LinAlgError) as error:
            raise InputError(f"{os.fspath(path)}: no transform [3, 4] and scale; {error}") from error

    def back(self, poses: ArrayLike) -> NDArray[np.float64]:
        """Maps poses of nerfstudio's world, [..., 3 or 4, 4], to the world of the photographs, [..., 3, 4]."""
        poses = np.asarray(poses, dtype=np.float64)[..., :3, :]
        rotation, shift = self.transform[:, :3], self.transform[:, 3]
        own = np.empty(poses.shape)
        own[..., :3] = rotation.T @ poses[..., :3]
        own[..., 3] = (poses[..., 3] / self.scale - shift) @ rotation
        return own


def cameras(
    camera_to_worlds: ArrayLike,
    fx: ArrayLike,
    fy: ArrayLike,
    cx: ArrayLike,
    cy: ArrayLike,
    width: int,
    height: int,
    world: World | None = None,
) -> list[Camera]:
    """Returns cameras from the fields of nerfstudio's ``Cameras`` (pass ``.numpy()`` arrays).

    With ``world``, the cameras are in the world of the photographs, otherwise in that of the poses.
    """
    poses = np.asarray(camera_to_worlds, dtype=np.float64)
    poses = poses[None] if poses.ndim == 2 else poses
    poses = world.back(poses) if world else poses
    flat = [np.ravel(np.asarray(own, dtype=np.float64)) for own in (fx, fy, cx, cy)]
    return Camera.batch(poses, int(width), int(height), fx=flat[0], fy=flat[1], cx=flat[2], cy=flat[3])


def camera_path(path: str | os.PathLike[str], world: World | None = None) -> list[Camera]:
    """Returns the cameras of a path that nerfstudio's viewer saved (``camera_path.json``).

    With ``world``, the cameras are in the world of the photographs, otherwise in that of the path.
    """
    data = _read(path)
    kind = data.get("camera_type", "perspective")
    if kind != "perspective":
        raise InputError(f"{os.fspath(path)}: has {kind} cameras; save the path with perspective cameras")
    try:
        width, height = int(data["render_width"]), int(data["render_height"])
        frames = data["camera_path"]
        poses = np.array([frame["camera_to_world"] for frame in frames], dtype=np.float64).reshape(-1, 4, 4)
        # nerfstudio's field of view is vertical.
        angles = np.radians(np.array([frame["fov"] for frame in frames], dtype=np.float64))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{os.fspath(path)}: not a camera path of nerfstudio: {error!r}") from error
    focal = 0.5 * height / np.tan(0.5 * angles)
    poses = world.back(poses) if world else poses
    return Camera.batch(poses, width, height, fx=focal)
