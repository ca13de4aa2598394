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
    """Any error of trimip. Its text is one line: the place of the fault, the fault, and advice."""

    place: str | None
    """Place of the fault: a file, a frame, a setting, an argument. None for failures of a run or a device."""
    path: Path | None
    """File in which the fault is; None if it is in no file."""
    line: int | None
    """Line of that file, counted from 1; None if it is unknown."""
    found: str
    """The fault that was found."""
    advice: str | None
    """Advice on how to fix it."""

class InputError(Error):
    """A file, a setting or an argument is wrong."""

class RunError(Error):
    """A run failed although its input was valid, or the model missed its quality floor."""

class DeviceError(Error):
    """The device is missing, too small or lost."""

class Camera:
    """A camera: a pose in the world, a picture size, and a projection."""

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
        """Creates a camera from a camera-to-world matrix [R|t], 3×4 or 4×4, with OpenGL axes.

        Give either `fov` (horizontal, degrees) or `fx` (pixels). `fy` defaults to the focal length along x, `cx` and `cy` to the middle of
        the picture. `lens` has the keys of transforms.json (k1, k2, p1, p2, …).
        """
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
        """Creates a camera at `eye` that looks at `target`.

        `up` is z by default. Give either `fov` (horizontal, degrees) or `fx` (pixels).
        """
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
        """Creates one camera per matrix of `poses`, [N, 3|4, 4]. A value of the projection is one number, or N numbers."""
    def resized(self, factor: float) -> Camera:
        """Returns the same view with `factor` times as many pixels along each side."""
    @property
    def pose(self) -> NDArray[np.float64]:
        """Camera-to-world matrix [R|t], float64 [3, 4], OpenGL axes."""
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
    """A data set: photographs with their cameras."""

    def __new__(cls, root: str | PathLike[str] | None = None, settings: Settings | None = None) -> Scene:
        """Opens the folder of a scene. Without `root`, opens the data that `settings` select; the default is the built-in scene."""
    @property
    def name(self) -> str:
        """Name of the scene's folder, or "builtin"."""
    @property
    def warnings(self) -> list[str]:
        """Warnings about the data, one line each."""
    def count(self, split: Split = "test") -> int:
        """Returns the number of photographs of a split."""
    def cameras(self, split: Split = "test") -> list[Camera]:
        """Returns the cameras of a split at full size."""
    def photograph(self, index: int, split: Split = "test", scale: int = 1) -> NDArray[np.float32]:
        """Returns a photograph, composited over the background of the settings: float32 [height, width, 3] in [0, 1]."""
    def pixels(self, index: int, split: Split = "test", scale: int = 1) -> NDArray[np.uint8]:
        """Returns the stored RGBA pixels of a photograph: uint8 [height, width, 4]."""

class Frame:
    """Rendered views as arrays: [height, width, …] for one view, [views, height, width, …] for several."""

    def save(self, path: str | PathLike[str]) -> None:
        """Writes the colours of a single view as an 8-bit PNG."""
    def _repr_png_(self) -> bytes | None:
        """Returns the PNG that a notebook shows; None for several views."""
    @property
    def color(self) -> NDArray[np.float32]:
        """RGB over the background of the model: float32 […, 3]."""
    @property
    def opacity(self) -> NDArray[np.float32]:
        """Opacity in [0, 1]: float32 […]."""
    @property
    def depth(self) -> NDArray[np.float32]:
        """Distance along the optical axis, world units: float32 […]; infinite where the ray hits nothing."""

class Mesh:
    """A triangle mesh of the surface."""

    @property
    def positions(self) -> NDArray[np.float32]:
        """Positions of the vertices relative to `origin`, world units: float32 [N, 3]."""
    @property
    def origin(self) -> list[float]:
        """Origin of `positions` in the coordinates of the photographs, three numbers."""
    @property
    def normals(self) -> NDArray[np.float32]:
        """Unit normals of the vertices, outward: float32 [N, 3]."""
    @property
    def colors(self) -> NDArray[np.float32]:
        """Colours of the vertices: float32 [N, 3] in [0, 1]; [0, 3] without colours."""
    @property
    def triangles(self) -> NDArray[np.uint32]:
        """Vertex indices of the triangles, counterclockwise as seen from outside: uint32 [M, 3]."""
    @property
    def volume(self) -> float:
        """The enclosed volume, world units cubed."""
    @property
    def is_closed(self) -> bool:
        """True if the mesh is closed, manifold and oriented."""
    def write(self, path: str | PathLike[str]) -> int:
        """Writes a PLY, OBJ, GLB or USDZ file, as the file extension specifies; returns its size in bytes."""

