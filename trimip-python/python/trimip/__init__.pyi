from collections.abc import Callable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import nerfstudio as nerfstudio
from .progress import Progress as Progress

__version__: str

Settings = dict[str, Any]
Split = Literal["train", "test"]

class Error(Exception):
    """Any error of trimip: one line with what, where and what to do."""

class InputError(Error):
    """A file, a setting or an argument is wrong."""

class RunError(Error):
    """A run failed with valid input, or missed its quality floor."""

class DeviceError(Error):
    """The device is missing, too small or lost."""

class Camera:
    """A camera: a pose in the world, the size of a picture, and a projection."""

    def __new__(
        cls,
        pose: ArrayLike,
        width: int,
        height: int,
        *,
        fov: float | None = None,
        fx: float | None = None,
        fy: float | None = None,
        cx: float | None = None,
        cy: float | None = None,
        lens: dict[str, Any] | None = None,
    ) -> Camera:
        """From a camera-to-world matrix [R|t], 3×4 or 4×4, OpenGL axes; either `fov` (horizontal, degrees) or `fx` (pixels)."""
    @staticmethod
    def look_at(
        eye: ArrayLike,
        target: ArrayLike,
        width: int,
        height: int,
        *,
        up: ArrayLike | None = None,
        fov: float | None = None,
        fx: float | None = None,
    ) -> Camera:
        """A camera at `eye` that looks at `target`."""
    @staticmethod
    def batch(
        poses: ArrayLike,
        width: int,
        height: int,
        *,
        fov: ArrayLike | None = None,
        fx: ArrayLike | None = None,
        fy: ArrayLike | None = None,
        cx: ArrayLike | None = None,
        cy: ArrayLike | None = None,
    ) -> list[Camera]:
        """One camera for each matrix of `poses`, [N, 3|4, 4]."""
    def resized(self, factor: float) -> Camera:
        """The same view with `factor` times as many pixels along each side."""
    @property
    def pose(self) -> NDArray[np.float64]:
        """Camera-to-world matrix [R|t], [3, 4], OpenGL axes."""
    @property
    def width(self) -> int:
        """Width of the picture, pixels."""
    @property
    def height(self) -> int:
        """Height of the picture, pixels."""
    @property
    def fx(self) -> float:
        """Focal length along x, pixels."""
    @property
    def fy(self) -> float:
        """Focal length along y, pixels."""
    @property
    def cx(self) -> float:
        """Principal point along x, pixels."""
    @property
    def cy(self) -> float:
        """Principal point along y, pixels."""

class Scene:
    """A data set: its cameras and its photographs."""

    def __new__(cls, root: str | PathLike[str] | None = None, settings: Settings | None = None) -> Scene:
        """Opens the folder of a scene; `settings` are those of the section `data`."""
    @property
    def name(self) -> str:
        """The name of its folder."""
    @property
    def warnings(self) -> list[str]:
        """What may be wrong with the data, a line each."""
    def count(self, split: Split = "test") -> int:
        """Number of photographs of a split."""
    def cameras(self, split: Split = "test") -> list[Camera]:
        """Cameras of a split at full size."""
    def photograph(self, index: int, split: Split = "test", scale: int = 1) -> NDArray[np.float32]:
        """A photograph on the background of the settings: [height, width, 3] in [0, 1]."""
    def pixels(self, index: int, split: Split = "test", scale: int = 1) -> NDArray[np.uint8]:
        """A photograph as it is stored: RGBA, [height, width, 4]."""

class Frame:
    """Views as arrays: one view has [height, width, …], several have [views, height, width, …]."""

    def save(self, path: str | PathLike[str]) -> None:
        """Writes the colours of one view as a PNG of 8 bits."""
    def _repr_png_(self) -> bytes | None:
        """What a notebook shows; nothing of several views."""
    @property
    def color(self) -> NDArray[np.float32]:
        """RGB on the background of the model, […, 3]."""
    @property
    def opacity(self) -> NDArray[np.float32]:
        """Opacity in [0, 1]."""
    @property
    def depth(self) -> NDArray[np.float32]:
        """Distance along the optical axis, world units; infinite where nothing is seen."""

class Mesh:
    """A triangle mesh of the surface."""

    @property
    def positions(self) -> NDArray[np.float32]:
        """Places of the vertices, [N, 3], counted from `origin`."""
    @property
    def origin(self) -> list[float]:
        """Where positions begin in the coordinates of the photographs."""
    @property
    def normals(self) -> NDArray[np.float32]:
        """Normals of the vertices, [N, 3]."""
    @property
    def colors(self) -> NDArray[np.float32]:
        """Colours of the vertices, [N, 3] in [0, 1]."""
    @property
    def triangles(self) -> NDArray[np.uint32]:
        """Vertices of the triangles, [M, 3]."""
    @property
    def volume(self) -> float:
        """The enclosed volume, world units cubed."""
    @property
    def is_closed(self) -> bool:
        """True if every edge has two triangles."""
    def write(self, path: str | PathLike[str]) -> int:
        """Writes PLY, OBJ or GLB, by the ending of the name; returns the number of bytes."""

