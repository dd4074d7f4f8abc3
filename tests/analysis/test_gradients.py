"""`gf.torch` and `gf.jax`: gradients equal central differences in every block of data, and the adjoint products."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from support.random_problems import inner_forces, random_actuation, random_contacts

import graspforce as gf
from graspforce.analysis.gradients import OptimumBatch, data_gradient, round_frames, solve_with_data
from graspforce.contact.matrices import grasp_matrix
from graspforce.force.problem_data import change_problem, data_shapes

STEP = 1e-5  # of central differences, relative to the data


def regular_problem(kind: str = "torque") -> gf.ForceProblem:
    """Return a problem with a hand, an active torque limit, soft and point contacts, and a regular optimum."""
    for seed in range(100):
        rng = np.random.default_rng([7, seed])
        contacts = gf.ContactSet.stack(random_contacts(rng, 4, ("point", "soft")))
        f = inner_forces(rng, contacts, share=0.9)
        objective = gf.Objective("torque", force_weight=1e-3) if kind == "torque" else gf.Objective("force", moment_length=0.02)
        actuation = random_actuation(rng, contacts, f)
        problem = gf.ForceProblem(contacts, grasp_matrix(contacts) @ f, actuation, objective=objective)
        solution = gf.solve(problem, explain=False)
        if not solution.found:
            continue
        answer = gf.sensitivities(solution)
        if not answer.degenerate and {"torque", "cone"} <= {limit.kind for limit in answer.optimum.active}:
            return problem
    raise AssertionError("no regular problem")


def data_of(problem: gf.ForceProblem) -> dict[str, np.ndarray]:
    """Return all data of a problem with a hand by name."""
    c, a = problem.contacts, problem.actuation
    return {
        "w": problem.w, "mu": c.mu, "p": c.p_OC, "R": c.R_OC,
        "tau_u": a.tau_u, "torque_lower": a.lower, "torque_upper": a.upper, "J": a.J,
    }  # fmt: skip


def weights(problem: gf.ForceProblem) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the weights of a linear function of f, tau and the objective."""
    rng = np.random.default_rng(3)
    return rng.normal(size=problem.size), 10.0 * rng.normal(size=len(problem.actuation.tau_u)), 20.0


def loss(problem: gf.ForceProblem, data: dict[str, np.ndarray]) -> float:
    """Return the weighted sum of the optimum's forces, torques and objective."""
    optimum = solve_with_data(problem, data).optimum
    f_bar, tau_bar, objective_bar = weights(problem)
    changed = optimum.problem
    return f_bar @ optimum.f + tau_bar @ changed.torques(optimum.f) + objective_bar * changed.cost(optimum.f)


