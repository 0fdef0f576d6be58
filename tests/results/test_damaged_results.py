"""Damaged fit.json: refused with a sentence, or a result that can be saved, meshed and reported."""

import base64
import dataclasses
import functools
import json
import re
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest

import petalfit as pf
from petalfit.export import export_mesh
from petalfit.observations import Silhouette, TargetError, observation_from_json
from petalfit.results import Profile
from petalfit.results.record import FitRecord
from petalfit.studio import words
from petalfit.surfaces import Pose
from tests.fitted import known_pose, posed
from tests.mutations import damaged, each_case

MARKUP = '</script><img src="x" onerror="alert(1)">'


def few(result: pf.FitResult, count: int = 40) -> pf.FitResult:
    """The result with fewer points, so that files are small."""
    (part,) = result.agreements
    cloud = pf.PointCloud(part.target.points[:count], weights=part.target.weights[:count])
    part = dataclasses.replace(
        part, target=cloud, distances=part.distances[:count], weights=part.weights[:count]
    )
    profile = Profile((13.0, 14.0, 15.0), (9.0, 0.0, 8.0))
    return dataclasses.replace(
        result, agreements=(part,), timings={"starts": 1.0}, profiles={"a_x": profile}
    )


@functools.cache
def files(folder: Path) -> list[bytes]:
    found = []
    for result in (few(known_pose()), few(posed())):
        result.save(folder / "fit.json")
        found.append((folder / "fit.json").read_bytes())
    return found


def use(result: FitRecord, folder: Path) -> None:
    """Does with a result whatever can be done with it."""
    result.save(folder / "again.json")
    assert pf.FitResult.load(folder / "again.json").values == pytest.approx(
        result.values, nan_ok=True
    )
    if result.status is not pf.Status.NOT_FINITE:
        assert np.isfinite(result.mesh((9, 9)).vertices).all()
        export_mesh(result, folder / "petal.glb")
    result.report(folder / "report.html")
    page = (folder / "report.html").read_text() + words.verdict(result) + words.table(result)
    assert "<img" not in page
    assert "<script>alert" not in page
    assert isinstance(result.rivals, tuple)


def attempt(content: bytes, folder: Path) -> None:
    (folder / "fit.json").write_bytes(content)
    try:
        result = pf.FitResult.load(folder / "fit.json")
    except pf.TargetError as error:
        said = str(error)
    else:
        use(result, folder)
        return
    assert said.startswith(str(folder / "fit.json"))
    assert len(said) < 1000 + len(str(folder))


@pytest.mark.parametrize("seed", range(100))
def test_a_damaged_fit_is_refused_or_usable(seed, tmp_path, tmp_path_factory):
    attempt(damaged(files(tmp_path_factory.getbasetemp())[seed % 2], seed), tmp_path)


@pytest.mark.slow
def test_many_damaged_fits_are_refused_or_usable(tmp_path):
    for seed in range(100, 2100):
        attempt(damaged(files(tmp_path)[seed % 2], seed), tmp_path)


@each_case("fit*.json")
def test_fits_that_were_seen_to_break(path, tmp_path):
    # They were written in an older format, whose version would be all that is refused.
    attempt(re.sub(rb'"version": 3', b'"version": 6', path.read_bytes(), count=1), tmp_path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"status": 3}, "in status, expected text, got a whole number"),
        ({"status": "fine"}, "in status, invalid enum value 'fine'"),
        ({"status": 5000 * "a"}, f"in status, invalid enum value '{180 * 'a'}…"),
        ({"stderr": {}}, "stderr does not have the names of the free parameters"),
        ({"covariance": [[1.0]]}, "the covariance does not have a row for each name"),
        ({"values": {}}, "values do not name the parameters of PeonyPetal"),
        ({"steps": -1}, "in steps, expected a whole number >= 0"),
        ({"freedom": 10**400}, "in freedom, number out of range"),
        ({"agreements": []}, "there is no target"),
        ({"options": {"relief": True}}, "relief is no option of PeonyPetal"),
    ],
)
def test_the_sentence_says_what_is_wrong(change, said, tmp_path):
    content = json.loads(files(tmp_path)[0]) | change
    (tmp_path / "fit.json").write_text(json.dumps(content))
    with pytest.raises(pf.TargetError, match=re.escape(f"is a damaged fit result: {said}; fit")):
        pf.FitResult.load(tmp_path / "fit.json")