class Model:
    """A trained model on a backend. Several threads may use one; they take turns."""

    @staticmethod
    def load(path: str | PathLike[str], settings: Settings | None = None) -> Model:
        """Loads the model of a run folder or a model file."""
    def render(self, camera: Camera) -> Frame:
        """Renders the view of a camera."""
    def render_batch(self, cameras: Sequence[Camera]) -> Frame:
        """Renders the views of several cameras of one size."""
    def query(
        self, points: ArrayLike, directions: ArrayLike | None = None, radius: float | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Density per world unit, […], and colour, […, 3], at `points`, […, 3], seen along `directions` by spheres of `radius`."""
    def features(self, points: ArrayLike, radius: float | None = None) -> NDArray[np.float32]:
        """The encoder's features at `points`, […, 3]: […, features]."""
    def mesh(
        self,
        resolution: int = 512,
        *,
        level: float | None = None,
        triangles: int = 100_000,
        specks: float = 0.02,
        colors: bool = True,
    ) -> Mesh:
        """The surface where the density crosses `level`, simplified to about `triangles` (0: not at all)."""
    def evaluate(self, stride: int = 1) -> dict[str, Any]:
        """Measures every `stride`-th test view: `scales`, `views`, `mean`, `seconds`."""
    def save(self, path: str | PathLike[str]) -> int:
        """Writes the model file; returns its size in bytes."""
    @property
    def config(self) -> dict[str, Any]:
        """All settings, as nested dictionaries."""
    @property
    def local_origin(self) -> list[float]:
        """Where the coordinates of `aabb` and of meshes begin in those of the photographs."""
    @property
    def aabb(self) -> tuple[list[float], list[float]]:
        """The box of the scene: its two corners, counted from `local_origin`."""
    @property
    def device(self) -> str:
        """Backend and device."""

class Run:
    """A run: its folder, how it ended, and its measures."""

    @staticmethod
    def load(folder: str | PathLike[str]) -> Run:
        """Opens the run of a folder, which this package or the program trained."""
    @property
    def folder(self) -> Path:
        """The run folder."""
    @property
    def ended(self) -> Literal["finished", "stopped", "before"]:
        """"before" if the folder already held the run and nothing was done."""
    @property
    def config(self) -> dict[str, Any]:
        """All settings, as nested dictionaries."""
    @property
    def evaluations(self) -> list[dict[str, Any]]:
        """The evaluations in order: `seconds`, `samples`, `psnr`, `ssim`, `scales`."""
    @property
    def verdict(self) -> str:
        """The verdict on the model in one line."""
    def to_latex(self) -> str:
        """The measures per scale as a LaTeX tabular, as in report.tex."""
    def to_markdown(self) -> str:
        """The same as Markdown, as in report.md."""
    def report(self) -> Path:
        """Writes the report again, as after training; the path of report.html."""
    def model(self) -> Model:
        """The trained model."""

def capture(
    input: str | PathLike[str],
    out: str | PathLike[str] | None = None,
    *,
    frames: int | None = None,
    poses: Literal["colmap", "pycolmap", "glomap"] | None = None,
    camera: Literal["opencv", "opencv-fisheye", "full-opencv", "radial", "simple-radial", "pinhole"] | None = None,
    matcher: Literal["exhaustive", "sequential", "vocabulary"] | None = None,
    vocab_tree: str | PathLike[str] | None = None,
    mapper: Literal["incremental", "global"] | None = None,
    size: int | None = None,
    threads: int = 0,
    fresh: bool = False,
    callback: Callable[[dict[str, Any]], bool | None] | None = None,
) -> Path:
    """Finds the cameras of a film or of photographs by ffmpeg and COLMAP; the folder of the capture, which `train` takes as data."""
def train(
    config: Settings | str | PathLike[str] | None = None,
    out: str | PathLike[str] | None = None,
    *,
    settings: Settings | None = None,
    system: str | None = None,
    callback: Callable[[dict[str, Any]], bool | None] | None = None,
    fresh: bool = False,
) -> Run:
    """Trains into a run folder, or resumes the run that is there; `callback` gets every event and returns False to stop."""
def defaults() -> dict[str, Any]:
    """All settings and their defaults, as nested dictionaries."""
def systems() -> list[str]:
    """Names of the systems that `train` can begin with."""
def backends() -> list[str]:
    """Names of the backends that work on this machine."""
