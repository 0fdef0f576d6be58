"""`petalfit flower`: files, the summary, and refusals before anything is fitted."""

from pathlib import Path

import numpy as np

import petalfit as pf
from tests.cli.conftest import contents
from tests.cli.test_fit import Call
from tests.fitting.test_flower import corolla


def test_a_flower_from_nothing(petalfit: Call, tmp_path: Path) -> None:
    np.savetxt(tmp_path / "flower.xyz", corolla(3)[0])
    outcome = petalfit("flower", tmp_path / "flower.xyz", "--out", tmp_path / "out")
    assert outcome.status == 0
    assert "3 petals, whorls of 3" in outcome.out
    found = contents(tmp_path / "out")
    assert found.keys() == {"flower.json", "flower.glb", "petals.csv", "report.html"}
    result = pf.FlowerResult.load(tmp_path / "out" / "flower.json")
    assert result.command.startswith("petalfit flower")
    assert (tmp_path / "out" / "petals.csv").read_text("utf-8") == result.table()


def test_what_is_no_flower_leaves_nothing_behind(petalfit: Call, tmp_path: Path) -> None:
    np.savetxt(tmp_path / "few.xyz", np.random.default_rng(0).normal(size=(50, 3)))
    outcome = petalfit("flower", tmp_path / "few.xyz", "--out", tmp_path / "out")
    assert outcome.status == 2
    assert "too few to tell the petals of a flower apart" in outcome.err
    assert not (tmp_path / "out").exists()
    outcome = petalfit("flower", tmp_path / "few.xyz", "--model", "auto", "--out", tmp_path / "out")
    assert outcome.status == 2
    assert "name a component" in outcome.err
    np.savetxt(tmp_path / "flower.xyz", corolla(3)[0])
    options = ("--shared", "bend,length", "--out", tmp_path / "out")
    outcome = petalfit("flower", tmp_path / "flower.xyz", *options)
    assert outcome.status == 2
    assert "length is held by the unit of each petal's pose" in outcome.err