def direction(name: str, value: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a random direction of a block of data, zero where it is infinite, and a rotation's velocity for frames."""
    if name == "R":
        return np.cross(rng.normal(size=(len(value), 3))[:, :, None], value, axis=1)
    finite = np.isfinite(value)
    size = np.abs(value[finite]).mean() + 1e-3
    return np.where(finite, size * rng.normal(size=value.shape), 0.0)


@pytest.mark.parametrize("kind", ["torque", "force"])
def test_the_gradient_of_every_block_equals_central_differences(kind):
    """The nearest rotation to R + h φ × R is exp(h φ) R up to h³, so that frames can be moved by addition."""
    problem = regular_problem(kind)
    assert set(data_shapes(problem)) == set(data_of(problem))
    gradient = data_gradient(solve_with_data(problem, {}), *weights(problem))
    rng = np.random.default_rng(5)
    for name, value in data_of(problem).items():
        along = direction(name, value, rng)
        ends = [loss(problem, {name: value + sign * STEP * along}) for sign in (1.0, -1.0)]
        expected = (ends[0] - ends[1]) / (2.0 * STEP)
        scale = np.abs(gradient[name] * along).sum() + 1e-3
        rounding = 1e-14 * max(map(abs, ends)) / STEP  # of the difference: a few units in the last place of the optimum
        assert np.sum(gradient[name] * along) == pytest.approx(expected, abs=1e-6 * scale + rounding), name


def test_data_that_a_problem_does_not_have_are_refused():
    problem = regular_problem()
    contacts = gf.ForceProblem(problem.contacts, problem.w)
    with pytest.raises(gf.InvalidInput, match="no hand"):
        change_problem(contacts, {"tau_u": np.zeros(3)})
    with pytest.raises(gf.InvalidInput, match="did you mean 'mu'"):
        change_problem(problem, {"mus": np.zeros(4)})
    with pytest.raises(gf.InvalidInput, match=r"R\[1\]"):
        round_frames(problem, {"R": problem.contacts.R_OC * np.array([1.0, 1.1, 1.0, 1.0])[:, None, None]})
    with pytest.raises(gf.InvalidInput, match="degenerate"):
        solve_with_data(problem, {}, "guess")
    single = change_problem(problem, round_frames(problem, {"R": problem.contacts.R_OC.astype(np.float32)}))
    np.testing.assert_allclose(single.contacts.R_OC, problem.contacts.R_OC, atol=1e-6)


def unloaded() -> gf.ForceProblem:
    """Return a grasp without load, whose forces are at the apexes of all cones."""
    angles = 2 * np.pi * np.arange(3) / 3
    contacts = [gf.Contact((0.05 * np.cos(a), 0.05 * np.sin(a), 0), (-np.cos(a), -np.sin(a), 0), 0.5) for a in angles]
    return gf.ForceProblem(contacts, np.zeros(6))


def test_products_at_degenerate_optima_need_permission():
    with pytest.raises(gf.InvalidInput, match="derivatives do not exist"):
        solve_with_data(unloaded(), {})
    allowed = solve_with_data(unloaded(), {}, "least_squares")
    assert allowed.degenerate
    gradient = data_gradient(allowed, np.ones(9), np.zeros(0), 1.0)
    assert all(np.isfinite(values).all() for values in gradient.values())
    pulled = gf.ForceProblem([gf.Contact((0, 0, 0), (0, 0, 1), 0.5)], (0, 0, -1.0, 0, 0, 0))
    with pytest.raises(gf.InvalidInput, match="no gradient without forces"):
        solve_with_data(pulled, {})


@pytest.fixture
def torch():
    return pytest.importorskip("torch")


@pytest.fixture
def jax():
    jax = pytest.importorskip("jax")
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    yield jax
    jax.config.update("jax_enable_x64", before)


def test_backward_in_torch_gives_the_adjoint_product(torch):
    problem = regular_problem()
    f_bar, tau_bar, objective_bar = weights(problem)
    tensors = {name: torch.tensor(value, requires_grad=True) for name, value in data_of(problem).items()}
    forces = gf.torch.solve(problem, **tensors)
    assert not forces.degenerate
    total = torch.tensor(f_bar) @ forces.f + torch.tensor(tau_bar) @ forces.tau + objective_bar * forces.objective
    total.backward()
    gradient = data_gradient(solve_with_data(problem, data_of(problem)), f_bar, tau_bar, objective_bar)
    for name, tensor in tensors.items():
        np.testing.assert_allclose(tensor.grad.numpy(), gradient[name], rtol=1e-9, atol=1e-9 * np.abs(gradient[name]).max())


def batch_data(problem: gf.ForceProblem) -> dict[str, np.ndarray]:
    """Return data of three problems: loads and positions differ, friction and frames are common."""
    rng, data = np.random.default_rng(11), data_of(problem)
    w = problem.w * (1.0 + 1e-4 * rng.random((3, 6)))
    return {"w": w, "p": data["p"] + 1e-6 * rng.normal(size=(3, 4, 3)), "mu": data["mu"], "R": data["R"]}


def test_a_batch_has_the_gradients_of_its_problems():
    problem = regular_problem()
    f_bar, tau_bar, objective_bar = weights(problem)
    data = batch_data(problem)
    batch = OptimumBatch(problem, data)
    assert batch.degenerate == ()
    seeds = (np.tile(f_bar, (3, 1)), np.tile(tau_bar, (3, 1)), np.full(3, objective_bar))
    gradient = batch.gradient(*seeds)
    for i in range(3):
        own = {name: value[i] if name in ("w", "p") else value for name, value in data.items()}
        answer = solve_with_data(problem, own)
        best = answer.optimum.problem.cost(answer.optimum.f)
        assert batch.solutions.objective[i] == pytest.approx(best, rel=2e-8)  # certified to 1e-8
        for name, exact in data_gradient(answer, f_bar, tau_bar, objective_bar).items():
            np.testing.assert_allclose(gradient[name][i], exact, atol=1e-10 * np.abs(exact).max())


def test_degenerate_problems_of_a_batch_need_permission():
    problem = unloaded()
    w = np.zeros((2, 6))
    w[0, 2] = 1.0
    with pytest.raises(gf.InvalidInput, match="problem 1"):
        OptimumBatch(problem, {"w": w})
    allowed = OptimumBatch(problem, {"w": w}, "least_squares")
    assert len(allowed.degenerate) == 1
    assert allowed.degenerate[0].startswith("problem 1: the friction cone of contact 0")
    gradient = allowed.gradient(np.ones((2, 9)), np.zeros((2, 0)), np.ones(2))
    alone = data_gradient(solve_with_data(problem, {}, "least_squares"), np.ones(9), np.zeros(0), 1.0)
    np.testing.assert_allclose(gradient["w"][1], alone["w"])
    assert np.isfinite(gradient["p"][0]).all()
    pulled = gf.ForceProblem([gf.Contact((0, 0, 0), (0, 0, 1), 0.5)], (0, 0, 1.0, 0, 0, 0))
    with pytest.raises(gf.InvalidInput, match="no gradient without forces"):
        OptimumBatch(pulled, {"w": [[0, 0, 1.0, 0, 0, 0], [0, 0, -1.0, 0, 0, 0]]})


def test_torch_solves_batches(torch):
    """Data without a batch axis get the sum of the gradients of all problems."""
    problem, data = regular_problem(), batch_data(regular_problem())
    tensors = {name: torch.tensor(value, requires_grad=True) for name, value in data.items()}
    forces = gf.torch.solve(problem, **tensors)
    assert forces.f.shape == (3, problem.size)
    assert forces.objective.shape == (3,)
    forces.objective.sum().backward()
    n = len(problem.actuation.tau_u)
    gradient = OptimumBatch(problem, data).gradient(np.zeros((3, problem.size)), np.zeros((3, n)), np.ones(3))
    for name, tensor in tensors.items():
        exact = gradient[name] if name in ("w", "p") else gradient[name].sum(axis=0)
        np.testing.assert_allclose(tensor.grad.numpy(), exact, atol=1e-12 * np.abs(exact).max())
    normals = torch.tensor(np.stack([problem.contacts.R_OC[:, :, 2]] * 2))
    np.testing.assert_allclose(gf.torch.contact_frames(normals)[1], gf.torch.contact_frames(normals[0]), atol=0.0)


def test_jax_maps_over_several_axes_at_once(jax):
    problem, jnp = regular_problem(), jax.numpy
    data = batch_data(problem)
    loads, places = jnp.array(data["w"]), jnp.array(data["p"])
    slope = jax.grad(lambda w, p: gf.jax.solve(problem, w=w, p=p).objective, argnums=1)
    both = jax.vmap(jax.vmap(slope, (0, None)), (None, 0))(loads, places)
    assert both.shape == (3, 3, 4, 3)
    np.testing.assert_allclose(both[2, 1], slope(loads[1], places[2]), rtol=1e-9, atol=1e-10)


def test_torch_checks_the_gradients_of_all_outputs(torch):
    """`gradcheck` compares each entry of the Jacobian, of positions and normals too, with central differences."""
    problem = regular_problem()
    normals = problem.contacts.R_OC[:, :, 2]
    inputs = [torch.tensor(np.array(value), requires_grad=True) for value in (problem.contacts.p_OC, normals, problem.w)]

    def outputs(p, normals, w):
        answer = gf.torch.solve(problem_in_default_frames, p=p, normals=normals, w=w)
        return answer.f, answer.tau, answer.objective

    frames = gf.torch.contact_frames(inputs[1]).detach().numpy()
    problem_in_default_frames = in_frames(problem, frames)
    assert torch.autograd.gradcheck(outputs, inputs, eps=1e-7, atol=2e-5, rtol=1e-5)


def in_frames(problem: gf.ForceProblem, frames: np.ndarray) -> gf.ForceProblem:
    """Return the same problem with tangents turned about the normals: the rows of J turn with them."""
    from scipy.linalg import block_diag

    parts = []
    for model, old, new in zip(problem.contacts.models, problem.contacts.R_OC, frames, strict=True):
        parts.append(new.T @ old)
        if model is gf.ContactModel.SOFT:
            parts.append(np.eye(1))
    return problem.replace(R=frames, J=block_diag(*parts) @ problem.actuation.J)


def test_contact_frames_are_those_of_contacts(torch, jax):
    normals = np.array([[0.0, 0.0, 2.0], [1.0, 0.1, 0.0], [-0.3, 0.5, 0.1], [0.95, 0.0, -0.1]])
    expected = gf.ContactSet.stack([gf.Contact((0, 0, 0), n, 0.5) for n in normals]).R_OC
    np.testing.assert_allclose(gf.torch.contact_frames(torch.tensor(normals)).numpy(), expected, atol=1e-15)
    np.testing.assert_allclose(gf.jax.contact_frames(jax.numpy.array(normals)), expected, atol=1e-15)


def test_torch_keeps_the_type_of_the_data(torch):
    problem = regular_problem()
    w = torch.tensor(problem.w, dtype=torch.float32, requires_grad=True)
    answer = gf.torch.solve(problem, w=w)
    answer.objective.backward()
    assert answer.f.dtype == w.grad.dtype == torch.float32
    exact = gf.sensitivities(gf.solve(problem)).objective["w"]
    np.testing.assert_allclose(w.grad.numpy(), exact, rtol=1e-3, atol=1e-3 * np.abs(exact).max())


def test_torch_raises_the_errors_of_sensitivities(torch):
    with pytest.raises(gf.InvalidInput, match="derivatives do not exist"):
        gf.torch.solve(unloaded())
    assert gf.torch.solve(unloaded(), degenerate="least_squares").degenerate
    with pytest.raises(gf.InvalidInput, match="absent with R"):
        gf.torch.solve(unloaded(), normals=torch.zeros(3, 3), R=torch.zeros(3, 3, 3))


def test_jax_gradients_equal_the_adjoint_product_also_compiled_and_mapped(jax):
    problem, jnp = regular_problem(), jax.numpy
    f_bar, tau_bar, objective_bar = weights(problem)

    def total(data):
        forces = gf.jax.solve(problem, **data)
        return jnp.array(f_bar) @ forces.f + jnp.array(tau_bar) @ forces.tau + objective_bar * forces.objective

    data = {name: jnp.array(value) for name, value in data_of(problem).items()}
    expected = data_gradient(solve_with_data(problem, data_of(problem)), f_bar, tau_bar, objective_bar)
    for gradient in (jax.grad(total)(data), jax.jit(jax.grad(total))(data)):
        for name, value in gradient.items():
            np.testing.assert_allclose(value, expected[name], rtol=1e-9, atol=1e-9 * np.abs(expected[name]).max())
    loads = jnp.stack([data["w"], 0.999 * data["w"]])
    each = jax.vmap(jax.grad(lambda w: gf.jax.solve(problem, w=w).objective))(loads)
    one = jax.grad(lambda w: gf.jax.solve(problem, w=w).objective)(loads[1])
    np.testing.assert_allclose(each[1], one, rtol=1e-12)


def test_jax_raises_errors_with_the_text_of_the_solver(jax):
    with pytest.raises(Exception, match="derivatives do not exist"):
        gf.jax.solve(unloaded(), w=jax.numpy.zeros(6)).f.block_until_ready()


@pytest.mark.parametrize("name", ["torch", "jax"])
def test_a_missing_library_is_named_with_its_extra(name, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, name, None)  # importing it raises ImportError
    monkeypatch.delitem(sys.modules, f"graspforce.analysis.{name}_adapter", raising=False)
    with pytest.raises(gf.GraspForceError, match=rf"graspforce\[{name}\]"):
        importlib.import_module(f"graspforce.analysis.{name}_adapter")
