"""Contacts: frames, defaults, records, errors, and the wrenches of unit forces."""

import json
import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.contact_strategies import contacts_around_object, seeds

from graspforce import Contact, ContactModel, ContactSet, InvalidInput

component = st.one_of(st.just(0.0), st.floats(-1.0, 1.0), st.floats(1e-300, 1e-290), st.floats(1e290, 1e300))
vectors = st.tuples(component, component, component).filter(any)
EPS = np.finfo(float).eps


def sine_between(a, b):
    a, b = (np.array(v) / np.abs(v).max() for v in (a, b))
    return np.linalg.norm(np.cross(a, b)) / np.linalg.norm(a) / np.linalg.norm(b)


@given(vectors, st.none() | vectors)
@settings(max_examples=200, deadline=None)
def test_the_contact_frame_is_right_handed_with_its_third_axis_along_the_normal(normal, tangent):
    if tangent is not None and sine_between(normal, tangent) < 1.01e-6:
        return  # too close to the normal: rejected, see below
    contact = Contact([0, 0, 0], normal, 0.5, tangent=tangent)
    R = contact.R_OC
    assert np.abs(R.T @ R - np.eye(3)).max() <= 8 * EPS
    assert np.linalg.det(R) == pytest.approx(1.0, abs=8 * EPS)
    largest = np.abs(normal).max()
    direction = np.array(normal) / largest
    assert R[:, 2] @ direction == pytest.approx(np.linalg.norm(direction), rel=8 * EPS)
    if tangent is not None:
        assert R[:, 0] @ (np.array(tangent) / np.abs(tangent).max()) > 0.0  # on the side of the given tangent


@pytest.mark.parametrize("size", [1e-300, 5e-324, 1e-160, 1.0, 1e200, 1e300])
def test_a_normal_of_any_length_is_normalised(size):
    contact = Contact([0, 0, 0], [0.0, size, -size], 0.5)
    assert contact.normal == pytest.approx([0.0, math.sqrt(0.5), -math.sqrt(0.5)], abs=2 * EPS)


def test_the_default_tangent_is_n_cross_x_or_n_cross_y_for_n_close_to_x():
    n = np.array([0.6, 0.0, 0.8])
    assert Contact([0, 0, 0], n, 0.5).tangent == pytest.approx([0.0, 1.0, 0.0], abs=EPS)
    assert Contact([0, 0, 0], [0, 0, 1], 0.5).tangent == pytest.approx([0.0, 1.0, 0.0], abs=EPS)
    assert Contact([0, 0, 0], [1, 0, 0], 0.5).tangent == pytest.approx([0.0, 0.0, 1.0], abs=EPS)
    across = math.sqrt(1.0 - 0.9**2)
    below, above = Contact([0, 0, 0], [0.8999, 0, across], 0.5), Contact([0, 0, 0], [0.9001, 0, across], 0.5)
    assert below.tangent == pytest.approx([0.0, 1.0, 0.0], abs=EPS)
    assert above.tangent[1] == pytest.approx(0.0, abs=EPS)


@pytest.mark.parametrize("angle", [2e-6, 1e-4, 1.0])
def test_a_tangent_close_to_the_normal_gives_an_orthogonal_frame(angle):
    contact = Contact([0, 0, 0], [1, 2, 3], 0.5, tangent=np.array([1, 2, 3]) + angle * np.array([5.0, 0.0, -2.0]))
    assert np.abs(contact.R_OC.T @ contact.R_OC - np.eye(3)).max() <= 4 * EPS


def assert_same(a, b):
    assert (a.model, a.min_normal, a.max_normal) == (b.model, b.min_normal, b.max_normal)
    assert (a.friction, a.torsional_friction) == (b.friction, b.torsional_friction)
    assert np.array_equal(a.position, b.position)
    assert np.abs(b.R_OC - a.R_OC).max() <= 4 * EPS  # normalised again


