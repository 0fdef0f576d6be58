"""The pose of an organ on the receptacle."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from petalfit.surfaces import AbstractSurface, Pose, Scalar, about_y, angle, length, number


class Attachment(eqx.Module):
    """The place of an organ on the receptacle, and its orientation there.

    The organ's own y axis leans away from the flower's axis by `opening`; its z axis, a petal's normal,
    points inwards and up. The organ stands on the receptacle's surface at u = `latitude` and
    v = `azimuth`, moved from there by `radius` away from the flower's axis, by `height` along it and by
    `aside` around it.
    """

    azimuth: Scalar = angle(0.0, "φ", (-1e6, 1e6), (0.0, 6.2832), "about the flower's axis")
    latitude: Scalar = angle(
        np.pi / 2, "u", (-1.5708, 1.5708), (0.0, 1.5708), "on the receptacle; its top is at π/2"
    )
    radius: Scalar = length(
        0.0, "ρ", (-500.0, 500.0), (0.0, 10.0), "further from the axis than the receptacle"
    )
    height: Scalar = length(0.0, "y", (-500.0, 500.0), (-5.0, 5.0), "above the receptacle")
    opening: Scalar = angle(0.0, "θ", (-3.2, 3.2), (0.0, 1.6), "from the flower's axis")
    roll: Scalar = angle(0.0, "ψ", (-6.4, 6.4), (-0.3, 0.3), "about the organ's own axis")
    scale: Scalar = number(1.0, "s", (0.001, 1000.0), (0.5, 2.0), "size of one unit of the organ")

    aside: Scalar = length(
        0.0, "α", (-500.0, 500.0), (-1.0, 1.0), "across, towards larger azimuths"
    )

    def pose(self, receptacle: AbstractSurface) -> Pose:
        """The pose from the organ's frame to the flower's; for an attachment without leading axes."""
        azimuth, opening = jnp.asarray(self.azimuth, float), jnp.asarray(self.opening, float)
        zero, up = jnp.zeros(()), jnp.asarray(np.array([0.0, 1.0, 0.0]))
        outwards = jnp.stack([jnp.cos(azimuth), zero, jnp.sin(azimuth)])
        around = jnp.stack([-jnp.sin(azimuth), zero, jnp.cos(azimuth)])
        along = jnp.cos(opening) * up + jnp.sin(opening) * outwards
        inwards = jnp.sin(opening) * up - jnp.cos(opening) * outwards
        turned = jnp.stack([around, along, inwards], axis=-1) @ about_y(self.roll)
        place = receptacle.position(jnp.asarray(self.latitude, float), azimuth)
        place = place + self.radius * outwards + self.height * up + self.aside * around
        return Pose(turned, place, jnp.asarray(self.scale, float))
