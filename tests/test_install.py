"""What a start costs: nothing heavy is imported before it is used."""

import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

SCRIPT = str(Path(sysconfig.get_path("scripts"), "petalfit"))
HEAVY = {"jax", "equinox", "optimistix", "lineax", "scipy", "trimesh", "matplotlib"}


@pytest.mark.parametrize(
    "arguments",
    [["-c", "import petalfit"], ["-m", "petalfit", "--help"], [SCRIPT, "--help"]],
    ids=["import", "module", "script"],
)
def test_start_is_light(arguments: list[str]) -> None:
    command = [sys.executable, "-X", "importtime", *arguments]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    # Each line of -X importtime ends in "| package.module".
    imported = {line.rpartition("|")[2].split(".")[0].strip() for line in done.stderr.splitlines()}
    assert "petalfit" in imported
    assert not HEAVY & imported
    assert ("petalfit" in done.stdout) == ("--help" in arguments)