@pytest.mark.parametrize(
    "contact",
    [
        Contact([0.1, -0.2, 0.3], [1, 2, -3], 0.5),
        Contact([0.1, -0.2, 0.3], [1, 2, -3], 0.0, "soft", [1, 1, 1], 0.003, min_normal=0.25, max_normal=20),
        Contact([0, 0, 0], [0, 0, 1], model=ContactModel.FRICTIONLESS, max_normal=0.0),
    ],
)
def test_a_contact_survives_json_and_stacking(contact):
    record = json.loads(json.dumps(contact.to_dict(), allow_nan=False))
    assert_same(contact, Contact.from_dict(record))
    assert_same(contact, ContactSet.stack([contact]).contacts[0])


def test_contacts_are_immutable():
    contact = Contact([0, 0, 0], [0, 0, 1], 0.5)
    with pytest.raises(AttributeError):
        contact.friction = 0.1
    contacts = ContactSet.stack([contact, contact])
    names = ("p_OC", "R_OC", "mu", "gamma", "min_normal", "max_normal", "columns", "normal_rows")
    assert not any(getattr(contacts, name).flags.writeable for name in names)
    assert not any(getattr(contact, name).flags.writeable for name in ("position", "normal", "tangent"))
    assert not any(part.flags.writeable for part in contacts.split(np.arange(6.0)))


VALID_CONTACT = {"position": [0, 0, 0], "normal": [0, 0, 1], "friction": 0.5}


@pytest.mark.parametrize(
    ("change", "field", "allowed"),
    [
        ({"position": [0, 0]}, "position", "a list of 3 numbers"),
        ({"position": [0, math.nan, 0]}, "position[1]", "a finite number"),
        ({"position": "here"}, "position", "a list of 3 numbers"),
        ({"normal": [0, 0, 0]}, "normal", "not zero"),
        ({"normal": [0, math.inf, 0]}, "normal[1]", "a finite number"),
        ({"normal": [[0, 0, 1]]}, "normal", "a list of 3 numbers"),
        ({"normal": [False, False, True]}, "normal", "a list of 3 numbers"),
        ({"tangent": [0, 0, -2]}, "tangent", "not parallel"),
        ({"tangent": [1e-7, 0, 1]}, "tangent", "not parallel"),
        ({"tangent": [0, 0, 0]}, "tangent", "not zero"),
        ({"friction": -0.1}, "friction", "at least 0"),
        ({"friction": math.nan}, "friction", "at least 0"),
        ({"friction": None}, "friction", "at least 0"),
        ({"friction": "rough"}, "friction", "at least 0"),
        ({"model": "hard"}, "model", "one of frictionless, point, soft"),
        ({"model": "soft"}, "torsional_friction", "at least 0"),
        ({"model": "soft", "torsional_friction": -1e-3}, "torsional_friction", "at least 0"),
        ({"torsional_friction": math.inf}, "torsional_friction", "a finite number"),
        ({"min_normal": -1.0}, "min_normal", "at least 0"),
        ({"min_normal": 2.0, "max_normal": 1.0}, "min_normal", "at most max_normal, which is 1"),
        ({"max_normal": -1.0}, "max_normal", "at least 0"),
        ({"max_normal": math.nan}, "max_normal", "a finite number"),
        ({"mu": 0.3}, "mu", "absent: the known fields are position, normal, model"),
    ],
)
def test_the_error_names_the_invalid_field(change, field, allowed):
    with pytest.raises(InvalidInput) as caught:
        Contact.from_dict(VALID_CONTACT | change, "contacts[2]")
    assert caught.value.field == f"contacts[2].{field}"
    assert allowed in caught.value.allowed
    assert re.match(rf"(contacts\[2\]\.{re.escape(field)} = |Unknown field 'contacts\[2\]\.{field}'; )", str(caught.value))


@pytest.mark.parametrize("missing", ["position", "normal", "friction"])
def test_the_error_names_a_missing_field(missing):
    with pytest.raises(InvalidInput) as caught:
        Contact.from_dict({name: value for name, value in VALID_CONTACT.items() if name != missing}, "contacts[0]")
    assert caught.value.field == f"contacts[0].{missing}"


