"""Whole flowers: where their organs stand, what they are differentiable by, and how they are named."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import petalfit as pf
from petalfit.flowers import flower_from_json, flower_to_json, grow
from petalfit.surfaces import value_at


@pytest.fixture(scope="module")
def lily() -> pf.Flower:
    return pf.lily()


@pytest.fixture(scope="module")
def peony() -> pf.Flower:
    return pf.peony()


def test_a_lily_and_a_peony_have_the_organs_of_the_paper(lily, peony):
    assert {series.name: len(series) for series in lily.series} == {
        "petal": 6,
        "stamen": 6,
        "pistil": 1,
    }
    counts = {series.name: len(series) for series in peony.series}
    assert counts["petal"] >= 30
    assert counts["stamen"] >= 30


def test_inner_petals_of_a_peony_are_bigger_and_more_bent(peony):
    petals = peony.series[0].organ
    for name in ("a_x", "b_y", "dy"):
        values = getattr(petals, name)
        assert values[-16:].mean() > values[:16].mean() + 2 * values[:16].std()


def test_the_same_seed_is_the_same_flower():
    one, same, other = pf.peony(3), pf.peony(3), pf.peony(4)
    assert all(map(np.array_equal, jax.tree.leaves(one), jax.tree.leaves(same)))
    assert not all(map(np.array_equal, jax.tree.leaves(one), jax.tree.leaves(other)))


def test_grown_surfaces_are_finite_with_unit_normals(peony):
    for grown in grow(peony):
        assert np.isfinite(grown.vertices).all()
        np.testing.assert_allclose(np.linalg.norm(grown.normals, axis=-1), 1.0, atol=1e-9)


def test_an_attachment_is_a_rotation_that_leans_outwards():
    with jax.enable_x64(True):
        bowl = pf.Bowl(r=2.0)
        pose = pf.Attachment(azimuth=0.7, latitude=0.0, opening=0.4, roll=0.0).pose(bowl)
        np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose.rotation) == pytest.approx(1.0)
        outwards = np.array([np.cos(0.7), 0.0, np.sin(0.7)])
        along, normal = pose.rotation[:, 1], pose.rotation[:, 2]
        assert along @ outwards == pytest.approx(np.sin(0.4))
        assert along[1] == pytest.approx(np.cos(0.4))
        assert normal @ outwards == pytest.approx(-np.cos(0.4))
        np.testing.assert_allclose(pose.translation, bowl(0.0, 0.7), atol=1e-12)


def test_poses_compose():
    rng = np.random.default_rng(0)

    def pose() -> pf.Pose:
        q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
        return pf.Pose(q * np.linalg.det(q), rng.standard_normal(3), float(rng.uniform(0.5, 2)))

    one, other, points = pose(), pose(), rng.standard_normal((5, 3))
    with jax.enable_x64(True):
        np.testing.assert_allclose((one @ other)(points), one(other(points)), atol=1e-12)
        np.testing.assert_allclose(
            (one @ other).matrix(), one.matrix() @ other.matrix(), atol=1e-12
        )


def test_an_anther_stays_at_the_tip_of_its_filament():
    with jax.enable_x64(True):
        for height in (10.0, 25.0):
            stamen = pf.Stamen(pf.Filament(h=height, a_2=4.0), tilt=0.5)
            (_, filament), (pose, anther) = stamen.parts().values()
            tip = np.mean(
                np.asarray(filament(np.linspace(0, 2 * np.pi, 8, endpoint=False), 1.0)), 0
            )
            middle = np.mean(np.asarray(pose(anther(np.array([-np.pi / 2, np.pi / 2]), 0.0))), 0)
            np.testing.assert_allclose(middle, tip, atol=1e-9)


# One parameter of every kind of organ, and of what carries it.
NUMBERS = [
    "receptacle.r",
    "pedicel.h",
    "petal_2.dy",
    "petal_5.a_x",
    "petal_1.opening",
    "petal_3.azimuth",
    "petal_3.scale",
    "stamen_4.filament.h",
    "stamen_1.tilt",
    "stamen_2.anther.swell",
    "pistil.ovary.r",
    "pistil.style.slenderness",
    "pistil.stigma.h",
    "petal_6.latitude",
]


def test_gradients_of_a_whole_flower_are_those_of_finite_differences(lily):
    with jax.enable_x64(True):

        @jax.jit
        def height(flower: pf.Flower) -> jax.Array:
            """Mean height, and a little of what does not change it: widths and turns."""
            x, y, _ = flower.points().T
            return jnp.mean(y + 0.01 * x**2 + 0.02 * y**2)

        slope = jax.jit(jax.grad(height))(lily)
        for name in NUMBERS:
            organ, _, path = name.partition(".")
            number = next(
                (k for k, s in enumerate(lily.series) if organ in (s.name, *s.names)), None
            )
            if number is None:
                value, found = getattr(lily, organ), getattr(slope, organ)
                value, found = value_at(value, path), value_at(found, path)
            else:
                series, slopes = lily.series[number], slope.series[number]
                k = series.names.index(organ)
                field = "attachment" if hasattr(series.attachment, path) else "organ"
                value = value_at(getattr(series, field), path)[k]
                found = value_at(getattr(slopes, field), path)[k]
            h = 1e-5
            high, low = (
                float(height(pf.with_settings(lily, {name: float(value) + s * h}))) for s in (1, -1)
            )
            expected = (high - low) / (2 * h)
            assert float(found) == pytest.approx(expected, rel=1e-6, abs=1e-9), name
            assert abs(expected) > 1e-6, f"{name} moves nothing"


def test_a_flower_survives_its_file(lily, peony, tmp_path):
    for flower in (lily, peony):
        pf.save_flower(flower, tmp_path / "flower.json")
        again = pf.load_flower(tmp_path / "flower.json")
        assert jax.tree.structure(again) == jax.tree.structure(flower)
        assert all(map(np.array_equal, jax.tree.leaves(again), jax.tree.leaves(flower)))


OWN = {
    "name": "windflower",
    "receptacle": {"component": "ConeReceptacle", "parameters": {"r": 3}, "colour": "#88aa44"},
    "pedicel": {"parameters": {"h": 40}},
    "series": [
        {
            "name": "petal",
            "component": "PeonyPetal",
            "recursion": {"count": 8, "growth": 0.9},
            "attachment": {"opening": {"outer": 1.3, "inner": 0.6}, "latitude": 0.2},
            "parameters": {"a_x": {"outer": 10, "inner": 14, "jitter": 0.5}, "dy": 4},
            "colour": {
                "palette": ["#ffffff", [0.5, 0.2, 0.9]],
                "patterns": [{"pattern": "RadialPattern", "n": 3}],
            },
        },
        {
            "stamens": "polyadelphous",
            "count": 12,
            "parameters": {"filament.h": 9},
            "colours": {"anther": "#ffcc00"},
        },
        {"pistils": "compound", "carpels": 4},
    ],
}


def test_a_flower_of_ones_own():
    flower = flower_from_json(OWN, seed=1)
    petal, stamen, pistil = flower.series
    assert (len(petal), len(stamen), len(pistil)) == (8, 12, 1)
    assert pistil.organ.carpels == 4
    assert petal.attachment.opening[0] == pytest.approx(1.3)
    assert petal.attachment.opening[-1] == pytest.approx(0.6)
    assert (stamen.organ.filament.h == 9).all()
    assert np.ptp(petal.organ.a_x) > 2
    other = flower_from_json(OWN, seed=2)
    assert not np.array_equal(petal.organ.a_x, other.series[0].organ.a_x)
    assert json.loads(json.dumps(flower_to_json(flower)))["series"][0]["parameters"]["dy"] == 4.0


def changed(**members: object) -> dict:
    return OWN | {"series": [OWN["series"][0] | members]}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ([], "an object"),
        ({"format": "other"}, "no flower"),
        ({"series": {}}, "list of organs"),
        ({"petals": 3}, "'petals' means nothing here"),
        ({"receptacle": {"component": "Stamen"}}, "single surface"),
        ({"pedicel": {"component": "Bowl"}}, "its component is a Pedicel"),
        (changed(component="Leaf"), "no component 'Leaf'; there are"),
        (changed(name=""), "give it a name"),
        (changed(parameters={"width": 3}), "petal has no parameter 'width'; it has a_x"),
        (changed(parameters={"a_x": -3}), "petal.a_x = -3 lies outside its range"),
        (changed(parameters={"a_x": float("nan")}), "lies outside"),
        (changed(parameters={"a_x": "wide"}), "is 'wide', which is no number"),
        (changed(parameters={"a_x": [1, 2]}), "2 values for 8 organs"),
        (changed(parameters={"a_x": {"outer": 2}}), "outer and inner"),
        (changed(attachment={"lean": 1}), "no parameter 'lean'"),
        (changed(recursion=-4), "whole number of 1 or more; received -4"),
        (changed(recursion=True), "received True"),
        (changed(recursion={"count": 3, "speed": 1}), "speed"),
        (changed(recursion=10**12), "take some"),
        (changed(whorls=[3]), "give one of"),
        (changed(colour="red"), "written like '#c2185b'"),
        (changed(colour={"palette": []}), "petal"),
        (changed(colour={"palette": ["#ffffff"], "patterns": [{"pattern": "Dots"}]}), "no pattern"),
        (changed(colours={"anther": "#ffffff"}), "no part 'anther'"),
        (changed(options={"hollow": "bowl"}), "no option of PeonyPetal"),
        ({"series": [{"stamens": "free"}]}, "received 'free'"),
        ({"series": [{"stamens": "didynamous", "count": 7}]}, "exactly 4"),
        ({"series": [{"pistils": "compound"}]}, "2 carpels or more"),
        ({"series": [{"pistils": "simple"}, {"pistils": "simple"}]}, "must differ"),
    ],
)
def test_what_a_file_cannot_mean_is_refused(content, words):
    with pytest.raises(pf.FlowerError, match=words):
        flower_from_json(content)


def test_settings_reach_one_organ_or_all(lily):
    flower = pf.with_settings(lily, {"petal.dy": 4.0, "petal_3.dy": 5.0, "stamen.filament.h": 20.0})
    assert flower.series[0].organ.dy.tolist() == [4, 4, 5, 4, 4, 4]
    assert (flower.series[1].organ.filament.h == 20).all()
    for name, words in {
        "sepal.a_x": "no organ 'sepal'; its organs are receptacle",
        "petal.width": "no parameter 'width'; it has a_x",
        "petal": "no parameter ''",
        "petal_7.dy": "no organ 'petal_7'",
    }.items():
        with pytest.raises(pf.FlowerError, match=words):
            pf.with_settings(lily, {name: 1.0})
    with pytest.raises(pf.FlowerError, match="outside its range"):
        pf.with_settings(lily, {"petal.a_x": 1e9})


def test_organs_and_values_must_match_their_places():
    paint = pf.Colour.of("#ffffff")
    with pytest.raises(ValueError, match="2 organs for 3 places"):
        pf.Series.of("petal", [pf.PeonyPetal()] * 2, pf.whorls(3), paint)
    with pytest.raises(ValueError, match="2 values of opening for 3 places"):
        pf.Series.of("petal", pf.PeonyPetal(), pf.whorls(3), paint, opening=np.zeros(2))
    with pytest.raises(ValueError, match="no colour for anther"):
        pf.Series.of("stamen", pf.Stamen(), pf.whorls(3), {"filament": paint})
