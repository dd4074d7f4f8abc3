"""Synergies: the principal components of a library of postures.

A posture is the mean plus a combination of components, q = q̄ + Σ a_i e_i. The components e_i are orthonormal and ordered by
the variance of their amplitudes a_i. Sources: Santello, Flanders and Soechting (1998); HANDLE project (2012), deliverable 24,
section 4, whose formula omits the mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.optional_libraries import optional_imports
from graspforce.grasp.search.prior import PosturePrior
from graspforce.learning.posture_library import PostureLibrary


@dataclass(frozen=True, eq=False, slots=True)
class Synergies:
    """Principal components of postures.

    Attributes:
        joints: names of the n joints.
        mean: (n,) mean posture q̄, rad.
        components: (k, n) orthonormal components e_i, the largest variance first; the largest entry of each is positive.
        variances: (k,) variances of the amplitudes, rad².
        total_variance: variance of the postures, rad²; the sum over all components.
        amplitudes: (N, k) amplitudes of the postures of the library, rad.
    """

    joints: tuple[str, ...]
    mean: Array
    components: Array
    variances: Array
    total_variance: float
    amplitudes: Array

    @property
    def cumulative_variance(self) -> Array:
        """(k,) fraction of the variance that the first 1 … k components explain."""
        if self.total_variance <= 0.0:
            return freeze(np.ones(len(self.variances)))
        return freeze(np.minimum(np.cumsum(self.variances) / self.total_variance, 1.0))

    def count_for(self, fraction: float) -> int:
        """Return the least number of components that explain a fraction of the variance.

        Args:
            fraction: the fraction, above 0 and at most that of all components.

        Raises:
            InvalidInput: the fraction is not in that range.
        """
        cumulative = self.cumulative_variance
        fraction = arrays.check_number(fraction, "fraction", above=0.0)
        if fraction > cumulative[-1] + 1e-12:
            raise InvalidInput("fraction", fraction, f"at most {cumulative[-1]:.6g}, the fraction of all components")
        return int(np.searchsorted(cumulative, fraction - 1e-12) + 1)

    def project(self, q: npt.ArrayLike) -> Array:
        """Return the amplitudes of postures, (N, k), rad.

        Args:
            q: (N, n) postures, rad.

        Raises:
            InvalidInput: another shape.
        """
        q = arrays.check_array(q, "q", (None, len(self.joints)))
        return freeze((q - self.mean) @ self.components.T)

    def posture(self, amplitudes: npt.ArrayLike) -> Array:
        """Return the posture of amplitudes of the first components, (n,), rad; limits are not applied.

        Args:
            amplitudes: (m,) amplitudes, m ≤ k, rad.

        Raises:
            InvalidInput: more amplitudes than components.
        """
        a = arrays.check_array(amplitudes, "amplitudes", (None,))
        if len(a) > len(self.components):
            raise InvalidInput("amplitudes", f"{len(a)} numbers", f"at most {len(self.components)}")
        return freeze(self.mean + a @ self.components[: len(a)])

    def reconstruct(self, q: npt.ArrayLike, count: int) -> Array:
        """Return the nearest postures that the first components can express, (N, n), rad.

        Args:
            q: (N, n) postures, rad.
            count: number of components, from 0 to k.

        Raises:
            InvalidInput: an argument is not allowed.
        """
        count = fields.check_integer(count, "count", minimum=0, maximum=len(self.components))
        return freeze(self.mean + self.project(q)[:, :count] @ self.components[:count])

    def reconstruction_error(self, q: npt.ArrayLike) -> Array:
        """Return the root mean square error of each joint with 0 … k components, (k + 1, n), rad.

        Args:
            q: (N, n) postures, rad, of the library or others.

        Raises:
            InvalidInput: no posture, or another shape.
        """
        q = arrays.check_array(q, "q", (None, len(self.joints)))
        if not len(q):
            raise InvalidInput("q", q, "at least one posture")
        errors = [q - self.reconstruct(q, count) for count in range(len(self.components) + 1)]
        return freeze(np.sqrt(np.square(errors).mean(axis=1)))

    def sweep(self, component: int, span: float = 2.0, frames: int = 41) -> Array:
        """Return postures along one component, through the mean and back to the start, for a film, (frames, n), rad.

        Args:
            component: index of the component, from 0.
            span: largest amplitude in standard deviations, > 0.
            frames: number of postures, ≥ 2.

        Raises:
            InvalidInput: an argument is not allowed.
        """
        component = fields.check_integer(component, "component", minimum=0, maximum=len(self.components) - 1)
        span = arrays.check_number(span, "span", above=0.0)
        frames = fields.check_integer(frames, "frames", minimum=2, maximum=100_000)
        a = span * np.sqrt(self.variances[component]) * np.sin(np.linspace(0.0, 2.0 * np.pi, frames))
        return freeze(self.mean + a[:, None] * self.components[component])

    def prior(self, count: int) -> PosturePrior:
        """Return the distribution of postures in the first components, for `find_grasp`.

        Args:
            count: number of components b, from 1 to k.

        Raises:
            InvalidInput: not such a number.
        """
        b = fields.check_integer(count, "count", minimum=1, maximum=len(self.components))
        return PosturePrior(self.joints, self.mean, self.components[:b], freeze(np.sqrt(self.variances[:b])))


def fit_synergies(library: PostureLibrary, count: int | None = None) -> Synergies:
    """Compute the principal components of a library of postures.

    Args:
        library: at least two postures.
        count: number of components; by default as many as the postures and joints allow.

    Raises:
        InvalidInput: too few postures, or too many components.
        MissingLibrary: scikit-learn is not installed.
    """
    with optional_imports():
        from sklearn.decomposition import PCA
    if len(library) < 2:
        raise InvalidInput("library", f"{len(library)} postures", "at least two postures")
    largest = min(len(library) - 1, len(library.joints))
    count = largest if count is None else fields.check_integer(count, "count", minimum=1, maximum=largest)
    pca = PCA(count, svd_solver="full").fit(library.q)
    signs = np.sign(pca.components_[np.arange(count), np.abs(pca.components_).argmax(axis=1)])
    components = signs[:, None] * pca.components_
    total = float(np.var(library.q, axis=0, ddof=1).sum())
    return Synergies(
        joints=library.joints,
        mean=freeze(pca.mean_),
        components=freeze(components),
        variances=freeze(pca.explained_variance_),
        total_variance=total,
        amplitudes=freeze((library.q - pca.mean_) @ components.T),
    )
