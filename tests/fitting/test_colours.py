"""Patterns come back from textures and from the colours of clouds."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

import petalfit as pf
from petalfit.colours import AbstractPattern, from_hex, to_srgb
from petalfit.fitting import colours_on
from petalfit.surfaces import parameter

NOISE = 0.02


def places(n=128):
    u = (np.arange(n) + 0.5) / n - 0.5
    v = 1 - (np.arange(n) + 0.5) / n
    return u[None, :], v[:, None]


def random_pattern(kind, rng):
    values = {}
    for name, declared in pf.parameters(kind).items():
        low, high = declared.typical
        values[name] = low + (high - low) * rng.uniform(0.1, 0.9)
    return kind(**values)


def intensities(pattern, rng):
    exact = np.asarray(pattern(*places()))
    return exact + NOISE * rng.standard_normal(exact.shape)


def bounds(pattern) -> dict[str, float]:
    """Cramér-Rao bounds by finite differences."""
    columns = []
    h = 1e-5
    for name in pf.parameters(pattern):
        high, low = (
            np.asarray(
                type(pattern)(**vars(pattern) | {name: getattr(pattern, name) + s * h})(*places())
            )
            for s in (1, -1)
        )
        columns.append((high - low).ravel() / (2 * h))
    slopes = np.stack(columns, axis=-1)
    covariance = NOISE**2 * np.linalg.inv(slopes.T @ slopes)
    return dict(zip(pf.parameters(pattern), np.sqrt(np.diag(covariance)), strict=True))


@pytest.mark.parametrize("kind", [pf.RadialPattern, pf.RibPattern])
def test_a_pattern_comes_back_from_a_noisy_texture(kind):
    """Within five Cramér-Rao bounds, or it is said not to be determined; and mostly it is."""
    rng = np.random.default_rng(1)
    determined = errors = 0
    for _ in range(6):
        truth = random_pattern(kind, rng)
        with jax.enable_x64(True):
            image, limits = intensities(truth, rng), bounds(truth)
        result = pf.fit(kind, pf.Texture(image))
        assert result.converged
        assert result.noise == pytest.approx(NOISE, rel=0.03)
        for name, limit in limits.items():
            errors += 1
            if not result.identifiable[name]:
                assert result.stderr[name] == np.inf
                continue
            determined += 1
            assert abs(result.values[name] - getattr(truth, name)) < 5 * limit
            assert 0.5 < result.stderr[name] / limit < 2.0  # where it is, and where the truth is
    assert determined >= 0.8 * errors


def test_without_noise_a_pattern_comes_back_exactly():
    truth = pf.RibPattern(i_1=0.2, i_2=0.6, f=13.0, n_1=0.6, n_2=0.9, k=0.7)
    with jax.enable_x64(True):
        image = np.asarray(truth(*places()))
    result = pf.fit(pf.RibPattern, image)
    for name, value in result.values.items():
        assert value == pytest.approx(getattr(truth, name), rel=1e-6)


def test_colours_become_intensities_between_the_two_of_a_palette():
    truth = pf.RadialPattern(i_1=0.1, i_2=0.8, n=3.0, f=0.8, phi=0.3)
    palette = ("#fbe3ea", "#8e1750")
    # All columns are alike, so that rounding to 256 levels does not average out.
    picture = pf.Colour.of(*palette, patterns=(truth,)).texture((128, 128))
    result = pf.fit(pf.RadialPattern, pf.Texture(picture), palette=palette)
    for name, value in result.values.items():
        assert value == pytest.approx(getattr(truth, name), abs=0.1)
    np.testing.assert_allclose(result.palette, [from_hex(colour) for colour in palette], atol=1e-9)
    # Without a palette the colours' own ends serve: the figure is the same, on another scale.
    own = pf.fit(pf.RadialPattern, pf.Texture(picture))
    for name in ("n", "f", "phi"):
        assert own.values[name] == pytest.approx(getattr(truth, name), abs=0.1)


def test_the_colours_of_a_cloud_are_fitted_on_its_petal():
    truth = pf.RadialPattern(i_1=0.1, i_2=0.8, n=2.5, f=1.2, phi=0.2)
    petal = pf.PeonyPetal()
    rng = np.random.default_rng(0)
    u, v = rng.uniform(-0.5, 0.5, 1500), rng.uniform(0, 1, 1500)
    palette = ("#fbe3ea", "#8e1750")
    with jax.enable_x64(True):
        points = np.asarray(petal(u, v)) + 0.02 * rng.standard_normal((1500, 3))
        colours = np.asarray(to_srgb(pf.Colour.of(*palette, patterns=(truth,))(u, v)))
    cloud = pf.PointCloud(points, colours=colours)
    for surface in (petal, pf.fit_petal(cloud)):
        result = pf.fit(pf.RadialPattern, cloud, surface=surface, palette=palette)
        for name, value in result.values.items():
            assert value == pytest.approx(getattr(truth, name), abs=0.05)
    texture = colours_on(petal, cloud)
    inside = np.abs(u) < 0.4  # at folds and edges a noisy point has its foot elsewhere
    off = np.abs(texture.uv - np.stack([u, v], axis=-1))[inside]
    assert np.median(off) < 0.002


def test_noise_has_no_pattern():
    rng = np.random.default_rng(3)
    result = pf.fit(pf.RadialPattern, 0.5 + 0.1 * rng.standard_normal((64, 64)))
    assert not any(result.identifiable[name] for name in ("i_2", "n", "f", "phi"))
    assert "shows no pattern" in result.message


def test_fixed_parameters_and_starts_are_kept():
    truth = pf.RadialPattern(i_1=0.1, i_2=0.7, n=2.0, f=1.3, phi=0.4)
    rng = np.random.default_rng(2)
    image = intensities(truth, rng)
    result = pf.fit(pf.RadialPattern(n=2.0), image, free=["i_1", "i_2", "f", "phi"])
    assert result.values["n"] == 2.0
    assert result.names == ("i_1", "i_2", "f", "phi")
    given = pf.fit(pf.RadialPattern, image, init=truth, noise=NOISE)
    assert given.noise == NOISE
    assert len(given.starts) == 1


class Dots(AbstractPattern):
    """A pattern of one's own."""

    width: float = parameter(
        0.1, symbol="w", unit="1", bounds=(0.01, 1.0), typical=(0.05, 0.4), meaning="of the spot"
    )

    def figure(self, u: Array, v: Array) -> Array:
        return jnp.exp(-(u**2 + (v - 0.5) ** 2) / (2 * self.width**2))


