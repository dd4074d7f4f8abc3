"""Tests of the data package: every format, read by a program of another project, gives the proven optimum."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import lzma
import re
import subprocess
import sys
import tarfile
from pathlib import Path
from types import ModuleType

import highspy
import numpy as np
import pytest
from scipy import sparse

import graspforce as gf
from graspforce import problems
from graspforce.bench.export.cbf import write_cbf
from graspforce.bench.export.data_package import write_data_package
from graspforce.bench.export.qps import write_qps
from graspforce.bench.export.standard_form import standard_form
from graspforce.bench.export.tags import case_tags
from graspforce.cli import main
from graspforce.core.errors import BackendError, InvalidInput, UnsupportedProblem
from graspforce.problems.library import FOLDER_VARIABLE

cvxpy = pytest.importorskip("cvxpy")
pyarrow = pytest.importorskip("pyarrow.parquet")

# every objective with exact cones and pyramids, soft fingers, motor limits, no friction, infeasible problems of several kinds
CASES = (
    "batch/force-000",
    "batch/limits-000",
    "batch/pyramid-000",
    "batch/torque-000",
    "closed-loop/ideal-03-050",
    "closed-loop/real-01-007",
    "fixture/clamp-limit",
    "infeasible/ball-01",
    "infeasible/near-1e-05-hand-2",
    "nose-cone/5-margin",
    "opposed/capped",
    "opposed/torque-weight",
    "pyramid/inner-8-force-1",
    "pyramid/inner-8-margin-1",
    "pyramid/inner-8-max-normal-1",
    "pyramid/inner-8-sum-normal-1",
    "pyramid/inner-8-torque-1",
    "ring/3-force",
    "ring/3-torque",
    "robust/centre-02",
    "robust/friction-04",
    "robust/normals-01",
    "soft/force-01",
    "soft/max-normal-01",
    "soft/sum-normal-01",
    "soft/torque-01",
)
CASES = tuple(name for name in CASES if name in problems.names()) + tuple(
    name for name in problems.names("soft") if name.endswith("-1")
)


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("package") / "graspforce-problems"
    write_data_package(folder, CASES)
    return folder


@pytest.fixture(scope="module")
def reader(package: Path) -> ModuleType:
    """Return the module of the written package."""
    spec = importlib.util.spec_from_file_location("graspforce_problems", package / "graspforce_problems" / "__init__.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["graspforce_problems"] = module
    spec.loader.exec_module(module)
    return module


def agrees(case: problems.Case, cost: float) -> bool:
    """Whether a cost equals the proven one; solvers' default tolerances reach 1e-6 of the unit of the cost."""
    form = standard_form(case)
    return abs(cost - case.expected.objective) <= 1e-6 * (abs(case.expected.objective) + abs(form.scale))


def read_cbf(text: str) -> cvxpy.Problem:
    """Return the problem of a CBF file, by the description of the format (Friberg 2016)."""
    lines = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    sections: dict[str, list[list[str]]] = {}
    for line in lines:
        if re.fullmatch(r"[A-Z]{3,}", line[0]) and len(line) == 1 and line[0] not in ("MIN", "MAX"):
            sections[line[0]] = []
            own = sections[line[0]]
        else:
            own.append(line)
    assert sections["VER"] == [["1"]]
    assert sections["OBJSENSE"] == [["MIN"]]
    x = cvxpy.Variable(int(sections["VAR"][0][0]))
    assert sections["VAR"][1:] == [["F", str(x.size)]]
    count = int(sections["CON"][0][0])
    rows, constant, cost = sparse.lil_matrix((count, x.size)), np.zeros(count), np.zeros(x.size)
    for i, j, value in sections["ACOORD"][1:]:
        rows[int(i), int(j)] = float(value)
    for i, value in sections["BCOORD"][1:]:
        constant[int(i)] = float(value)
    for j, value in sections["OBJACOORD"][1:]:
        cost[int(j)] = float(value)
    for name in ("ACOORD", "BCOORD", "OBJACOORD"):
        assert int(sections[name][0][0]) == len(sections[name]) - 1
    constraints, first = [], 0
    for kind, size in sections["CON"][1:]:
        v = rows.tocsr()[first : first + int(size)] @ x + constant[first : first + int(size)]
        first += int(size)
        if kind == "QR":  # 2 v₁ v₂ ≥ ‖w‖²: ‖(√2 w, v₁ − v₂)‖ ≤ v₁ + v₂
            constraints.append(cvxpy.SOC(v[0] + v[1], cvxpy.hstack([np.sqrt(2) * v[2:], v[0] - v[1]])))
        else:
            constraints.append({"L=": v == 0, "L-": v <= 0}.get(kind) if kind != "Q" else cvxpy.SOC(v[0], v[1:]))
    assert first == count
    return cvxpy.Problem(cvxpy.Minimize(cost @ x), constraints)