class Model:
    """A trained model on a backend. Several threads may share a model; their calls take turns."""

    @staticmethod
    def load(path: str | PathLike[str], settings: Settings | None = None) -> Model:
        """Loads the model of a run folder or a model file. `settings` override settings of rendering and of the data."""
    def render(self, camera: Camera) -> Frame:
        """Renders one view. Its arrays have the shape [height, width, …]."""
    def render_batch(self, cameras: Sequence[Camera]) -> Frame:
        """Renders the views of cameras that have equal picture sizes. The arrays have the shape [views, height, width, …]."""
    def query(
        self, points: ArrayLike, directions: ArrayLike | None = None, radius: float | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Returns density, float32 […] per world unit, and colour, float32 […, 3], at `points`, […, 3].

        `directions` are the viewing directions from the eye, […, 3] or a single one (default: −z). `radius` is the radius of the queried
        spheres, world units (default: half a marching step).
        """
    def features(self, points: ArrayLike, radius: float | None = None) -> NDArray[np.float32]:
        """Returns the encoder's features at `points`, […, 3]: float32 […, features]."""
    def mesh(
        self,
        resolution: int = 512,
        *,
        level: float | None = None,
        triangles: int = 100_000,
        specks: float = 0.02,
        colors: bool = True,
    ) -> Mesh:
        """Extracts the surface where the density crosses `level`, simplified to about `triangles` triangles (0: all are kept).

        `level` is per world unit; the default is the density at which a marching step has an optical depth of 0.2. `resolution` is the
        number of grid cells along the longest side of the box. Connected parts with a diagonal below `specks` of that side are left out.
        """
    def evaluate(self, stride: int = 1) -> dict[str, Any]:
        """Measures every `stride`-th test view; returns a dictionary with `stride`, `scales`, `mean`, `views` and `seconds`."""
    def save(self, path: str | PathLike[str]) -> int:
        """Writes the model file, whose name ends in .safetensors, and returns its size in bytes."""
    @property
    def config(self) -> dict[str, Any]:
        """All settings, as nested dictionaries."""
    @property
    def local_origin(self) -> list[float]:
        """Origin of the model's local coordinates (`aabb`, mesh positions) in the coordinates of the photographs."""
    @property
    def aabb(self) -> tuple[list[float], list[float]]:
        """Lower and upper corner of the scene's box, world units, relative to `local_origin`."""
    @property
    def device(self) -> str:
        """Names of the backend and the device."""

class Run:
    """A training run: its folder, how it ended, and its measures."""

    @staticmethod
    def load(folder: str | PathLike[str]) -> Run:
        """Opens the run of a folder that this package or trimip-cli trained."""
    @property
    def folder(self) -> Path:
        """The run folder."""
    @property
    def ended(self) -> Literal["finished", "stopped", "before"]:
        """How the run ended: "finished", "stopped", or "before" if the folder already held the finished run and nothing was done."""
    @property
    def config(self) -> dict[str, Any]:
        """All settings, including those that the scene plan decided, as nested dictionaries."""
    @property
    def evaluations(self) -> list[dict[str, Any]]:
        """The evaluations in order: dictionaries with `step`, `seconds`, `samples`, `psnr` (dB), `ssim`, `scales` and `last`."""
    @property
    def verdict(self) -> str:
        """The verdict on the model in one line."""
    def to_latex(self) -> str:
        """Returns the measures per scale as a LaTeX tabular, as in report.tex."""
    def to_markdown(self) -> str:
        """Returns the measures per scale as a Markdown table, as in report.md."""
    def report(self) -> Path:
        """Rewrites the report, as after training, and returns the path of report.html."""
    def model(self) -> Model:
        """Loads the trained model."""

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
    """Finds the cameras of a film or of photographs with ffmpeg and COLMAP. Returns the capture's folder, a scene for `train`."""
def train(
    config: Settings | str | PathLike[str] | None = None,
    out: str | PathLike[str] | None = None,
    *,
    settings: Settings | None = None,
    system: str | None = None,
    callback: Callable[[dict[str, Any]], bool | None] | None = None,
    fresh: bool = False,
) -> Run:
    """Trains in a run folder, or resumes its run. `callback` receives every event as a dictionary; to stop the run, it returns False."""
def defaults() -> dict[str, Any]:
    """Returns all settings with their defaults, as nested dictionaries."""
def systems() -> list[str]:
    """Returns the names of the systems that `train` accepts."""
def backends() -> list[str]:
    """Returns the names of the backends that this machine can run."""