def test_a_pattern_of_ones_own_is_fitted_too():
    rng = np.random.default_rng(4)
    truth = Dots(i_1=0.2, i_2=0.6, width=0.17)
    result = pf.fit(Dots, intensities(truth, rng))
    assert result.values["width"] == pytest.approx(0.17, abs=5 * result.stderr["width"])
    assert isinstance(result.model, eqx.Module)


@pytest.mark.parametrize(
    ("target", "words"),
    [
        (np.zeros((8, 8, 2)), "expected \\(H, W\\)"),
        (np.full((64, 64), 0.3), "of one colour"),
        (np.full((64, 64, 3), 0.3), "are the same"),
        (np.full((64, 64), np.nan), "NaN or infinite"),
        (np.full((16, 16, 3), 7.0), "outside 0 to 1"),
        (np.zeros((3, 4)), "12 places show no pattern"),
        (pf.PeonyPetal().sample(50), "no colours"),
    ],
    ids=["channels", "flat", "grey", "nan", "range", "few", "cloud"],
)
def test_what_shows_no_pattern_is_refused(target, words):
    with pytest.raises(pf.TargetError, match=words):
        pf.fit(pf.RadialPattern, target, surface=pf.PeonyPetal())


def test_textures_are_read_from_files(tmp_path):
    from PIL import Image

    rng = np.random.default_rng(5)
    grey = (255 * rng.random((20, 24))).astype(np.uint8)
    Image.fromarray(grey).save(tmp_path / "grey.png")
    texture = pf.Texture.load(tmp_path / "grey.png")
    np.testing.assert_allclose(texture.values.reshape(20, 24), grey / 255)
    rgba = (255 * rng.random((20, 24, 4))).astype(np.uint8)
    rgba[:5, :, 3] = 0
    Image.fromarray(rgba).save(tmp_path / "colour.png")
    texture = pf.Texture.load(tmp_path / "colour.png")
    assert (texture.weights.reshape(20, 24)[:5] == 0).all()
    np.testing.assert_allclose(texture.values[-1], rgba[-1, -1, :3] / 255)
    (tmp_path / "broken.png").write_bytes(b"no picture")
    with pytest.raises(pf.TargetError, match="cannot be read as an image"):
        pf.Texture.load(tmp_path / "broken.png")
    for uv, words in [
        (np.zeros((20, 3)), "expected \\(N, 2\\)"),
        (np.full((20, 2), 2.0), "leaves"),
    ]:
        with pytest.raises(pf.TargetError, match=words):
            pf.Texture.at(uv, np.zeros(20))