@pytest.mark.parametrize("name", CASES)
def test_cbf_gives_the_proven_answer(name: str) -> None:
    case = problems.load(name)
    form = standard_form(case)
    program = read_cbf(write_cbf(form))
    value = program.solve(solver="CLARABEL")
    if form.feasible:
        assert agrees(case, form.scale * value + form.offset)
    else:
        assert program.status.startswith("infeasible") or name.startswith("infeasible/near")


@pytest.mark.parametrize("name", [name for name in CASES if not standard_form(problems.load(name)).cones])
def test_qps_gives_the_proven_answer(name: str, tmp_path: Path) -> None:
    """HiGHS reads the file and solves it. It warns of entries below 1e-9, rounding errors of the geometry, and omits them."""
    case = problems.load(name)
    form = standard_form(case)
    path = tmp_path / "case.mps"
    path.write_text(write_qps(form))
    highs = highspy.Highs()
    highs.silent()
    highs.setOptionValue("threads", 1)  # as elsewhere: HiGHS refuses to run with another number of threads in one process
    assert highs.readModel(str(path)) != highspy.HighsStatus.kError
    model = highs.getModel()
    assert (model.lp_.num_col_, model.lp_.num_row_) == (len(form.q), len(form.b) + len(form.d))
    highs.run()
    if form.feasible:
        assert highs.getModelStatus() == highspy.HighsModelStatus.kOptimal
        assert agrees(case, form.scale * highs.getInfo().objective_function_value + form.offset)
    else:
        assert highs.getModelStatus() == highspy.HighsModelStatus.kInfeasible


def test_qps_refuses_cones() -> None:
    with pytest.raises(UnsupportedProblem, match="no second-order cones"):
        write_qps(standard_form(problems.load("ring/3-force")))


@pytest.mark.parametrize("name", CASES)
def test_stored_answer_satisfies_its_equations(name: str, reader: ModuleType) -> None:
    case, program = problems.load(name), reader.load(name)
    assert program.residual() <= 1e-6
    assert program.feasible == isinstance(case.expected, problems.ExpectedOptimum)
    if program.feasible:
        assert agrees(case, program.scale * program.value(program.x) + program.offset)
        gap = program.x @ (program.P @ program.x) + program.q @ program.x - program.b @ program.y + program.d @ program.z
        gap += program.r @ program.u
        assert abs(gap) <= 1e-6 * (1.0 + abs(program.value(program.x)))  # strong duality
    else:
        assert program.b @ program.y - program.d @ program.z - program.r @ program.u == pytest.approx(1.0)
    assert gf.ForceProblem.from_dict(program.problem).to_dict() == case.problem.to_dict()


def test_parquet_holds_the_same_programs(package: Path, reader: ModuleType) -> None:
    table = pyarrow.read_table(package / "graspforce_problems" / "data" / "cases.parquet")
    assert table.column("name").to_pylist() == list(CASES)
    for row in table.to_pylist():
        program = reader.load(row["name"])
        size = len(program.q)
        for key, count in (("P", size), ("A", len(program.b)), ("C", len(program.d)), ("S", sum(program.cones))):
            entries = (row[f"{key}_value"], (row[f"{key}_row"], row[f"{key}_column"]))
            assert (sparse.coo_matrix(entries, (count, size)).toarray() == getattr(program, key)).all()
        for key in "qbdryzu":
            assert row[key] == getattr(program, key).tolist()
        assert (row["scale"], row["objective"], row["tags"]) == (program.scale, program.objective, list(program.tags))


