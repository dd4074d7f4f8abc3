"""The same file, the same answer: through Python, through the command line, and through a Zenoh get with JSON.

Every textbook case, which includes E1 to E7 with their known answers, from the exact cone and from pyramids, and one case of
every other collection; and every kind of bad input, which gets the same words three times.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator

import pytest
import zenoh
from support.invalid_problems import invalid_records
from support.servers import TIMEOUT, plain_session
from threadpoolctl import threadpool_limits

from graspforce import ForceProblem, InvalidInput, problems, solve
from graspforce.cli import main
from graspforce.problems import TEXTBOOK, ExpectedInfeasibility
from graspforce.service import Server
from graspforce.service.wire.protocol import PREFIX

OTHERS = [problems.names(name)[0] for name in problems.collections() if name not in TEXTBOOK]
CASES = [*problems.names("textbook"), *OTHERS]


@pytest.fixture(scope="module")
def session(server: Server) -> Iterator[zenoh.Session]:
    """Return a plain Zenoh session for all cases."""
    with plain_session(server.addresses[0]) as opened:
        yield opened


def get_solution(session: zenoh.Session, text: bytes) -> tuple[bool, dict]:
    """Return whether a plain get, without an encoding, brings a solution, and its record."""
    (reply,) = list(session.get(f"{PREFIX}/solve", payload=text, timeout=TIMEOUT))
    return reply.ok is not None, json.loads((reply.ok or reply.err).payload.to_bytes())


def check_record(case: problems.Case, record: dict) -> None:
    """Check a record against the known solution of its case."""
    assert record["status"] == case.expected.status.value
    if isinstance(case.expected, ExpectedInfeasibility):
        assert record["infeasibility"]["verified"]
        for name in ("friction_factor", "torque_factor"):
            known = getattr(case.expected, name)
            if known is not None:
                assert record["infeasibility"][name] == pytest.approx(known, rel=case.expected.tolerance + 1e-6)
        return
    assert record["certificate"]["verified"]
    tolerance = case.expected.tolerance
    assert record["objective"] == pytest.approx(case.expected.objective, rel=tolerance, abs=tolerance)
    if case.expected.normals is not None:
        normals = [force[0] if len(force) == 1 else force[2] for force in record["forces"]]
        # An error ε of the objective is an error of √ε in the forces.
        assert normals == pytest.approx(case.expected.normals, rel=1e-4, abs=1e-4 * max(normals))


@pytest.mark.parametrize("name", CASES)
def test_python_command_and_service_return_the_same_solution(name, session, tmp_path, capsys):
    case, text = problems.load(name), problems.text(name).encode()
    (tmp_path / "case.json").write_bytes(text)
    with threadpool_limits(1, "blas"):  # as in a server: the order of sums depends on the number of threads
        here = solve(ForceProblem.from_dict(json.loads(text))).to_dict()
        code = main(["solve", str(tmp_path / "case.json"), "--json"])
    shell = json.loads(capsys.readouterr().out)
    answered, wire = get_solution(session, text)
    assert answered
    assert code == (3 if isinstance(case.expected, ExpectedInfeasibility) else 0)
    for record in (here, shell, wire):
        check_record(case, record)
    # All three run the same arithmetic: only times and the service's own fields differ.
    for record in (here, shell, wire):
        record["solver"].pop("seconds")
        if record.get("robust") is not None:
            record["robust"].pop("error_factor")  # only the command computes it
    wire.pop("server_seconds")
    assert here == shell == wire


@pytest.mark.parametrize(("fault", "record"), invalid_records(), ids=[fault.name for fault, _ in invalid_records()])
def test_python_command_and_service_report_the_same_error(fault, record, session, tmp_path, capsys):
    with pytest.raises(InvalidInput) as caught:
        ForceProblem.from_dict(record)
    text = json.dumps(record)
    path = tmp_path / "bad.json"
    path.write_text(text)
    assert main(["solve", str(path)]) == 1
    assert capsys.readouterr().err.strip() == f"Error: {path}: {caught.value}"
    answered, error = get_solution(session, text.encode())
    assert not answered
    assert (error["error"], error["field"], error["message"]) == ("invalid", fault.field, str(caught.value))


def test_command_reads_standard_input_and_sets_its_exit_code(tmp_path):
    """The exit code tells a proof of infeasibility from an error."""
    for name, code in (("nose-cone/5-force", 0), ("nose-cone/5-friction-below", 3)):
        command = [sys.executable, "-m", "graspforce", "solve", "-", "--json"]
        said = subprocess.run(command, input=problems.text(name).encode(), capture_output=True, check=False)
        assert said.returncode == code
        check_record(problems.load(name), json.loads(said.stdout))
