"""Check that a body's strain is within what the material law and the grid can represent, and warnings where it is not.

Three limits, each with its reason:

* LARGE_STRETCH: the neo-Hookean law follows rubber in tension to a stretch of about 1.5. Beyond, rubber is first softer than it, by up to a
  fifth, and from about 5 on far stiffer (Treloar, The Physics of Rubber Elasticity, chapter 5); filled silicone stiffens sooner.
* VOLUME: silicone's own K/G is near 1000, and its volume hardly changes. K = 20 G stands in for that while the volume changes by a few
  percent only: at 20 % the pressure is 4 G. And the law's K/2 (J - 1)^2 resists by no more than K/2 however small J gets.
* Bend: an axis bent to a radius of less than the thickness has its outer side stretched to 1.5 and its inner one crushed to a half. With
  two cells across, the fewest there are, a cell then turns by half a radian, as much as the one curvature that the quadratic splines
  have in a cell should stand for: so the grid needs no limit of its own.

Strain in less than SHARE_STRETCHED of the volume is ignored: at the rim of a clamp and where materials meet it is singular; finer cells
show more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from magmpm.bodies.curves import tightest_radius
from magmpm.bodies.polar_grid import PolarGrid
from magmpm.compiled.arrays import Array, NamedNumbers
from magmpm.compiled.jit import compiled
from magmpm.materials import determinant, poisson_ratio
from magmpm.model import Model

LARGE_STRETCH = 1.5
VOLUME = 0.2
SHARE_STRETCHED = 0.005
REMEDY = "check the units of loads and of shear_modulus"


@dataclass(frozen=True)
class Strain:
    """Strain of a body's material: how far it is stretched, swollen and bent.

    Attributes
    ----------
    stretch : float, no unit
        The largest stretch.
    stretched : float, no unit
        Share of the volume, 0 to 1, that is stretched beyond LARGE_STRETCH.
    swollen : float, no unit
        Share of the volume whose det F is beyond VOLUME from 1.
    min_det_F : float, no unit
        Least det F.
    max_det_F : float, no unit
        Largest det F.
    radius : float, m
        Of the axis where it is bent most; inf: straight, or there is no axis.
    time : float, s, or None
        Of the worst moment; None of an equilibrium.
    """

    stretch: float = 1.0
    stretched: float = 0.0
    swollen: float = 0.0
    min_det_F: float = 1.0
    max_det_F: float = 1.0
    radius: float = np.inf
    time: float | None = None

    def worst(self, other: Strain) -> Strain:
        """Join two strains: the worst of both; the time is that of the larger stretch.

        Parameters
        ----------
        other : Strain
            The other one.

        Returns
        -------
        Strain
            Both.
        """
        return Strain(
            stretch=max(self.stretch, other.stretch),
            stretched=max(self.stretched, other.stretched),
            swollen=max(self.swollen, other.swollen),
            min_det_F=min(self.min_det_F, other.min_det_F),
            max_det_F=max(self.max_det_F, other.max_det_F),
            radius=min(self.radius, other.radius),
            time=other.time if other.stretch > self.stretch else self.time,
        )

    def warnings(self, model: Model) -> list[str]:
        """Warn of limits that are exceeded.

        Parameters
        ----------
        model : Model
            The body.

        Returns
        -------
        list of str
            One sentence for each.
        """
        when = "" if self.time is None else f", at {self.time:.3g} s"
        found = []
        if self.stretched > SHARE_STRETCHED:
            found.append(
                f"strain: {100 * self.stretched:.3g} % of the volume is stretched to more than "
                f"{LARGE_STRETCH:g} times its length (at most {self.stretch:.3g}"
                f" times{when}), where "
                f"the neo-Hookean law no longer describes silicone; {REMEDY}"
            )
        if self.swollen > SHARE_STRETCHED:
            found.append(
                f"strain: {100 * self.swollen:.3g} % of the volume has a det F below {1 - VOLUME:g}"
                f" or above {1 + VOLUME:g} (it is {self.min_det_F:.3g} to {self.max_det_F:.3g}),"
                f" where silicone would keep its volume; raise bulk_to_shear, or {REMEDY}"
            )
        thickness = model.scene.thickness
        tube = model.scene.body.catheter
        kinks = (
            0.0
            if tube is None
            else tube.kink_radius(float(poisson_ratio(model.shear, model.bulk).max()))
        )
        if model.line is not None and self.radius < thickness:
            found.append(
                f"strain: the axis is bent to a radius of {1e3 * self.radius:.3g} mm, less than the"
                f" body is thick, {1e3 * thickness:.3g} mm: its inner side is crushed; {REMEDY}"
            )
        elif model.line is not None and kinks > self.radius:
            hidden = (
                ""
                if isinstance(model.grid, PolarGrid)
                else ", which cells larger than the wall do not show"
            )
            found.append(
                f"strain: the tube is bent to a radius of {1e3 * self.radius:.3g} mm; from"
                f" {1e3 * kinks:.3g} mm on its section flattens and it kinks (Brazier){hidden};"
                " thicken the wall, or bend it less"
            )
        return found

    def state(self) -> NamedNumbers:
        """Write the strain as plain numbers, from which `restored` makes the same one.

        Returns
        -------
        dict[str, float]
            Numbers by name.
        """
        return {
            f"strain_{name}": value
            for name, value in vars(self).items()
            if value is not None and np.isfinite(value)
        }

    @classmethod
    def restored(cls, state: Mapping[str, float]) -> Strain:
        """Make the strain of a `state`.

        Parameters
        ----------
        state : Mapping[str, float]
            It may hold other numbers too.

        Returns
        -------
        Strain
            The strain.
        """
        return cls(
            **{
                key.removeprefix("strain_"): value
                for key, value in state.items()
                if key.startswith("strain_")
            }
        )


def strain_of(model: Model, position: Array, F: Array, time: float | None = None) -> Strain:
    """Find the strain of a body. Stretches are computed where they may exceed the limit, or be the largest.

    Parameters
    ----------
    model : Model
        The body.
    position : array (n, 3), m
        Of its particles.
    F : array (n, 3, 3), no unit
        Their deformation gradients.
    time : float, s, optional
        Of the moment; none of an equilibrium.

    Returns
    -------
    Strain
        The strain.
    """
    volume = model.particles.volume
    J = np.empty(len(F))
    squares = np.empty(len(F))
    _invariants(F, J, squares)
    first = int(np.argmax(squares))
    known = min(float(_stretches(F[[first]])[0]), LARGE_STRETCH)
    # tr F^T F is at least that, where the stretch is `known`: with the other two alike
    least = known**2 + 2.0 * J / known
    some = np.union1d(np.flatnonzero(squares >= least * (1 - 1e-12)), [first])
    stretch = _stretches(F[some])
    whole = float(volume.sum())
    return Strain(
        stretch=float(stretch.max()),
        stretched=float(volume[some[stretch > LARGE_STRETCH]].sum()) / whole,
        swollen=float(volume[np.abs(J - 1.0) > VOLUME].sum()) / whole,
        min_det_F=float(J.min()),
        max_det_F=float(J.max()),
        radius=np.inf if model.line is None else tightest_radius(_slices(model, position)),
        time=time,
    )


def _stretches(F: Array) -> Array:
    """Largest stretch (n,) of F (n, 3, 3)."""
    return np.asarray(np.sqrt(np.linalg.eigvalsh(np.einsum("nki,nkj->nij", F, F))[:, 2]))


@compiled
def _invariants(F, J, squares):  # type: ignore[no-untyped-def]
    """det F and tr F^T F (n,) of F (n, 3, 3)."""
    for p in range(len(F)):
        J[p] = determinant(F[p])
        squares[p] = 0.0
        for i in range(3):
            for j in range(3):
                squares[p] += F[p, i, j] ** 2


def _slices(model: Model, position: Array) -> Array:
    """Mean position (cells, 3) m of what is in each slice of cells along a straight body."""
    of = model.particles.cell[:, 0]
    volume = model.particles.volume
    whole = np.bincount(of, volume)
    return np.stack([np.bincount(of, volume * x) / whole for x in position.T], axis=1)