def test_large_arrays_are_packed_and_come_back_exactly(tmp_path, monkeypatch):
    result = few(known_pose(), 150)
    (part,) = result.agreements
    part = dataclasses.replace(part, uv=np.random.default_rng(0).uniform(size=(150, 2)))
    result = dataclasses.replace(result, agreements=(part,))
    result.save(tmp_path / "lists.json")
    monkeypatch.setattr("petalfit.schema._MANY", 140)
    result.save(tmp_path / "fit.json")
    content = json.loads((tmp_path / "fit.json").read_bytes())
    (packed,) = content["agreements"]
    assert {type(packed[name]) for name in ("distances", "weights", "uv")} == {str}
    assert type(packed["target"]["points"]) is str
    for name in ("fit.json", "lists.json"):
        (again,) = pf.FitResult.load(tmp_path / name).agreements
        np.testing.assert_array_equal(again.target.points, part.target.points)
        for array in ("distances", "weights", "uv"):
            np.testing.assert_array_equal(getattr(again, array), getattr(part, array))


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("distances", np.zeros(39)),
        ("distances", np.full(40, np.nan)),
        ("weights", np.full(40, -1.0)),
        ("weights", np.full(40, np.inf)),
        ("uv", np.zeros(41)),
    ],
)
def test_packed_nonsense_is_refused(name, array, tmp_path):
    content = json.loads(files(tmp_path)[0])
    content["agreements"][0][name] = base64.b64encode(array.tobytes()).decode()
    (tmp_path / "fit.json").write_text(json.dumps(content))
    with pytest.raises(pf.TargetError, match="is a damaged fit result"):
        pf.FitResult.load(tmp_path / "fit.json")


def test_a_value_outside_of_its_range_is_refused(tmp_path):
    content = json.loads(files(tmp_path)[0])
    content["values"]["a_x"] = 1e20
    (tmp_path / "fit.json").write_text(json.dumps(content))
    with pytest.raises(pf.TargetError, match=r"a_x is 1e\+20, outside of its range"):
        pf.FitResult.load(tmp_path / "fit.json")


def test_in_a_fitted_pose_a_length_has_any_unit(tmp_path):
    content = json.loads(files(tmp_path)[1])
    name, content["pose_stderr"] = "a_x", {"shift_x": 1.0}
    content["values"][name] = 60_000.0
    (tmp_path / "fit.json").write_text(json.dumps(content))
    result = pf.FitResult.load(tmp_path / "fit.json")
    assert result.values[name] == 60_000.0
    use(result, tmp_path)
    content["values"][name] = -1.0
    (tmp_path / "fit.json").write_text(json.dumps(content))
    with pytest.raises(pf.TargetError, match="is -1, outside of its range"):
        pf.FitResult.load(tmp_path / "fit.json")


def test_nothing_in_a_fit_is_markup(tmp_path):
    plain = few(known_pose())
    result = dataclasses.replace(
        plain,
        timings={MARKUP: 1.0},
        made_by=MARKUP,
        command=MARKUP,
        reason=MARKUP,
        notes=(MARKUP,),
        warnings=(pf.FitWarning(MARKUP, "rivals"), pf.FitWarning(MARKUP, "rivals", [MARKUP])),
        starts=tuple(dataclasses.replace(start, label=MARKUP) for start in plain.starts),
        pose=Pose(np.eye(3), np.ones(3), 1.0),
    )
    result.save(tmp_path / "fit.json")
    use(pf.FitResult.load(tmp_path / "fit.json"), tmp_path)


def test_a_mask_unpacks_to_no_more_than_its_shape():
    mask = np.zeros((60, 50))
    mask[10:50, 10:40] = 1
    content = Silhouette(mask).to_json()
    bomb = base64.b64encode(zlib.compress(bytes(100_000_000))).decode()
    tracemalloc.start()
    try:
        with pytest.raises(TargetError, match="the mask is damaged"):
            observation_from_json(content | {"mask": f"u1:{bomb}"})
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("scale", [1e180, 1e-180])
def test_a_pose_beyond_all_scans_is_refused(scale, tmp_path, tmp_path_factory):
    content = json.loads(files(tmp_path_factory.getbasetemp())[0])
    content["pose"]["scale"] = scale
    (tmp_path / "fit.json").write_text(json.dumps(content))
    with pytest.raises(pf.TargetError, match="larger or smaller than any scan"):
        pf.FitResult.load(tmp_path / "fit.json")