@pytest.mark.parametrize("tool", ["cvxpy", "qpsolvers"])
def test_loader_of_the_readme_gives_the_proven_optimum(tool: str, package: Path, reader: ModuleType, capsys) -> None:
    text = (package / "README.md").read_text()
    code = text.split(f"## {tool}\n\n```python\n")[1].split("```")[0]
    assert len(code.splitlines()) <= 10
    exec(compile(code, "README.md", "exec"), {})
    found, proven = map(float, capsys.readouterr().out.split())
    assert found == pytest.approx(proven, rel=1e-6)


def test_manifest_states_version_licence_and_hashes(package: Path, reader: ModuleType) -> None:
    manifest = reader.manifest()
    assert (manifest["version"], manifest["licence"]) == (problems.DATA_VERSION, "CC-BY-4.0")
    assert list(manifest["cases"]) == reader.names() == list(CASES)
    assert reader.check_hashes() == []
    for name in ("pyproject.toml", "README.md", "LICENSE", "CITATION.cff"):
        text = (package / name).read_text()
        assert problems.DATA_VERSION in text
        assert "{version}" not in text
    assert 'license-files = ["LICENSE", "CITATION.cff"]' in (package / "pyproject.toml").read_text()  # both are in the wheel
    data = package / "graspforce_problems" / "data"
    with tarfile.open(data / "cbf.tar.xz") as archive:
        assert archive.getnames() == [f"{name}.cbf" for name in CASES]
    lines = lzma.decompress((data / "json" / "ring.jsonl.xz").read_bytes()).decode().splitlines()
    assert [json.loads(line)["name"] for line in lines] == [name for name in CASES if name.startswith("ring/")]