def test_contacts_print_as_a_table():
    soft = Contact([0, 0.03, -0.01], [0, -1, 0], 0.5, "soft", torsional_friction=0.004, max_normal=20)
    contacts = ContactSet.stack([soft, Contact([0, 0, 0], [0, 0, 1], model="frictionless")])
    header, first, second = str(contacts).splitlines()
    assert header.split() == [
        "contact",
        "x",
        "mm",
        "y",
        "mm",
        "z",
        "mm",
        "n",
        "x",
        "n",
        "y",
        "n",
        "z",
        "model",
        "μ",
        "γ",
        "mm",
        "min",
        "N",
        "max",
        "N",
    ]
    assert first.split() == ["0", "0.00", "30.00", "-10.00", "0.000", "-1.000", "0.000", "soft", "0.5", "4", "0", "20"]
    assert second.split()[-4:] == ["0", "0", "0", "inf"]
    assert contacts._repr_html_().count("<tr>") == 3


def test_a_contact_set_needs_a_contact():
    with pytest.raises(InvalidInput, match=r"contacts = .*a list of at least 1"):
        ContactSet.stack([])


def test_coefficients_that_the_model_lacks_are_zero():
    contacts = ContactSet.stack(
        [
            Contact([0, 0, 0], [0, 0, 1], 0.4, "frictionless", torsional_friction=0.1),
            Contact([0, 0, 0], [0, 0, 1], 0.5, "point", torsional_friction=0.2),
            Contact([0, 0, 0], [0, 0, 1], 0.6, "soft", torsional_friction=0.3, max_normal=7.0),
        ]
    )
    assert contacts.mu.tolist() == [0.0, 0.5, 0.6]
    assert contacts.gamma.tolist() == [0.0, 0.0, 0.3]
    assert contacts.max_normal.tolist() == [math.inf, math.inf, 7.0]
    assert contacts.size == 8
    assert contacts.columns.tolist() == [2, 4, 5, 6, 8, 9, 10, 11]
    assert contacts.normal_rows.tolist() == [0, 3, 6]


@given(seeds, st.integers(1, 6))
@settings(max_examples=40, deadline=None)
def test_pad_and_split_keep_the_order_of_components(seed, count):
    rng = np.random.default_rng(seed)
    contacts = contacts_around_object(rng, count)
    f = rng.normal(size=contacts.size)
    padded = contacts.pad(f)
    assert padded.ravel()[contacts.columns] == pytest.approx(f, abs=0.0)
    assert np.count_nonzero(padded) == contacts.size
    for model, row, part in zip(contacts.models, padded, contacts.split(f), strict=True):
        assert row[list(model.columns)] == pytest.approx(part, abs=0.0)
    assert f[contacts.normal_rows] == pytest.approx(padded[:, 2], abs=0.0)


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_the_power_of_a_wrench_basis_is_the_power_at_the_contact(seed):
    """Virtual work: for a twist (v, ω) the contact point moves at v + ω × p, and the power of f there is that of its wrench."""
    rng = np.random.default_rng(seed)
    contacts = contacts_around_object(rng, 3)
    v, omega, f = rng.normal(size=3), rng.normal(size=3), rng.normal(size=(3, 4))
    wrench = np.einsum("nij,nj->i", contacts.wrench_bases(), f)
    power = 0.0
    for contact, force in zip(contacts.contacts, f, strict=True):
        power += force[:3] @ contact.R_OC.T @ (v + np.cross(omega, contact.position)) + force[3] * (contact.normal @ omega)
    assert wrench @ np.concatenate([v, omega]) == pytest.approx(power, abs=1e-13)


@given(seeds, st.integers(1, 5))
def test_pad_applies_to_each_of_many_forces(seed, count):
    rng = np.random.default_rng(seed)
    contacts = contacts_around_object(rng, count)
    f = rng.normal(size=(2, 3, contacts.size))
    padded = contacts.pad(f)
    assert padded.shape == (2, 3, count, 4)
    for i in range(2):
        for j in range(3):
            np.testing.assert_array_equal(padded[i, j], contacts.pad(f[i, j]))
    assert contacts.pad(np.zeros((0, contacts.size))).shape == (0, count, 4)
