"""The force problem: contact forces of least cost within friction cones and limits.

    minimise   cost(f)                      over the stacked contact forces f
    subject to G f = w                      equilibrium: the contacts supply the wrench w
               f_i in K_i                   friction cones, exact or pyramids
               min ≤ f_n,i ≤ max            normal forces
               lower ≤ tau_u + Jᵀ f ≤ upper motor torques

Source: Al-Gallaf (undated), equations (14) to (21), with three corrections: normals point inwards, torque limits have two
sides, and the linear term of the cost is J W tau_u, which does not contain f.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from graspforce.contact import friction
from graspforce.contact.contact import Contact, ContactSet
from graspforce.contact.matrices import characteristic_length, grasp_matrix
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import copy_unchecked, set_fields
from graspforce.core.text_table import Table
from graspforce.force.contact_values import with_contact_values
from graspforce.force.problem_options import Cone, Objective
from graspforce.force.uncertainty import Uncertainty
from graspforce.geometry.vectors import cross
from graspforce.hand.actuation import Actuation

SCHEMA = "graspforce/problem/1"
_MOST_DISTANT = 1e6  # median distances: moments are certified to 1e-8 of the distances' root mean square


@dataclass(frozen=True, eq=False)
class ForceProblem:
    """A force problem: validated, read-only arrays.

    Args:
        contacts: the contacts, in the order in which their forces are stacked: `Contact`s or a `ContactSet`.
        w: (6,) wrench that the contacts must supply about O's origin, in O, N and N·m, linear first.
        actuation: the motor torques that contact forces need, and their limits; None to leave the hand out.
        cone: model of the friction cones; exact by default.
        objective: "torque" by default with an actuation, "force" without.
        name: name of the problem.
        source: its origin, such as a publication.
        uncertainty: errors that the forces must survive; None for exact data.

    Raises:
        InvalidInput: a value that is not allowed; names the field as in a problem file.
    """

    contacts: ContactSet
    w: Array
    actuation: Actuation | None
    cone: Cone
    objective: Objective
    name: str
    source: str
    uncertainty: Uncertainty | None

    def __init__(
        self,
        contacts: ContactSet | Sequence[Contact],
        w: npt.ArrayLike,
        actuation: Actuation | None = None,
        cone: Cone | None = None,
        objective: Objective | None = None,
        name: str = "",
        source: str = "",
        uncertainty: Uncertainty | None = None,
    ) -> None:
        if not isinstance(contacts, ContactSet):
            contacts = ContactSet.stack(fields.check_sequence(contacts, "contacts", at_least=1))
        set_fields(
            self,
            contacts=contacts,
            w=arrays.check_array(w, "wrench", (6,)),
            actuation=actuation,
            cone=cone or Cone(),
            objective=objective or Objective("torque" if actuation else "force"),
            name=fields.check_text(name, "name"),
            source=fields.check_text(source, "source"),
            uncertainty=uncertainty,
        )
        if not np.isfinite(self.G_centred).all():
            farthest = self.contacts.p_OC[int(np.abs(self.contacts.p_OC).max(axis=1).argmax())]
            raise InvalidInput("contacts", farthest, "at positions whose moments do not overflow")
        _check_contacts_are_close(self.contacts)
        if actuation is not None and actuation.J.shape[0] != self.contacts.size:
            allowed = f"one row for each of the {self.contacts.size} force components"
            raise InvalidInput("hand.jacobian", f"{actuation.J.shape[0]} rows", allowed)
        if self.objective.type == "torque" and actuation is None:
            raise InvalidInput("objective.type", "torque", "force, max_normal, sum_normal or margin: torque needs a hand")
        if self.objective.type == "margin":
            _check_margin_is_bounded(self.contacts, actuation)
        if uncertainty is not None:
            _check_uncertainty(self, uncertainty)

    def __repr__(self) -> str:
        return f"<ForceProblem: {self._summary()}>"

    def __str__(self) -> str:
        return f"{self._table()}\n{self._wrench_text()}"

    def _repr_html_(self) -> str:
        return f"{self._table().to_html()}<p>{self._wrench_text()}</p>"

    def _summary(self) -> str:
        """Return the name, the contacts, cones, objective and motors in one line."""
        cone = "exact cones" if self.cone.type == "exact" else f"{self.cone.side} pyramids of {self.cone.facets} facets"
        hand = "no hand" if self.actuation is None else f"{len(self.actuation.tau_u)} motors"
        name = f"{self.name}: " if self.name else ""
        errors = "" if self.uncertainty is None else ", uncertain data"
        return f"{name}{len(self.contacts)} contacts, {cone}, objective {self.objective.type}, {hand}{errors}"

    def _table(self) -> Table:
        """Return the table of contacts, with the summary as its title."""
        header = ("contact", "model", "position in O (m)", "normal in O", "friction", "normal force (N)")
        rows = []
        for i, contact in enumerate(self.contacts.contacts):
            upper = "" if contact.max_normal is None else f" to {contact.max_normal:.4g}"
            limits = f"{contact.min_normal:.4g}{upper or ' or more'}"
            mu = f"{contact.friction:.4g}"
            rows.append((str(i), contact.model.value, _vector(contact.position), _vector(contact.normal), mu, limits))
        return Table(header, tuple(rows), self._summary())

    def _wrench_text(self) -> str:
        """Return the wrench that the contacts supply, as a line."""
        return f"wrench to supply: force {_vector(self.w[:3])} N, moment {_vector(self.w[3:])} N·m about O"

    @cached_property
    def G(self) -> Array:
        """The (6, k) grasp matrix: it maps stacked contact forces to the wrench on the object about O's origin, in O."""
        G = self.G_centred.copy()
        x, y, z = self.contacts.centroid.tolist()  # m
        G[3] += y * G[2] - z * G[1]
        G[4] += z * G[0] - x * G[2]
        G[5] += x * G[1] - y * G[0]
        return arrays.freeze(G)

    @cached_property
    def G_centred(self) -> Array:
        """The (6, k) grasp matrix with moments about the contacts' centroid, which does not depend on O."""
        c = self.contacts
        with np.errstate(over="ignore", invalid="ignore"):  # __init__ rejects an overflow
            p = c.p_OC - c.centroid
            return grasp_matrix(ContactSet(p, c.R_OC, c.models, c.mu, c.gamma, c.min_normal, c.max_normal))

    @cached_property
    def w_centred(self) -> Array:
        """The (6,) wrench w with the moment about the contacts' centroid, N and N·m."""
        force, moment = self.w[:3].tolist(), self.w[3:].tolist()  # N, N·m
        arm = cross(self.contacts.centroid.tolist(), force)  # N·m
        return np.array([*force, *(m - a for m, a in zip(moment, arm, strict=True))])

    @cached_property
    def length(self) -> float:
        """The characteristic length of the contacts, m: moments divided by it compare with forces."""
        return characteristic_length(self.contacts)

    @cached_property
    def component_units(self) -> Array:
        """The (k,) ratio of each stacked component's unit to the force unit: 1, or the characteristic length for moments."""
        return np.where(self.contacts.columns % 4 == friction.M_N, self.length, 1.0)

    @cached_property
    def transmissible_units(self) -> Array:
        """The (k, 1) component units, 0 for components that friction cannot transmit."""
        return np.asarray((self.component_units * self.contacts.transmissible)[:, None])

    @cached_property
    def force_weights(self) -> Array:
        """The (k,) weights of the squared components in ‖f‖²: 1, or 1/ℓ² for moments, with ℓ the objective's moment_length."""
        is_moment = self.contacts.columns % 4 == friction.M_N
        return arrays.freeze(np.where(is_moment, self.objective.moment_length**-2, 1.0))

    @property
    def size(self) -> int:
        """The number k of stacked force components."""
        return self.contacts.size

    def torques(self, f: Array) -> Array:
        """Return (n,) the motor torques tau = tau_u + Jᵀ f, N·m; empty without an actuation.

        Args:
            f: (k,) stacked contact forces, N and N·m.
        """
        return np.zeros(0) if self.actuation is None else np.asarray(self.actuation.tau_u + self.actuation.J.T @ f)

    def cone_margins(self, f: Array) -> Array:
        """Return (N,) the slip margins in the cones of this problem, N; inf for contacts without friction.

        Args:
            f: (k,) stacked contact forces, N and N·m.
        """
        padded, (mu, gamma) = self.contacts.pad(f), (self.contacts.mu, self.contacts.gamma)
        if self.cone.type == "exact":
            margins = friction.slip_margin(padded, mu, gamma)
        else:
            shape = (self.cone.facets, self.cone.side)
            each = [friction.pyramid_margin(padded[i], mu[i], gamma[i], *shape) for i in range(len(mu))]
            margins = np.array(each)
        return np.where(mu > 0, margins, np.inf)

    def cost(self, f: Array) -> float:
        """Return the value of the objective (for "margin", s).

        Args:
            f: (k,) stacked contact forces, N and N·m.
        """
        kind, normals = self.objective.type, f[self.contacts.normal_rows]  # N
        if kind == "torque":
            assert self.actuation is not None  # validated by __init__
            tau = self.torques(f)  # N·m
            squares = float(f @ (self.force_weights * f))
            return 0.5 * float(tau @ (self.actuation.weight * tau)) + 0.5 * self.objective.force_weight * squares
        if kind == "force":
            return 0.5 * float(f @ (self.force_weights * f))
        if kind == "max_normal":
            return float(normals.max())
        if kind == "sum_normal":
            return float(normals.sum())
        return float(self.cone_margins(f).min())

    def replace(
        self,
        *,
        w: npt.ArrayLike | None = None,
        J: npt.ArrayLike | None = None,
        tau_u: npt.ArrayLike | None = None,
        mu: npt.ArrayLike | None = None,
        p: npt.ArrayLike | None = None,
        R: npt.ArrayLike | None = None,
        normal_limits: npt.ArrayLike | None = None,
    ) -> ForceProblem:
        """Return the problem with new values; None keeps a value.

        Args:
            w: (6,) wrench, in O, N and N·m.
            J: (k, n) hand Jacobian, m/rad.
            tau_u: (n,) motor torques without contact, N·m.
            mu: (N,) friction coefficients, or (2, N) with the torsional friction lengths in the second row, m.
            p: (N, 3) contact positions in O, m.
            R: (N, 3, 3) contact frames in O.
            normal_limits: (2, N) smallest and largest normal forces, N; inf for no upper limit.

        Raises:
            InvalidInput: a wrong shape, numbers that are not finite, a negative friction coefficient, no rotation, or a
                smallest normal force that is negative or greater than the largest.
        """
        if all(value is None for value in (w, J, tau_u, mu, p, R, normal_limits)):
            return self
        actuation = self.actuation
        if J is not None or tau_u is not None:
            if actuation is None:
                raise InvalidInput("hand", None, "given before its jacobian or bias_torque can change")
            try:
                actuation = actuation.replace(J=J, tau_u=tau_u)
            except InvalidInput as error:
                raise error.with_prefix("hand") from None
        if not all(value is None for value in (mu, p, R, normal_limits)):
            contacts = with_contact_values(self.contacts, mu, p, R, normal_limits)
            w = self.w if w is None else w
            return ForceProblem(contacts, w, actuation, self.cone, self.objective, self.name, self.source, self.uncertainty)
        if w is None:
            return copy_unchecked(self, actuation=actuation)
        problem = copy_unchecked(self, w=arrays.check_array(w, "wrench", (6,)), actuation=actuation)  # keeps the cached G
        vars(problem).pop("w_centred", None)
        return problem

    @classmethod
    def from_dict(cls, record: object) -> ForceProblem:
        """Return the problem of a record of a problem file (`SCHEMA`). The field ``expected`` is not read.

        Args:
            record: the record.

        Raises:
            InvalidInput: a field is missing, unknown or has a value that is not allowed; names its path.
        """
        required = ["schema", "contacts", "wrench"]
        optional = ["name", "source", "hand", "cone", "objective", "uncertainty", "expected"]
        values = fields.check_record(record, "", required=required, optional=optional)
        fields.check_choice(values["schema"], "schema", (SCHEMA,))
        items = fields.check_sequence(values["contacts"], "contacts", at_least=1)
        return cls(
            [Contact.from_dict(item, f"contacts[{i}]") for i, item in enumerate(items)],
            values["wrench"],
            actuation=None if values.get("hand") is None else Actuation.from_dict(values["hand"]),
            cone=None if values.get("cone") is None else Cone.from_dict(values["cone"]),
            objective=None if values.get("objective") is None else Objective.from_dict(values["objective"]),
            name=values.get("name", ""),
            source=values.get("source", ""),
            uncertainty=None if values.get("uncertainty") is None else Uncertainty.from_dict(values["uncertainty"]),
        )

    def to_dict(self) -> JsonRecord:
        """Return the record of a problem file."""
        record: JsonRecord = {"schema": SCHEMA}
        if self.name:
            record["name"] = self.name
        if self.source:
            record["source"] = self.source
        record["contacts"] = [contact.to_dict() for contact in self.contacts.contacts]
        record["wrench"] = self.w.tolist()
        if self.actuation is not None:
            record["hand"] = self.actuation.to_dict()
        record["cone"] = self.cone.to_dict()
        record["objective"] = self.objective.to_dict()
        if self.uncertainty is not None:
            record["uncertainty"] = self.uncertainty.to_dict()
        return record


