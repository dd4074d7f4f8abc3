"""Compiled equations: equal values, and caching."""

from __future__ import annotations

import numpy as np
import pytest
from support.hands import load

from graspforce.planning.free.object_equations import finger_equations, object_equations
from graspforce.planning.nlp.machine_code import cache_folder, compile_equations


def test_compiled_equations_have_equal_values(tmp_path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    compile_equations.cache_clear()
    e = object_equations((False, True))
    machine = compile_equations(e)
    rng = np.random.default_rng(0)
    x, p, lam = rng.normal(size=e.variable_count), rng.normal(size=e.parameter_count), rng.normal(size=e.row_count)
    for compiled, symbolic in ((machine.value, e.value), (machine.jacobian_values, e.jacobian_values)):
        assert np.array(compiled(x, p)) == pytest.approx(np.array(symbolic(x, p)), rel=1e-12, abs=1e-12)
    for compiled, symbolic in zip(machine.lagrangian_derivatives(x, p, lam), e.lagrangian_derivatives(x, p, lam), strict=True):
        assert np.array(compiled) == pytest.approx(np.array(symbolic), rel=1e-12, abs=1e-12)
    if machine is not e:
        assert len(list(cache_folder().glob("*.so"))) == 1
    monkeypatch.setenv("CC", "no-such-compiler")
    compile_equations.cache_clear()
    assert compile_equations(e) is e
    compile_equations.cache_clear()


def test_equations_of_a_finger_are_cached() -> None:
    hand = load("dlr_hit2")
    assert finger_equations(hand, "index", ()) is finger_equations(hand, "index", ())
