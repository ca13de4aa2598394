"""Cameras of nerfstudio: its own world, its camera paths, its dictionaries of intrinsics.

nerfstudio moves and scales a scene before it trains (``dataparser_transforms.json`` of a run tells how). `World` goes back to
the world of the photographs, so that both programs render the same views.
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
    """[R|t] as a 4×4 matrix."""
    return np.vstack([np.asarray(matrix, dtype=np.float64).reshape(-1, 4)[:3], [0.0, 0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class World:
    """The map from the photographs' world to nerfstudio's: x ↦ scale · (R·x + t)."""

    transform: NDArray[np.float64]
    """[R|t], [3, 4]."""
    scale: float

    @staticmethod
    def load(path: str | os.PathLike[str], transforms: str | os.PathLike[str] | None = None) -> World:
        """Reads ``dataparser_transforms.json``, or the one in the folder of a run.

        Its map begins in the world of the COLMAP model. Where the photographs' cameras come from a ``transforms.json`` that
        ``ns-process-data`` wrote, name that file: it says how its own world lies in COLMAP's (``applied_transform``,
        ``applied_scale``).
        """
        path = os.path.join(path, "dataparser_transforms.json") if os.path.isdir(path) else path
        data, applied = _read(path), (_read(transforms) if transforms is not None else {})
        try:
            transform = _square(data["transform"]) @ np.linalg.inv(_square(applied.get("applied_transform", np.eye(4)[:3])))
            return World(transform[:3], float(data["scale"]) / float(applied.get("applied_scale", 1.0)))
        except (KeyError, TypeError, ValueError, np.linalg.LinAlgError) as error:
            raise InputError(f"{os.fspath(path)}: no transform [3, 4] and scale; {error}") from error

    def back(self, poses: ArrayLike) -> NDArray[np.float64]:
        """Poses of nerfstudio's world, [..., 3 or 4, 4], in the world of the photographs, [..., 3, 4]."""
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
    """Cameras from the fields of nerfstudio's ``Cameras`` (pass ``.numpy()`` arrays), in the world of the photographs."""
    poses = np.asarray(camera_to_worlds, dtype=np.float64)
    poses = poses[None] if poses.ndim == 2 else poses
    poses = world.back(poses) if world else poses
    flat = [np.ravel(np.asarray(own, dtype=np.float64)) for own in (fx, fy, cx, cy)]
    return Camera.batch(poses, int(width), int(height), fx=flat[0], fy=flat[1], cx=flat[2], cy=flat[3])


def camera_path(path: str | os.PathLike[str], world: World | None = None) -> list[Camera]:
    """The cameras of a path that nerfstudio's viewer saved (``camera_path.json``), in the world of the photographs."""
    data = _read(path)
    kind = data.get("camera_type", "perspective")
    if kind != "perspective":
        raise InputError(f"{os.fspath(path)}: a path of {kind} cameras; save it with perspective ones")
    try:
        width, height = int(data["render_width"]), int(data["render_height"])
        frames = data["camera_path"]
        poses = np.array([frame["camera_to_world"] for frame in frames], dtype=np.float64).reshape(-1, 4, 4)
        # Their field of view is vertical.
        angles = np.radians(np.array([frame["fov"] for frame in frames], dtype=np.float64))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{os.fspath(path)}: not a camera path of nerfstudio: {error!r}") from error
    focal = 0.5 * height / np.tan(0.5 * angles)
    poses = world.back(poses) if world else poses
    return Camera.batch(poses, width, height, fx=focal)