def _vector(x: Array) -> str:
    """Return the text of a vector with four digits."""
    return f"({', '.join(f'{value:.4g}' for value in x)})"


def _check_contacts_are_close(contacts: ContactSet) -> None:
    """Raise an error for a contact so far from most others that the tolerance of its moments hides those of the others."""
    p, steps = contacts.p_OC, []
    positions = p.tolist()  # for a few contacts, floats are faster than arrays
    x0, y0, z0 = positions[-1]
    for x, y, z in positions:
        steps.append(abs(x - x0) + abs(y - y0) + abs(z - z0))  # m
        x0, y0, z0 = x, y, z
    if max(steps) / _MOST_DISTANT <= min(steps):  # the usual case, without a median
        return
    from_median = np.abs(p - np.median(p, axis=0)).max(axis=1)  # m
    typical, farthest = float(np.median(from_median)), int(from_median.argmax())
    if typical > 0.0 and from_median[farthest] / _MOST_DISTANT > typical:
        allowed = f"at most {_MOST_DISTANT:.0e} times as far from the others as they are from each other"
        raise InvalidInput(f"contacts[{farthest}].position", contacts.p_OC[farthest], allowed)


def _check_margin_is_bounded(contacts: ContactSet, actuation: Actuation | None) -> None:
    """Raise an error unless a contact has friction and a limit bounds the forces: s would be unbounded."""
    if not (contacts.mu > 0).any():
        raise InvalidInput("objective.type", "margin", "another objective: no contact has friction")
    bounded_normal = bool(np.isfinite(contacts.max_normal[contacts.mu > 0]).any())
    bounded_torque = actuation is not None and bool((np.isfinite(actuation.lower) | np.isfinite(actuation.upper)).any())
    if not (bounded_normal or bounded_torque):
        raise InvalidInput("objective.type", "margin", "another objective, unless max_normal or torque limits bound the forces")


def _check_uncertainty(problem: ForceProblem, uncertainty: Uncertainty) -> None:
    """Raise an error unless errors fit the contacts, motors and objective of a problem."""
    if problem.objective.type == "margin":
        raise InvalidInput("objective.type", "margin", "another objective with an uncertainty, whose slip_margin is given")
    if problem.cone.type == "pyramid" and problem.cone.side == "outer":
        raise InvalidInput("cone.side", "outer", "inner with an uncertainty: outer pyramids allow slip")
    try:
        uncertainty.check(problem.contacts, 0 if problem.actuation is None else len(problem.actuation.tau_u))
    except InvalidInput as error:
        raise error.with_prefix("uncertainty") from None
