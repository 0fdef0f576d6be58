"""Normal equations for the coefficients of a spline surface."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from petalfit.components import SplinePetal
from petalfit.components.spline_petal import SEGMENTS, basis

SHAPE = (SEGMENTS[0] + 3, SEGMENTS[1] + 3)
COUNT = SHAPE[0] * SHAPE[1]


def surface_of(control: Float[np.ndarray, "k 3"]) -> SplinePetal:
    """The surface of coefficients that are places, not offsets."""
    zero = np.float64(0.0)
    return SplinePetal(a_x=zero, b_y=zero, c_z=zero, offsets=control.reshape(*SHAPE, 3))


def surfaces_of(controls: Float[np.ndarray, "d k 3"]) -> SplinePetal:
    """A batch of such surfaces."""
    return jax.tree.map(lambda *leaves: np.stack(leaves), *map(surface_of, controls))


class Equations:
    """Normal equations of all three coordinates of all coefficients."""

    def __init__(
        self,
        control: Float[np.ndarray, "k 3"],
        stiffness: Float[np.ndarray, "k k"],
        tied: Float[np.ndarray, " k"],
    ) -> None:
        """Starts with what the points do not say.

        Args:
            control: Coefficients, as places.
            stiffness: The matrix of the cost of bending.
            tied: The weights that keep coefficients near `control`.
        """
        self.matrix = np.kron(stiffness + np.diag(tied), np.eye(3))
        self.right = (tied[:, None] * control).ravel()
        self.held = self.matrix.copy()

    def add(
        self,
        rows: Float[np.ndarray, "m k"],
        directions: Float[np.ndarray, "m 3"],
        target: Float[np.ndarray, " m"],
        weights: Float[np.ndarray, " m"],
    ) -> None:
        """Adds equations: places (`rows` of coefficients) should have `target` along `directions`."""
        root = np.sqrt(weights)
        slopes = rows[:, :, None] * directions[:, None, :] * root[:, None, None]
        slopes = slopes.reshape(len(rows), 3 * rows.shape[1])
        self.matrix += slopes.T @ slopes
        self.right += slopes.T @ (target * root)

    def freedom(self) -> float:
        """Effective number of parameters: the trace of the matrix from given to fitted positions."""
        return len(self.matrix) - float(np.trace(np.linalg.solve(self.matrix, self.held)))

    def solved(self) -> Float[np.ndarray, "k 3"]:
        return np.linalg.solve(self.matrix, self.right).reshape(-1, 3)


def rows_at(uv: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n k"]:
    """The weight of every coefficient at given places."""
    first = (uv[:, 0] + 0.5, SEGMENTS[0]), (uv[:, 1], SEGMENTS[1])
    (i, across), (j, along) = (map(np.asarray, basis(jnp.asarray(x), n)) for x, n in first)
    rows = np.zeros((len(uv), *SHAPE))
    number = np.arange(len(uv))
    for k in range(4):
        for m in range(4):
            rows[number, i + k, j + m] = across[:, k] * along[:, m]
    return rows.reshape(len(uv), -1)


def bending() -> Float[np.ndarray, "k k"]:
    """The matrix of the sum of squared second differences of the coefficients."""

    def squares(n: int, times: int) -> np.ndarray:
        step = np.diff(np.eye(n), times, axis=0)
        return step.T @ step

    (m, n), eye = SHAPE, np.eye
    return (
        np.kron(squares(m, 2), eye(n))
        + np.kron(eye(m), squares(n, 2))
        + 2 * np.kron(squares(m, 1), squares(n, 1))
    )
