"""A fit made by hand, so that tests of what is written need not fit anything."""

import dataclasses
import functools

import numpy as np

from petalfit import FitResult, FitWarning, PeonyPetal, PointCloud, Pose, Status, parameters
from petalfit.results import Agreement, Start

HOSTILE = '<script>alert("1")</script> & <img src="http://example.com/x.png">'
NOISE = 0.05


@functools.cache
def known_pose() -> FitResult:
    """All is well, but for one weightless point in ten and a rib frequency that nobody knows."""
    petal = PeonyPetal(a_x=14.0848233, dx=-0.4)
    rng = np.random.default_rng(3)
    cloud = petal.sample(400, seed=1, noise=NOISE)
    weights = np.where(np.arange(len(cloud)) % 10, 1.0, 0.0)
    names = tuple(name for name, p in parameters(petal).items() if not p.fixed)
    factor = 0.01 * np.diag(rng.uniform(0.2, 2.0, len(names))) @ rng.normal(size=(len(names),) * 2)
    covariance = factor @ factor.T
    unknown = names.index("rib_frequency")
    covariance[unknown] = covariance[:, unknown] = np.inf
    values = {name: float(getattr(petal, name)) for name in parameters(petal)}
    free = {name: values[name] for name in names}
    distances = rng.normal(scale=NOISE, size=len(cloud))
    return FitResult(
        model=petal,
        pose=Pose.identity(),
        values=values,
        stderr=dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        identifiable={name: name != "rib_frequency" for name in names},
        names=names,
        covariance=covariance,
        agreements=(
            Agreement(PointCloud(cloud.points, weights=weights), distances, weights, NOISE),
        ),
        status=Status.CONVERGED,
        reason="converged after 4 rounds",
        warnings=(),
        steps=4,
        starts=(Start("rib_frequency 20.02", free, 0.0501, 0.0), Start("other", free, 0.06, 12.3)),
        freedom=float(len(names)),
    )


@functools.cache
def posed() -> FitResult:
    """The same, turned, moved and scaled, with warnings and a text that wants to be a program."""
    plain = known_pose()
    angle = 0.7
    turn = np.array(
        [[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]]
    )
    pose = Pose(turn, np.array([100.0, -20.0, 3.0]), 2.5)
    (part,) = plain.agreements
    points = pose.scale * part.target.points @ turn.T + pose.translation
    warnings = (
        FitWarning(
            "rib_frequency is not determined by this target", "not_determined", ["rib_frequency"]
        ),
        FitWarning("a_x ended at the bound of its range (1, 100)", "at_bound", ["a_x"]),
        FitWarning("dx ended at the bound of its range (1, 100)", "at_bound", ["dx"]),
        FitWarning(HOSTILE, "systematic"),
    )
    return dataclasses.replace(
        plain,
        pose=pose,
        agreements=(dataclasses.replace(part, target=PointCloud(points, weights=part.weights)),),
        warnings=warnings,
        starts=(dataclasses.replace(plain.starts[0], label=HOSTILE), *plain.starts[1:]),
    )


def changed(result: FitResult, **changes) -> FitResult:
    """A result with other fields, those of its only target among them."""
    (part,) = result.agreements
    fields = {field.name for field in dataclasses.fields(Agreement)}
    of_part = {name: value for name, value in changes.items() if name in fields}
    rest = {name: value for name, value in changes.items() if name not in fields}
    return dataclasses.replace(result, agreements=(dataclasses.replace(part, **of_part),), **rest)
