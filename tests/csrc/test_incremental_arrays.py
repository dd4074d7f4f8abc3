"""The type IncrementalKernel: arguments that it accepts, its results, and threads."""

from __future__ import annotations

import pickle
import threading

import numpy as np
import pytest
from support.incremental_cases import feasible_problem
from support.random_problems import inner_forces, random_actuation, random_contacts

from graspforce import ContactSet, ForceProblem, Solver, Status
from graspforce.contact.matrices import grasp_matrix
from graspforce.core.errors import BackendError
from graspforce.force.backends import compiled_kernel

if not compiled_kernel.is_available():
    pytest.skip("the kernel was not built: no C compiler at installation", allow_module_level=True)

NO_CHANGE: list[None] = []  # arrays that are omitted stay


def test_result_of_a_step_has_named_fields():
    """The layout names the parts of `numbers`, one after the other without gaps."""
    problem = feasible_problem(np.random.default_rng(64))
    kernel = compiled_kernel.IncrementalKernel(48, problem.contacts.columns, None, 0, *compiled_kernel.kernel_inputs(problem))
    result = kernel.step(1e-9, 60, False, *NO_CHANGE)
    k, N, n = problem.size, len(problem.contacts), problem.actuation.J.shape[1]
    sizes = {"f": k, "y": 6, "z": k, "nu_lower": N, "nu_upper": N, "lambda_lower": n, "lambda_upper": n, "level": N, "tau": n}
    ends = np.cumsum(list(sizes.values())).tolist()
    layout = kernel.solution_layout()
    assert layout == dict(zip(sizes, zip([0, *ends[:-1]], ends, strict=True), strict=True))
    assert (result.status, result.changed) == (0, 0)
    assert len(result.numbers) == 8 * ends[-1]
    f, tau = (np.frombuffer(result.numbers)[slice(*layout[name])] for name in ("f", "tau"))
    assert tau == pytest.approx(problem.torques(f), rel=1e-12)
    assert max(result.residuals.primal, result.residuals.dual, result.residuals.gap) <= 1e-8
    assert pickle.loads(pickle.dumps(result)) == result


def test_two_threads_get_certified_solutions_or_an_error():
    """A call during another thread's call raises; it never returns an uncertified solution."""
    rng = np.random.default_rng(17)
    contacts = ContactSet.stack(random_contacts(rng, 60, ("point",)))
    f = inner_forces(rng, contacts, share=0.6)
    problem = ForceProblem(contacts, grasp_matrix(contacts) @ f, random_actuation(rng, contacts, f))
    solver = Solver(problem, explain=False)
    assert solver.solve().found
    begin, messages, statuses = threading.Barrier(2), [], []

    def call() -> None:
        begin.wait()
        for _ in range(200):
            try:
                statuses.append(solver.solve(w=problem.w).status)
            except BackendError as error:
                messages.append(str(error))

    threads = [threading.Thread(target=call) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(messages) + len(statuses) == 400  # no other exception was raised
    assert set(statuses) == {Status.OPTIMAL}
    assert all("each thread needs a Solver of its own" in message for message in messages)


def test_invalid_problem_leaves_the_kernel_without_a_problem():
    """After a rejected problem, a step raises until a valid problem is loaded."""
    problem = feasible_problem(np.random.default_rng(62))
    inputs, columns = compiled_kernel.kernel_inputs(problem), problem.contacts.columns
    kernel = compiled_kernel.IncrementalKernel(48, columns, None, 0, *inputs)
    expected = kernel.step(1e-9, 60, False, *NO_CHANGE)
    bad = {"w must hold 6": {0: np.zeros(5)}, "J must hold": {1: np.zeros((2, 2))}, "p must hold": {3: np.zeros((1, 3))}}
    bad |= {"finite G": {3: 1.5e308 * np.sign(inputs[3])}, "mu must hold": {5: inputs[5].astype(np.float32)}}
    for message, changes in bad.items():
        wrong = [changes.get(i, array) for i, array in enumerate(inputs)]
        with pytest.raises(ValueError, match=message):
            kernel.load(*wrong)
        with pytest.raises(RuntimeError, match="no problem is loaded"):
            kernel.step(1e-9, 60, False, *NO_CHANGE)
        assert kernel.load(*inputs)
        assert kernel.step(1e-9, 60, False, *NO_CHANGE) == expected
        with pytest.raises(ValueError, match="must"):
            compiled_kernel.IncrementalKernel(48, columns, None, 0, *wrong)


def test_kernel_rejects_invalid_arguments():
    problem = feasible_problem(np.random.default_rng(62))
    inputs, columns = compiled_kernel.kernel_inputs(problem), problem.contacts.columns
    kernel = compiled_kernel.IncrementalKernel(48, columns, None, 0, *inputs)
    for wrong in (columns[1:], columns + 1, columns.astype(np.int32), columns[:0], None, columns[::-1].copy()):
        with pytest.raises(ValueError, match=r"columns|fingers"):
            compiled_kernel.IncrementalKernel(48, wrong, None, 0, *inputs)
    with pytest.raises(OverflowError, match="at most 2 force components that share joints"):
        compiled_kernel.IncrementalKernel(2, columns, None, 0, *inputs)
    for call in (kernel.load, kernel.step, compiled_kernel.IncrementalKernel, compiled_kernel.make_record):
        with pytest.raises(TypeError, match="takes"):
            call(1, 2)