def test_changed_data_are_found_by_their_hash(tmp_path: Path) -> None:
    write_data_package(tmp_path / "changed", ["ring/3-force"])
    file = tmp_path / "changed" / "graspforce_problems" / "data" / "json" / "ring.jsonl.xz"
    file.write_bytes(lzma.compress(lzma.decompress(file.read_bytes()).replace(b'"feasible"', b'"Feasible"')))
    code = "import graspforce_problems as gp; print(gp.check_hashes())"
    code = f"import sys; sys.path.insert(0, '.'); {code}"
    ran = subprocess.run([sys.executable, "-c", code], cwd=tmp_path / "changed", capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "['json/ring.jsonl.xz', 'ring/3-force']"


def test_package_is_not_written_over_other_files(tmp_path: Path) -> None:
    (tmp_path / "kept.txt").write_text("kept")
    with pytest.raises(InvalidInput, match="an empty or new folder"):
        write_data_package(tmp_path, ["ring/3-force"])


def test_answer_that_differs_from_the_proven_one_is_an_error() -> None:
    case = problems.load("ring/3-force")
    wrong = dataclasses.replace(case.expected, objective=1.001 * case.expected.objective)
    with pytest.raises(BackendError, match="differs from the proven one"):
        standard_form(dataclasses.replace(case, expected=wrong))
    capped = problems.load("opposed/capped")
    proof = dataclasses.replace(capped.expected.proof, y=-capped.expected.proof.y)
    with pytest.raises(BackendError, match="the residual"):
        standard_form(dataclasses.replace(capped, expected=dataclasses.replace(capped.expected, proof=proof)))


@pytest.mark.parametrize("kind", ["force", "torque", "pyramid", "limits"])
def test_batch_gives_the_proven_optima(kind: str, reader: ModuleType) -> None:
    batch = reader.load_batch(kind)
    case = batch.program
    assert batch.b[0] == pytest.approx(case.b, abs=1e-9)
    assert batch.b.shape == (10_000, len(case.b))
    x, b = cvxpy.Variable(len(case.q)), cvxpy.Parameter(len(case.b))
    constraints = [case.A @ x == b, case.C @ x <= case.d]
    for i, size in zip(np.cumsum([0, *case.cones]), case.cones, strict=False):
        constraints.append(cvxpy.SOC(-case.S[i] @ x, -case.S[i + 1 : i + size] @ x))
    program = cvxpy.Problem(cvxpy.Minimize(0.5 * cvxpy.quad_form(x, cvxpy.psd_wrap(case.P)) + case.q @ x), constraints)
    infeasible = np.flatnonzero(np.isnan(batch.objectives))
    for i in [*range(1, 10_000, 1111), *infeasible[:3]]:
        b.value = batch.b[i]
        value = case.scale * program.solve(solver="CLARABEL") + case.offset
        if i in infeasible:
            assert program.status == "infeasible"
        else:
            assert value == pytest.approx(batch.objectives[i], abs=1e-6 * (abs(batch.objectives[i]) + case.scale))


@pytest.mark.parametrize("kind", ["force", "torque", "pyramid", "limits"])
def test_batch_has_a_ray_for_each_infeasible_member(kind: str, reader: ModuleType) -> None:
    batch = reader.load_batch(kind)
    assert list(batch.rays) == np.flatnonzero(np.isnan(batch.objectives)).tolist()
    for i, (y, z, u) in batch.rays.items():
        member = dataclasses.replace(batch.program, b=batch.b[i], x=None, y=y, z=z, u=u)
        # numbers of the program have nine digits; a ray is large where the load hardly exceeds the limits
        assert member.residual() <= 1e-8 * max(1.0, np.abs(np.concatenate([y, z, u])).max()) + 1e-9
        assert member.b @ y - member.d @ z - member.r @ u == pytest.approx(1.0, abs=1e-9)  # of numbers of order 1


def test_numbers_have_few_digits() -> None:
    """At least nine; more only where the answer would otherwise leave its equations."""
    form = standard_form(problems.load("ring/3-force"))
    assert all(float(f"{value:.9g}") == value for value in [*form.A.data, *form.P.data, *form.x, *form.y])
    near = standard_form(problems.load("infeasible/near-1e-06-hand-1"))
    assert any(float(f"{value:.9g}") != value for value in near.A.data)


def test_difficulty_follows_from_the_traits() -> None:
    expected = {
        "ring/3-force": ("easy", set()),
        "pyramid/inner-8-force-1": ("easy", set()),
        "robust/mass-01": ("medium", {"robust"}),
        "scaling/0030-force-1": ("medium", set()),
        "large/force-1": ("hard", {"large"}),
        "hard/rank-line-1": ("hard", {"rank-deficient"}),
        "hard/slippery-1e-04-3": ("hard", {"low-friction"}),
        "hard/near-1e-05-hand-2": ("hard", {"near-limit"}),
        "infeasible/near-1e-04-hand-6": ("hard", {"near-limit"}),
    }
    for name, (difficulty, traits) in expected.items():
        tags = set(case_tags(problems.load(name)))
        assert {tag for tag in tags if tag.startswith("difficulty:")} == {f"difficulty:{difficulty}"}, name
        assert traits <= tags, name


def test_tags_describe_the_case() -> None:
    assert {"objective:torque", "motor-limits", "exact", "infeasible"} <= set(case_tags(problems.load("opposed/torque-limit")))
    assert {"pyramid", "linear"} <= set(case_tags(problems.load("pyramid/inner-8-force-1")))
    assert "large" in case_tags(problems.load("scaling/1000-force-1"))
    assert "feasible" in case_tags(problems.load("ring/3-force"))


# ── own folders ────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_own_folder_replaces_the_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, "")  # restored after the test
    record = {**problems.load("ring/3-force").to_dict(), "name": "mine/first"}
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "first.json").write_text(json.dumps(record) + "\n")
    assert main(["problems", "--dir", str(tmp_path), "list", "--json"]) == 0
    assert [case["name"] for case in json.loads(capsys.readouterr().out)["cases"]] == ["mine/first"]
    assert main(["problems", "--dir", str(tmp_path), "verify"]) == 0
    capsys.readouterr()
    monkeypatch.setenv(FOLDER_VARIABLE, "")
    assert main(["bench", "--dir", str(tmp_path), "--solver", "clarabel", "--json"]) == 0
    outcomes = json.loads(capsys.readouterr().out)["outcomes"]
    assert {(o["case"], o["verdict"]) for o in outcomes} == {("mine/first", "certified")}
    monkeypatch.setenv(FOLDER_VARIABLE, "")
    assert main(["problems", "--dir", str(tmp_path / "mine")]) == 1
    assert "a folder of collections" in capsys.readouterr().err
    assert "ring/3-force" in problems.names()


def test_export_command_writes_the_package(tmp_path: Path, capsys) -> None:
    assert main(["problems", "export", str(tmp_path / "out"), "--collection", "fixture"]) == 0
    assert f"{len(problems.names('fixture'))} cases, version {problems.DATA_VERSION}" in " ".join(
        capsys.readouterr().out.split()
    )
