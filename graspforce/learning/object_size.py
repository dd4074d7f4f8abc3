"""Object size and synergies: correlation with significance, and the pre-shape for a size.

Source: HANDLE project, Parameterizing and creating new actions (undated), section 4.6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.learning.posture_library import SIZE_COLUMNS, PostureLibrary
from graspforce.learning.synergies import Synergies

_LEAST_POSTURES = 3  # of a correlation with a p-value


@dataclass(frozen=True, eq=False, slots=True)
class SizeCorrelation:
    """Pearson correlation of the amplitudes of synergies with the size of the object.

    Attributes:
        r: (k, 3) correlation coefficients of each component with opposition, ventral and lateral size; 0 where one of the two
            is constant.
        p: (k, 3) probability of a larger |r| without correlation, two-sided; 1 where one of the two is constant.
        level: significance level.
        count: number of postures.
    """

    r: Array
    p: Array
    level: float
    count: int

    @property
    def significant(self) -> npt.NDArray[np.bool_]:
        """(k, 3) whether the correlation is significant at the level, each for itself."""
        return np.asarray(self.p < self.level)


def correlate_with_size(library: PostureLibrary, synergies: Synergies, level: float = 0.05) -> SizeCorrelation:
    """Correlate the amplitudes of all components with the sizes of the objects.

    The p-values are not corrected for the number of tests: at a level of 0.05, one of 20 independent pairs appears significant.

    Args:
        library: at least three postures with sizes.
        synergies: the components.
        level: significance level, between 0 and 1.

    Raises:
        InvalidInput: an argument is not allowed.
    """
    from scipy import stats  # imported here to keep the package fast to import

    level = arrays.check_number(level, "level", above=0.0)
    if level >= 1.0:
        raise InvalidInput("level", level, "a number between 0 and 1")
    sizes = _sizes(library)
    if len(sizes) < _LEAST_POSTURES:
        raise InvalidInput("library", f"{len(sizes)} postures", f"at least {_LEAST_POSTURES} postures")
    a = synergies.project(library.q)
    r, p = np.zeros((a.shape[1], 3)), np.ones((a.shape[1], 3))
    for i in range(a.shape[1]):
        for j in range(3):
            if _varies(a[:, i]) and _varies(sizes[:, j]):
                r[i, j], p[i, j] = stats.pearsonr(a[:, i], sizes[:, j])
    return SizeCorrelation(freeze(r), freeze(p), level, len(sizes))


@dataclass(frozen=True, eq=False, slots=True)
class PreshapeModel:
    """Amplitudes of synergies as a linear function of the object's size.

    Attributes:
        synergies: the components.
        constant: (m,) amplitudes at the mean size, rad.
        slope: (m, 3) change of the amplitudes with the size, rad/m.
        mean_size: (3,) mean size of the library, m.
        rms: (n,) root mean square error of each joint in the library, rad.
    """

    synergies: Synergies
    constant: Array
    slope: Array
    mean_size: Array
    rms: Array

    def posture(self, size: npt.ArrayLike) -> Array:
        """Return the pre-shape for an object, (n,), rad; joint limits are not applied.

        Args:
            size: (3,) opposition, ventral and lateral size, m, > 0.

        Raises:
            InvalidInput: not three positive numbers.
        """
        size = arrays.check_array(size, "size", (len(SIZE_COLUMNS),), above=0.0)
        return self.synergies.posture(self.constant + self.slope @ (size - self.mean_size))


def fit_preshape(library: PostureLibrary, synergies: Synergies, count: int | None = None) -> PreshapeModel:
    """Fit the pre-shape for a size by linear least squares.

    A size that is constant in the library has no effect: the solution is the one of least norm.

    Args:
        library: at least four postures with sizes.
        synergies: the components.
        count: number of components; by default all.

    Raises:
        InvalidInput: an argument is not allowed.
    """
    k = len(synergies.components)
    count = k if count is None else fields.check_integer(count, "count", minimum=1, maximum=k)
    sizes = _sizes(library)
    if len(sizes) < len(SIZE_COLUMNS) + 1:
        raise InvalidInput("library", f"{len(sizes)} postures", f"at least {len(SIZE_COLUMNS) + 1} postures")
    a, mean = synergies.project(library.q)[:, :count], sizes.mean(axis=0)
    constant = a.mean(axis=0)
    slope = np.linalg.lstsq(sizes - mean, a - constant, rcond=1e-9)[0].T
    predicted = synergies.mean + (constant + (sizes - mean) @ slope.T) @ synergies.components[:count]
    rms = np.sqrt(np.square(predicted - library.q).mean(axis=0))
    return PreshapeModel(synergies, freeze(constant), freeze(slope), freeze(mean), freeze(rms))


def _sizes(library: PostureLibrary) -> Array:
    """Return the sizes of a library that has them."""
    if library.sizes is None:
        raise InvalidInput("library.sizes", None, "the sizes of the objects")
    return library.sizes


def _varies(values: Array) -> bool:
    """Return whether numbers differ by more than rounding."""
    return bool(np.ptp(values) > 1e-12 * max(1.0, float(np.abs(values).max())))
