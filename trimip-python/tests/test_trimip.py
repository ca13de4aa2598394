"""Checks that the package gives the same bits and the same messages as the program."""

import io
import json
import os
import pickle
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import trimip
from conftest import TINY


def flat(settings, prefix=""):
    for key, value in settings.items():
        if isinstance(value, dict):
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def sets():
    return [word for key, value in flat(TINY) for word in ("--set", f"{key}={value}")]


def camera(size=24):
    return trimip.Camera.look_at([3, 1, 2], [0, 0, 0], size, size, fov=40)


def test_training_has_the_bits_of_the_program(trained, cli, tmp_path):
    run, events = trained
    assert run.ended == "finished"
    kinds = [event["kind"] for event in events]
    assert kinds[0] == "plan" and "finished" in kinds and "evaluation" in kinds
    assert run.evaluations[-1]["psnr"] == pytest.approx(
        next(event for event in events if event["kind"] == "evaluation" and event["last"])["psnr"]
    )
    answer = cli("train", *sets(), "--out", tmp_path / "run")
    assert answer.returncode == 0, answer.stderr
    ours = (run.folder / "model.safetensors").read_bytes()
    assert ours == (tmp_path / "run/model.safetensors").read_bytes()
    assert trimip.train(TINY, run.folder).ended == "before"


def test_a_view_has_the_bits_of_the_program(trained, model, cli, tmp_path):
    frame = model.render(camera())
    assert frame.color.shape == (24, 24, 3) and frame.opacity.shape == frame.depth.shape == (24, 24)
    assert frame.color.dtype == np.float32
    pose = json.dumps(camera().pose.tolist())
    out = tmp_path / "view"
    answer = cli(
        "render", trained[0].folder, "--pose", pose, "--width", 24, "--height", 24, "--fov", 40, "--out", out
    )
    assert answer.returncode == 0, answer.stderr
    png = (out / "pose_color.png").read_bytes()
    assert decoded(png) == np.clip(np.rint(frame.color * 255), 0, 255).astype(np.uint8).tobytes()


def test_a_view_is_saved_and_shown_in_notebooks(model, tmp_path):
    frame = model.render(camera())
    frame.save(tmp_path / "view.png")
    png = (tmp_path / "view.png").read_bytes()
    assert png == frame._repr_png_()
    assert decoded(png) == np.clip(np.rint(frame.color * 255), 0, 255).astype(np.uint8).tobytes()
    several = model.render_batch([camera(), camera()])
    assert several._repr_png_() is None
    for own, path in ((several, "several.png"), (frame, "view.jpg"), (frame, "view")):
        with pytest.raises(trimip.InputError):
            own.save(tmp_path / path)
        assert not (tmp_path / path).exists()


def test_a_camera_comes_back_from_a_pickle(model):
    lens = {"k1": 0.1, "k2": -0.03, "p1": 0.001, "p2": 0.002}
    own = trimip.Camera(camera().pose + np.eye(3, 4, 3) / 3, 24, 20, fx=30.1, fy=29.3, cx=11.7, cy=9.9, lens=lens)
    again = pickle.loads(pickle.dumps(own))
    assert np.array_equal(again.pose, own.pose) and (again.fx, again.fy, again.cx, again.cy) == (30.1, 29.3, 11.7, 9.9)
    assert np.array_equal(model.render(again).color, model.render(own).color), "the lens too"


def test_a_run_has_the_files_of_the_program_and_is_opened_again(trained, cli, tmp_path):
    run, _ = trained
    again = trimip.Run.load(run.folder)
    assert again.ended == "before" and again.folder == run.folder
    assert again.evaluations == run.evaluations and again.config == run.config
    assert again.to_latex() == run.to_latex() == (run.folder / "report.tex").read_text()
    assert again.to_markdown() == (run.folder / "report.md").read_text()
    assert "tabular" in again.to_latex() and f"{run.evaluations[-1]['psnr']:.2f} dB" in again.verdict
    assert np.array_equal(again.model().render(camera()).color, run.model().render(camera()).color)
    for name in ("report.html", "report.json", "metrics.csv", "error_vs_time.csv"):
        assert (run.folder / name).stat().st_size > 0, name
    page = (run.folder / "report.html").read_text()
    (run.folder / "report.html").unlink()
    assert again.report() == run.folder / "report.html" and (run.folder / "report.html").read_text() == page
    with pytest.raises(trimip.InputError, match="holds no run"):
        trimip.Run.load(tmp_path)


