"""Organs of several surfaces: a stamen of filament and anther, a pistil of ovary, style, stigma."""

from __future__ import annotations

import abc

import equinox as eqx

from petalfit.surfaces import AbstractSurface, Pose


class AbstractAssembly(eqx.Module):
    """Named surfaces, each posed in the frame of the whole. A subclass says where its parts are.

    Poses may depend on the parts: an anther stands where its filament ends, however long that is.
    """

    @abc.abstractmethod
    def parts(self) -> dict[str, tuple[Pose, AbstractSurface]]:
        """Pose and surface of every part by its name; a name with a / is a part of a part."""
