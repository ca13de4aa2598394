"""A run that all tests share, and the command-line program."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest
import trimip

#: The built-in scene at 16 pixels, and a model of the smallest useful size.
TINY = {
    "data": {"format": "builtin", "builtin_size": 16, "builtin_train": 4, "builtin_test": 2, "scales": 2},
    "encoder.plane_size": 16,
    "encoder.levels": 3,
    "field.hidden": 16,
    "occupancy.resolution": 16,
    "renderer.steps_per_diagonal": 64,
    "train.samples_per_step": 512,
    "train.steps": 20,
    "eval.points": 1,
}


def program() -> str:
    """Returns the path of trimip-cli: TRIMIP_CLI, the release or debug build in this repository, or the one on the PATH."""
    target = Path(__file__).parents[2] / "target"
    for found in (os.environ.get("TRIMIP_CLI"), target / "release/trimip-cli", target / "debug/trimip-cli"):
        if found and Path(found).is_file():
            return str(found)
    found = shutil.which("trimip-cli")
    assert found, "build trimip-cli first: cargo build --release"
    return found


@pytest.fixture(scope="session")
def cli():
    def run(*arguments):
        return subprocess.run([program(), *map(str, arguments)], capture_output=True, text=True, timeout=600)

    return run


@pytest.fixture(scope="session")
def trained(tmp_path_factory):
    """Trains a run; returns it and the events that its callback received."""
    events = []
    out = tmp_path_factory.mktemp("runs") / "tiny"
    return trimip.train(TINY, out, callback=events.append), events


@pytest.fixture(scope="session")
def model(trained):
    return trained[0].model()