def test_a_capture_calls_colmap_and_tells_why_it_failed(model, tmp_path, monkeypatch):
    walk, programs = tmp_path / "walk", tmp_path / "bin"
    walk.mkdir(), programs.mkdir()
    for name in "abc":
        model.render(camera()).save(walk / f"{name}.png")
    monkeypatch.setenv("PATH", str(programs))
    with pytest.raises(trimip.InputError, match="colmap"):
        trimip.capture(walk, tmp_path / "out")
    with pytest.raises(trimip.InputError, match="fish.*opencv-fisheye"):
        trimip.capture(walk, tmp_path / "out", camera="fish")
    colmap = programs / "colmap"
    colmap.write_text("#!/bin/sh\ncase \"$*\" in help|*--help) echo 'COLMAP 3.8';; *) echo 'no features today' >&2; exit 3;; esac\n")
    colmap.chmod(0o755)
    events = []
    with pytest.raises(trimip.RunError, match="exit code 3: no features today"):
        trimip.capture(walk, tmp_path / "out", callback=events.append)
    assert [event["stage"] for event in events if event["kind"] == "done"] == ["pictures"]
    assert len(list((tmp_path / "out/images").iterdir())) == 3


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_ctrl_c_stops_a_capture_and_its_programs(keyboard, model, tmp_path, monkeypatch):
    walk, programs = tmp_path / "walk", tmp_path / "bin"
    walk.mkdir(), programs.mkdir()
    for name in "abc":
        model.render(camera()).save(walk / f"{name}.png")
    colmap, asleep = programs / "colmap", tmp_path / "asleep"
    hang = f"echo $$ > {asleep}.part; mv {asleep}.part {asleep}; sleep 600"
    colmap.write_text(f"#!/bin/sh\nPATH=/usr/bin:/bin\ncase \"$*\" in help|*--help) echo 'COLMAP 3.8';; *) {hang};; esac\n")
    colmap.chmod(0o755)
    monkeypatch.setenv("PATH", str(programs))

    def interrupt():
        while not asleep.exists():
            time.sleep(0.05)
        signal.raise_signal(signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        trimip.capture(walk, tmp_path / "out")
    thread.join()
    for _ in range(100):
        try:
            os.kill(int(asleep.read_text()), 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    pytest.fail("the program goes on")


def test_the_readme_shows_a_function_that_runs(cli, tmp_path):
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    shown = readme.split("```python\n")[1].split("```")[0]
    small = ["--set", "data.builtin_size=32", "--set", "data.builtin_train=16", "--set", "data.builtin_test=2"]
    scene = tmp_path / "scene"
    answer = cli("data", "builtin", scene, *small)
    assert answer.returncode == 0, answer.stderr
    names = {}
    exec(shown, names)
    density, color = names["first"](str(scene), 3.0, str(tmp_path / "run"))
    assert density.shape == (1,) and color.shape == (1, 3)
    assert (tmp_path / "run/view.png").read_bytes().startswith(b"\x89PNG")


def test_progress_is_one_line(tmp_path):
    text = io.StringIO()
    trimip.train(TINY, tmp_path / "run", callback=trimip.Progress(file=text, interval=0))
    lines = text.getvalue().split("\n")
    assert len(lines) > 1 and lines[-1] == "" and "at the end: " in lines[-2]
    assert "\r" in text.getvalue() and f" %  step {TINY['train.steps']} " in text.getvalue()


def decoded(png):
    """Returns the pixels of an 8-bit RGB PNG."""
    import struct
    import zlib

    width, height = struct.unpack(">II", png[16:24])
    data, at = b"", 8
    while at < len(png):
        length, kind = struct.unpack(">I4s", png[at : at + 8])
        if kind == b"IDAT":
            data += png[at + 8 : at + 8 + length]
        at += 12 + length
    raw, rows = np.frombuffer(zlib.decompress(data), np.uint8).reshape(height, -1), []
    before = np.zeros(3 * width, np.int64)
    for row in raw:
        kind, line = row[0], row[1:].astype(np.int64)
        out = np.zeros_like(line)
        for i, value in enumerate(line):
            left, up = (out[i - 3] if i >= 3 else 0), before[i]
            corner = before[i - 3] if i >= 3 else 0
            guess = left + up - corner
            near = sorted([(abs(guess - left), 0, left), (abs(guess - up), 1, up), (abs(guess - corner), 2, corner)])
            out[i] = (value + [0, left, up, (left + up) // 2, near[0][2]][kind]) % 256
        rows.append(out.astype(np.uint8).tobytes())
        before = out
    return b"".join(rows)


def test_a_batch_is_its_views(model):
    poses = np.stack([trimip.Camera.look_at(eye, [0, 0, 0], 12, 8, fov=50).pose for eye in ([3, 0, 1], [0, 3, 1])])
    batch = model.render_batch(trimip.Camera.batch(poses, 12, 8, fov=50))
    assert batch.color.shape == (2, 8, 12, 3)
    for pose, color in zip(poses, batch.color):
        assert np.array_equal(model.render(trimip.Camera(pose, 12, 8, fov=50)).color, color)
    each = trimip.Camera.batch(poses, 12, 8, fx=[10.0, 20.0], fy=11.0, cx=5.0)
    assert [own.fx for own in each] == [10.0, 20.0] and each[1].fy == 11.0 and each[0].cx == 5.0 and each[0].cy == 4.0


def test_measures_are_those_of_the_program(trained, model, cli, tmp_path):
    found = model.evaluate()
    answer = cli("eval", trained[0].folder, "--json", tmp_path / "eval.json")
    assert answer.returncode == 0, answer.stderr
    expected = json.loads((tmp_path / "eval.json").read_text())
    assert found["scales"] == expected["scales"] and found["mean"] == expected["mean"]


def test_places_have_densities_colours_and_features(model):
    points = np.random.default_rng(1).uniform(-1, 1, (50, 3))
    density, color = model.query(points, directions=[0, 0, 2], radius=0.01)
    assert density.shape == (50,) and color.shape == (50, 3) and (density >= 0).all()
    assert np.array_equal(model.query(points[7], [0, 0, 1], 0.01)[0], density[7:8])
    features = model.features(points, radius=0.01)
    width = 3 * 16  # three planes, sixteen channels
    assert features.shape == (50, width) and np.isfinite(features).all()
    assert np.array_equal(model.features(points[3:4], radius=0.01)[0], features[3])
    # Any axes may precede the axis of the numbers.
    grid = model.query(points.reshape(5, 2, 5, 3), directions=[0, 0, 2], radius=0.01)
    assert np.array_equal(grid[0], density.reshape(5, 2, 5)) and np.array_equal(grid[1], color.reshape(5, 2, 5, 3))
    assert np.array_equal(model.features(points.reshape(25, 2, 3), radius=0.01), features.reshape(25, 2, width))
    # Spheres with a large radius read coarse texels.
    assert not np.allclose(model.features(points, radius=0.5), features)


def test_a_mesh_is_that_of_the_program(trained, model, cli, tmp_path):
    mesh = model.mesh(resolution=32, level=1.0, triangles=500)
    assert mesh.triangles.shape[1] == 3 and mesh.positions.shape == mesh.normals.shape == mesh.colors.shape
    assert mesh.triangles.max() < len(mesh.positions)
    assert mesh.write(tmp_path / "ours.ply") == (tmp_path / "ours.ply").stat().st_size
    answer = cli(
        "export", "mesh", trained[0].folder, "--resolution", 32, "--level", 1.0, "--triangles", 500, "--out", tmp_path / "its.ply"
    )
    assert answer.returncode == 0, answer.stderr
    assert (tmp_path / "ours.ply").read_bytes() == (tmp_path / "its.ply").read_bytes()


def test_a_saved_model_renders_the_same(model, tmp_path):
    size = model.save(tmp_path / "again.safetensors")
    assert size == (tmp_path / "again.safetensors").stat().st_size
    again = trimip.Model.load(tmp_path / "again.safetensors", {"renderer.kind": "volume", "threads": 1})
    assert np.array_equal(again.render(camera()).color, model.render(camera()).color)


def test_settings_given_to_a_model_are_saved_with_it(trained, tmp_path):
    given = {"renderer.min_transmittance": 0.25, "threads": 1}
    assert trimip.Model.load(trained[0].folder).config["renderer"]["min_transmittance"] != 0.25
    trimip.Model.load(trained[0].folder, given).save(tmp_path / "given.safetensors")
    again = trimip.Model.load(tmp_path / "given.safetensors").config
    assert again["renderer"]["min_transmittance"] == 0.25 and again["threads"] == 1


def test_a_scene_has_its_photographs_and_cameras(model):
    scene = trimip.Scene(settings={key: value for key, value in TINY.items() if key == "data"})
    assert scene.name == "builtin" and scene.count("train") == 4 and scene.count() == 2
    photograph, pixels = scene.photograph(1), scene.pixels(1)
    assert photograph.shape == (16, 16, 3) and pixels.shape == (16, 16, 4)
    alpha = pixels[..., 3:] / np.float32(255)
    white = pixels[..., :3] / np.float32(255) * alpha + (1 - alpha)
    assert np.allclose(photograph, white, atol=2e-3)
    assert scene.photograph(1, scale=2).shape == (8, 8, 3)
    own = scene.cameras("train")[2]
    again = trimip.Camera(own.pose, own.width, own.height, fx=own.fx, fy=own.fy, cx=own.cx, cy=own.cy)
    assert np.array_equal(model.render(own).color, model.render(again).color)


@pytest.mark.parametrize(
    ("act", "words"),
    [
        (lambda tmp: trimip.Model.load(tmp / "nothing"), ["nothing", "there is no run or model", "name the folder of a run"]),
        (lambda tmp: trimip.Scene(tmp / "nothing"), ["does not exist", "data.root"]),
        (lambda tmp: trimip.train({"train.sceonds": 1}, tmp), ["sceonds"]),
        (lambda tmp: trimip.train({"train.steps": "many"}, tmp), ["settings: ", "train.steps"]),
        (lambda tmp: trimip.train({"train.steps": object()}, tmp), ["train.steps", "object"]),
        (lambda tmp: trimip.train(tmp / "no.toml", tmp), ["no.toml"]),
        (lambda tmp: trimip.train(3, tmp), ["neither a dictionary nor a path"]),
        (lambda tmp: trimip.Camera(2 * np.eye(4), 8, 8, fov=40), ["no rotation"]),
        (lambda tmp: trimip.Camera(np.eye(3), 8, 8, fov=40), ["9 numbers"]),
        (lambda tmp: trimip.Camera(np.eye(4), 8, 8), ["fov"]),
        (lambda tmp: trimip.Camera(np.eye(4), 0, 8, fov=40), ["0 by 8 pixels", "from one to 16384 pixels"]),
        (lambda tmp: trimip.Camera.batch(np.zeros((5, 3, 4)), 8, 8, fov=[1, 2]), ["2 numbers for 5 poses"]),
    ],
)
def test_errors_have_the_words_of_the_program(act, words, tmp_path):
    with pytest.raises(trimip.InputError) as error:
        act(tmp_path)
    assert all(word in str(error.value) for word in words), error.value


def test_an_error_has_its_parts_as_attributes(tmp_path):
    scene = tmp_path / "transforms.json"
    scene.write_text('{"frames": [\n1, }')
    with pytest.raises(trimip.InputError) as raised:
        trimip.Scene(str(tmp_path)).count("train")
    error = raised.value
    assert (error.path, error.line) == (scene, 2) and error.place == f"{scene}:2:4"
    assert str(error) == f"{error.place}: {error.found}; {error.advice}"


def test_the_words_of_an_error_are_the_programs(cli, tmp_path):
    with pytest.raises(trimip.InputError) as error:
        trimip.train({"train.steps": 0}, tmp_path / "run")
    answer = cli("train", "--set", "train.steps=0", "--out", tmp_path / "run")
    # The program names the command line as the place, the package names the settings.
    said = answer.stderr.strip().splitlines()[-1].removeprefix("error: ")
    assert answer.returncode == 2 and str(error.value).split(";")[1] == said.split(";")[1], (said, error.value)


@pytest.mark.parametrize("bad", [np.zeros((3, 2)), [1, 2, float("nan")], np.zeros((2, 3, 2)), 1.0])
def test_places_that_are_none_are_refused(model, bad):
    with pytest.raises(trimip.InputError, match="points"):
        model.query(bad)


def test_a_callback_stops_and_the_same_call_goes_on(trained, tmp_path):
    slow = {**TINY, "train.steps": 400, "eval.points": 8}
    whole = trimip.train(slow, tmp_path / "whole")
    seen = []

    def stop(event):
        seen.append(event["kind"])
        return event["kind"] != "evaluation"

    assert trimip.train(slow, tmp_path / "parts", callback=stop).ended == "stopped"
    assert "stopped" in seen
    assert trimip.train(slow, tmp_path / "parts").ended == "finished"
    name = "model.safetensors"
    assert (tmp_path / "parts" / name).read_bytes() == (whole.folder / name).read_bytes()


def test_an_exception_of_a_callback_is_raised_and_nothing_is_lost(tmp_path):
    def fail(event):
        if event["kind"] == "evaluation":
            raise ZeroDivisionError("mine")

    slow = {**TINY, "train.steps": 400, "eval.points": 8}
    with pytest.raises(ZeroDivisionError, match="mine"):
        trimip.train(slow, tmp_path / "run", callback=fail)
    assert trimip.train(slow, tmp_path / "run").ended == "finished"


@pytest.fixture
def keyboard():
    """Makes Ctrl-C raise KeyboardInterrupt. Python ignores Ctrl-C if its parent does, as a shell does for `command &`."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_ctrl_c_stops_a_run(keyboard, tmp_path):
    long = {**TINY, "train.seconds": 60.0, "train.steps": 10_000_000}
    threading.Timer(1.5, lambda: signal.raise_signal(signal.SIGINT)).start()
    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        trimip.train(long, tmp_path / "run")
    assert time.monotonic() - begun < 60
    assert (tmp_path / "run/checkpoint.safetensors").is_file()


def test_other_threads_go_on_while_it_works(model):
    counted, done = [0], threading.Event()

    def count():
        while not done.is_set():
            counted[0] += 1
            time.sleep(0.001)

    thread = threading.Thread(target=count)
    thread.start()
    before = counted[0]
    model.render(camera(400))
    after = counted[0]
    done.set()
    thread.join()
    assert after > before


def test_threads_share_a_model(model):
    expected = model.render(camera()).color
    found = []
    threads = [threading.Thread(target=lambda: found.append(model.render(camera()).color)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 4 and all(np.array_equal(color, expected) for color in found)


def test_a_forked_process_is_refused_instead_of_hanging(model):
    """A fork copies none of the library's threads, and would wait for them for ever."""
    model.render(camera())
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            model.render(camera())
            told = "rendered"
        except trimip.RunError as error:
            told = str(error)
        os.write(write, told.encode())
        os._exit(0)
    os.close(write)
    answer = os.read(read, 4096).decode()
    assert os.waitpid(child, 0)[1] == 0
    assert "forked" in answer and "spawn" in answer, answer


def test_more_than_the_memory_is_a_memory_error(model):
    views = [trimip.Camera.look_at([3, 1, 2], [0, 0, 0], 16384, 16384, fov=40)] * 1000
    with pytest.raises(MemoryError, match="16384"):
        model.render_batch(views)
    assert model.render(camera()).color.shape == (24, 24, 3)


@pytest.mark.parametrize("size", [-1, 0, 16385, 10**9])
def test_pictures_of_no_sane_size_are_refused(size):
    with pytest.raises(trimip.InputError, match="16384"):
        camera(size)
    with pytest.raises(trimip.InputError, match="factor"):
        camera().resized(1e6)


def test_names(cli):
    assert "tri-mip" in trimip.systems() and "cpu" in trimip.backends()
    assert trimip.defaults()["encoder"]["kind"] == "tri-mip"
    assert trimip.__version__ in cli("--version").stdout


class TestNerfstudio:
    def world(self, tmp_path):
        angle = 0.7
        rotation = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        transform = np.column_stack([rotation, [0.1, -0.2, 0.3]])
        (tmp_path / "dataparser_transforms.json").write_text(json.dumps({"transform": transform.tolist(), "scale": 0.4}))
        return transform

    def test_poses_come_back(self, tmp_path):
        transform = self.world(tmp_path)
        own = camera().pose
        theirs = transform[:, :3] @ own
        theirs[:, 3] = 0.4 * (theirs[:, 3] + transform[:, 3])
        world = trimip.nerfstudio.World.load(tmp_path)
        assert np.allclose(world.back(theirs), own, atol=1e-12)
        (found,) = trimip.nerfstudio.cameras(theirs, [[20.0]], [[21.0]], [[8.0]], [[9.0]], 16, 18, world)
        assert np.allclose(found.pose, own) and (found.fx, found.fy, found.cx, found.cy) == (20, 21, 8, 9)

    def test_the_world_of_processed_photographs(self, tmp_path):
        """ns-process-data maps COLMAP's world with the matrix A and the scale a; the dataparser maps COLMAP's world with T and s·a."""
        transform = self.world(tmp_path)
        applied = np.array([[0.0, 1, 0, 0.5], [1, 0, 0, 0], [0, 0, -1, 0]])
        (tmp_path / "transforms.json").write_text(json.dumps({"applied_transform": applied.tolist(), "applied_scale": 2.0}))
        own = camera().pose
        square = lambda matrix: np.vstack([matrix, [0, 0, 0, 1]])
        theirs = (square(transform) @ np.linalg.inv(square(applied)) @ square(own))[:3]
        theirs[:, 3] *= 0.4 / 2.0
        world = trimip.nerfstudio.World.load(tmp_path, tmp_path / "transforms.json")
        assert np.allclose(world.back(theirs), own, atol=1e-12)

    def test_a_path_of_its_viewer_is_read(self, tmp_path):
        pose = np.vstack([camera().pose, [0, 0, 0, 1]])
        path = {"render_width": 32, "render_height": 16, "camera_path": [{"camera_to_world": pose.ravel().tolist(), "fov": 90, "aspect": 2}]}
        (tmp_path / "path.json").write_text(json.dumps(path))
        (found,) = trimip.nerfstudio.camera_path(tmp_path / "path.json")
        assert np.allclose(found.pose, pose[:3]) and found.fx == pytest.approx(8) and found.width == 32

    def test_what_is_none_is_refused(self, tmp_path):
        (tmp_path / "path.json").write_text('{"camera_type": "fisheye"}')
        with pytest.raises(trimip.InputError, match="fisheye"):
            trimip.nerfstudio.camera_path(tmp_path / "path.json")
        (tmp_path / "path.json").write_text("{}")
        with pytest.raises(trimip.InputError, match="path.json"):
            trimip.nerfstudio.camera_path(tmp_path / "path.json")
        with pytest.raises(trimip.InputError, match="none.json"):
            trimip.nerfstudio.World.load(tmp_path / "none.json")
