"""Anti-aliased radiance fields from photographs (Tri-MipRF), on the CPU or any GPU.

>>> import trimip
>>> run = trimip.train({"data.root": "data/lego", "train.seconds": 60}, callback=trimip.Progress())
>>> model = run.model()
>>> frame = model.render(trimip.Scene("data/lego").cameras("test")[0])
>>> frame.color.shape
(800, 800, 3)

Poses are camera-to-world matrices with OpenGL axes: x right, y up, and the camera looks along -z. Lengths are in units of the
photographs' world, angles in degrees. Settings are those of ``trimip-cli config --defaults``, as ``{"section.key": value}``.
"""

from . import nerfstudio
from ._trimip import (
    Camera,
    DeviceError,
    Error,
    Frame,
    InputError,
    Mesh,
    Model,
    Run,
    RunError,
    Scene,
    __version__,
    backends,
    capture,
    defaults,
    systems,
    train,
)
from .progress import Progress

__all__ = [
    "Camera",
    "DeviceError",
    "Error",
    "Frame",
    "InputError",
    "Mesh",
    "Model",
    "Progress",
    "Run",
    "RunError",
    "Scene",
    "__version__",
    "backends",
    "capture",
    "defaults",
    "nerfstudio",
    "systems",
    "train",
]
